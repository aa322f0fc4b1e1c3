"""The action FollowJointTrajectory: planned motions with feedback, cancel and result."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import pytest

from strands_actors.surfaces.ros2 import cdr
from strands_actors.surfaces.ros2.definitions import CANCEL, FEEDBACK, FOLLOW, GET_RESULT, SEND_GOAL, STATUS
from strands_actors.surfaces.ros2.joints import Layout, layout_of
from strands_actors.surfaces.ros2.names import Dialect
from strands_actors.surfaces.ros2.trajectory import Error, Problem, Trajectory, read_trajectory
from tests.answers import until

from .conftest import World
from .test_motion import JOINT_COMMAND, Stream, joint_state, pan, refused

ACTION = "/lab/so101/follow_joint_trajectory"
ARM = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def goal_of(rows: dict[float, list[float]], names: tuple[str, ...] = ("shoulder_pan",)) -> dict[str, Any]:
    points = [
        {"positions": row, "time_from_start": {"sec": int(at_s), "nanosec": round(at_s % 1 * 1e9)}}
        for at_s, row in rows.items()
    ]
    return {"trajectory": {"joint_names": list(names), "points": points}}


class Client:
    """An action client on the graph of a world."""

    def __init__(self, world: World) -> None:
        self._program = world.program

    def call(self, service: str, type_name: str, request: dict[str, Any]) -> dict[str, Any]:
        key = Dialect().key(f"{ACTION}/_action/{service}", type_name)
        payload = self._program.call(key, cdr.encode(f"{type_name}_Request", request))
        return cdr.decode(f"{type_name}_Response", payload)

    def send(self, number: int, goal: dict[str, Any]) -> bool:
        request = {"goal_id": {"uuid": bytes([number]) * 16}, "goal": goal}
        return bool(self.call("send_goal", SEND_GOAL, request)["accepted"])

    def result(self, number: int) -> dict[str, Any]:
        return self.call("get_result", GET_RESULT, {"goal_id": {"uuid": bytes([number]) * 16}})

    def cancel(self, number: int) -> dict[str, Any]:
        return self.call("cancel_goal", CANCEL, {"goal_info": {"goal_id": {"uuid": bytes([number]) * 16}}})


def test_saf_009_a_goal_moves_the_arm_alone_and_the_next_one_needs_no_resume(world: World) -> None:
    client, start = Client(world), math.radians(pan(world))
    feedback = world.program.listen_raw(Dialect().key(f"{ACTION}/_action/feedback", FEEDBACK))
    assert client.send(1, goal_of({0.5: [start + 0.15], 1.0: [start + 0.25]}))
    assert not client.send(2, goal_of({1.0: [start]}))  # one goal at a time
    with Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=start - 0.5)):
        line = until(lambda: refused(world, "are not sent"), "a stream is refused")
        assert ACTION in line
        result = client.result(1)
    assert result == {"status": SUCCEEDED, "result": {"error_code": 0, "error_string": ""}}
    assert math.radians(pan(world)) == pytest.approx(start + 0.25, abs=0.06)
    desired = [cdr.decode(FEEDBACK, payload)["feedback"]["desired"]["positions"][0] for payload in feedback]
    assert len(desired) > 3 and desired == sorted(desired)
    assert client.send(3, goal_of({0.5: [start]}))
    assert client.result(3)["status"] == SUCCEEDED
    statuses = world.program.listen_raw(Dialect().key(f"{ACTION}/_action/status", STATUS), latched=True)
    listed = cdr.decode(STATUS, until(lambda: statuses, "the status is kept")[-1])["status_list"]
    assert [each["status"] for each in listed] == [SUCCEEDED, SUCCEEDED]


def test_saf_002_a_stop_aborts_a_goal_and_a_cancel_holds(world: World) -> None:
    client, start = Client(world), math.radians(pan(world))
    assert client.send(1, goal_of({20.0: [start + 1.0]}))
    until(lambda: math.radians(pan(world)) > start + 0.02, "it moves")
    assert [each["goal_id"]["uuid"] for each in client.cancel(1)["goals_canceling"]] == [b"\1" * 16]
    assert client.result(1)["status"] == CANCELED
    assert client.send(2, goal_of({20.0: [start + 1.0]}))
    results: list[dict[str, Any]] = []
    waiting = threading.Thread(target=lambda: results.append(client.result(2)))
    waiting.start()
    before_ns = time.monotonic_ns()
    assert world.program.trigger("/lab/so101/stop")[0]
    waiting.join(20.0)
    assert results[0]["status"] == ABORTED and results[0]["result"]["error_string"]
    safe = world.twin.log.first_safe(before_ns)
    assert safe is not None and not world.twin.log.host("setpoint", safe.t_ns)
    assert not client.send(3, goal_of({1.0: [start]}))  # stopped: not before a resume
    assert client.cancel(3)["return_code"] == 2 and client.result(9)["status"] == 0


# -- goals, pure


def layout() -> Layout:
    found = layout_of("so101", ARM)
    assert found is not None
    return found


def read(goal: dict[str, Any], **measured: float) -> Trajectory | Problem:
    decoded = cdr.decode(f"{FOLLOW}_Goal", cdr.encode(f"{FOLLOW}_Goal", goal))
    return read_trajectory(decoded, layout(), measured or {"shoulder_pan": 0.0})


def test_a_trajectory_begins_where_the_arm_is_and_goes_straight() -> None:
    trajectory = read(goal_of({1.0: [0.2], 2.0: [0.6]}), shoulder_pan=0.1)
    assert isinstance(trajectory, Trajectory)
    ways = {0.0: 0.1, 0.5: 0.15, 1.0: 0.2, 1.5: 0.4, 2.0: 0.6, 9.0: 0.6}
    assert {at_s: trajectory.positions(at_s)[0] for at_s in ways} == pytest.approx(ways)
    assert not trajectory.farthest({"shoulder_pan": 0.62})
    assert "shoulder_pan" in trajectory.farthest({"shoulder_pan": 0.7}) and trajectory.farthest({})


def test_tolerances_of_the_goal_count() -> None:
    for position, allowed in ((0.3, 0.25), (-1.0, 100.0)):
        tolerance = [{"name": "shoulder_pan", "position": position}]
        trajectory = read({**goal_of({1.0: [0.0]}), "goal_tolerance": tolerance})
        assert isinstance(trajectory, Trajectory) and not trajectory.farthest({"shoulder_pan": allowed})


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ({}, Error.INVALID_GOAL),
        (goal_of({1.0: [0.0]}, ("elbow",)), Error.INVALID_JOINTS),
        (goal_of({1.0: [0.0, 0.0]}, ("shoulder_pan", "shoulder_pan")), Error.INVALID_JOINTS),
        (goal_of({1.0: []}), Error.INVALID_GOAL),
        (goal_of({1.0: [math.nan]}), Error.INVALID_GOAL),
        (goal_of({1.0: [0.0], 0.5: [0.1]}), Error.INVALID_GOAL),
        (goal_of({9000.0: [0.0]}), Error.INVALID_GOAL),
        (goal_of({1.0: [0.0]}, ("gripper",)), Error.INVALID_GOAL),  # its position is not known
    ],
)
def test_saf_014_a_wrong_goal_is_rejected_with_a_reason(goal: dict[str, Any], error: Error) -> None:
    problem = read(goal)
    assert isinstance(problem, Problem) and problem.error is error and problem.text
