"""The action FollowJointTrajectory: planned motions with feedback, cancel and result."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import pytest

from strands_actors.kernel.channels.ros2 import cdr
from strands_actors.kernel.channels.ros2.definitions import CANCEL, FOLLOW, GRIPPER, STATUS, TRAJECTORY
from strands_actors.kernel.channels.ros2.names import Dialect
from strands_actors.surfaces.ros2.action import Stall
from strands_actors.surfaces.ros2.joints import Layout, layout_of
from strands_actors.surfaces.ros2.trajectory import Error, Problem, Trajectory, read_trajectory
from tests.answers import until

from .conftest import World
from .peer import Program
from .test_motion import JOINT_COMMAND, Stream, joint_state, pan, refused

ACTION = "/lab/so101/follow_joint_trajectory"
GRIPPER_CMD = "/lab/so101/gripper_cmd"
JOINT_TRAJECTORY = "/lab/so101/joint_trajectory"
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

    def __init__(self, world: World, action: str = ACTION, type_name: str = FOLLOW) -> None:
        self._program = world.program
        self._action = action
        self._type = type_name

    def call(self, service: str, type_name: str, request: dict[str, Any]) -> dict[str, Any]:
        key = Dialect().key(f"{self._action}/_action/{service}", type_name)
        payload = self._program.call(key, cdr.encode(f"{type_name}_Request", request))
        return cdr.decode(f"{type_name}_Response", payload)

    def send(self, number: int, goal: dict[str, Any]) -> bool:
        request = {"goal_id": {"uuid": bytes([number]) * 16}, "goal": goal}
        return bool(self.call("send_goal", f"{self._type}_SendGoal", request)["accepted"])

    def result(self, number: int) -> dict[str, Any]:
        request = {"goal_id": {"uuid": bytes([number]) * 16}}
        return self.call("get_result", f"{self._type}_GetResult", request)

    def outcome(self, number: int, goal: dict[str, Any]) -> tuple[int, int, str]:
        """Send a goal, and return its status, error code and error text."""
        assert self.send(number, goal)
        result = self.result(number)
        return result["status"], result["result"]["error_code"], result["result"]["error_string"]

    def cancel(self, number: int) -> dict[str, Any]:
        return self.call("cancel_goal", CANCEL, {"goal_info": {"goal_id": {"uuid": bytes([number]) * 16}}})


def test_saf_009_a_goal_moves_the_arm_alone_and_the_next_one_needs_no_resume(world: World) -> None:
    client, start = Client(world), math.radians(pan(world))
    feedback = world.program.listen_raw(Dialect().key(f"{ACTION}/_action/feedback", f"{FOLLOW}_FeedbackMessage"))
    assert client.send(1, goal_of({0.5: [start + 0.15], 1.0: [start + 0.25]}))
    status, _, text = client.outcome(2, goal_of({1.0: [start]}))  # one goal at a time
    assert status == ABORTED and f"{ACTION}, goal 01010101 commands the robot already" in text
    assert not client.send(2, goal_of({1.0: [start]}))  # this goal is known
    with Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=start - 0.5)):
        line = until(lambda: refused(world, "are not sent"), "a stream is refused")
        assert ACTION in line
        result = client.result(1)
    assert result == {"status": SUCCEEDED, "result": {"error_code": 0, "error_string": ""}}
    assert math.radians(pan(world)) == pytest.approx(start + 0.25, abs=0.06)
    read = [cdr.decode(f"{FOLLOW}_FeedbackMessage", payload)["feedback"] for payload in feedback]
    desired = [each["desired"]["positions"][0] for each in read]
    assert len(desired) > 3 and desired == sorted(desired)
    assert client.outcome(3, goal_of({0.5: [start]}))[0] == SUCCEEDED
    statuses = world.program.listen_raw(Dialect().key(f"{ACTION}/_action/status", STATUS), latched=True)
    listed = cdr.decode(STATUS, until(lambda: statuses, "the status is kept")[-1])["status_list"]
    assert [each["status"] for each in listed] == [SUCCEEDED, ABORTED, SUCCEEDED]


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
    status, _, text = client.outcome(3, goal_of({1.0: [start]}))  # stopped: not before a resume
    assert status == ABORTED and "Resume the robot first" in text
    assert client.cancel(3)["return_code"] == 3 and client.cancel(8)["return_code"] == 2
    assert client.result(9)["status"] == 0


def test_saf_009_a_goal_is_refused_with_the_name_of_the_program_that_has_the_lease(world: World) -> None:
    start = pan(world)
    assert world.arm.send_action({"shoulder_pan": start})["status"] == "success"
    status, _, text = Client(world).outcome(1, goal_of({1.0: [0.0]}))
    assert status == ABORTED and "holds the lease" in text


def test_a_joint_that_leaves_its_path_aborts_the_goal(world: World) -> None:
    start = math.radians(pan(world))
    tolerance = [{"name": "shoulder_pan", "position": 1e-4}]  # less than a moving arm is behind
    outcome = Client(world).outcome(1, {**goal_of({2.0: [start + 0.5]}), "path_tolerance": tolerance})
    assert outcome[:2] == (ABORTED, Error.PATH_TOLERANCE_VIOLATED), outcome


def test_the_gripper_is_opened_by_its_action(world: World) -> None:
    gripper = Client(world, GRIPPER_CMD, GRIPPER)
    for number, position in ((1, 0.8), (2, 0.2)):
        assert gripper.send(number, {"command": {"position": position}})
        result = gripper.result(number)
        assert result["status"] == SUCCEEDED and result["result"]["reached_goal"], result
        assert result["result"]["position"] == pytest.approx(position, abs=0.1)
    assert gripper.send(3, {"command": {"position": math.nan}})
    assert gripper.result(3)["status"] == ABORTED


@pytest.mark.long
def test_trajectories_on_a_topic_replace_each_other(world: World) -> None:
    start = math.radians(pan(world))

    def publish(at_s: float, position: float, program: Program = world.program) -> None:
        key = Dialect().key(JOINT_TRAJECTORY, TRAJECTORY)
        message = goal_of({at_s: [position]})["trajectory"]
        program.put(key, cdr.encode(TRAJECTORY, message))

    publish(20.0, start + 1.5)
    until(lambda: math.radians(pan(world)) > start + 0.02, "it moves")
    with Program(world.endpoint, gid=b"another program!") as other:
        publish(1.0, start, other)
        until(lambda: refused(world, "are not sent"), "another publisher is refused")
    publish(0.5, start + 0.4)
    until(lambda: abs(math.radians(pan(world)) - start - 0.4) < 0.06, "the newer one is followed")
    publish(0.1, 9.0)
    until(lambda: refused(world, "is not followed to its end"), "the reason")


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


def test_velocities_in_all_points_make_curves() -> None:
    goal = goal_of({1.0: [0.5], 2.0: [1.0]})
    for point, speed in zip(goal["trajectory"]["points"], (0.75, 0.0), strict=True):
        point["velocities"] = [speed]
    curved = read(goal, shoulder_pan=0.0)
    assert isinstance(curved, Trajectory)
    ways = {0.0: 0.0, 1.0: 0.5, 2.0: 1.0}
    assert {at_s: curved.positions(at_s)[0] for at_s in ways} == pytest.approx(ways)
    before, after = curved.positions(1.0 - 1e-4)[0], curved.positions(1.0 + 1e-4)[0]
    assert (after - before) / 2e-4 == pytest.approx(0.75, abs=1e-3)
    assert curved.positions(0.1)[0] < 0.02  # it begins slowly, and not on a straight line


def test_the_path_has_a_tolerance_if_the_goal_states_one() -> None:
    goal = goal_of({1.0: [1.0]})
    without = read(goal)
    assert isinstance(without, Trajectory) and not without.off_path({"shoulder_pan": -9.0}, 0.5)
    kept = read({**goal, "path_tolerance": [{"name": "shoulder_pan", "position": 0.1}]})
    assert isinstance(kept, Trajectory)
    assert not kept.off_path({"shoulder_pan": 0.45}, 0.5) and "its path" in kept.off_path(
        {"shoulder_pan": 0.3}, 0.5
    )


def test_a_gripper_is_stalled_when_it_does_not_move() -> None:
    stall = Stall(0.01)
    for ms in range(0, 1000, 100):
        stall.take(ms * 1e-3, ms * 1e-3)
        assert not stall.is_stalled
    stall.take(0.905, 1.3)
    assert not stall.is_stalled
    stall.take(0.905, 1.6)
    assert stall.is_stalled


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
        ({**goal_of({1.0: [0.0]}), "path_tolerance": [{"name": "elbow"}]}, Error.INVALID_JOINTS),
        (
            {**goal_of({1.0: [0.0]}), "goal_tolerance": [{"name": "shoulder_pan", "velocity": 0.1}]},
            Error.INVALID_GOAL,
        ),
        (
            {**goal_of({1.0: [0.0]}), "goal_tolerance": [{"name": "shoulder_pan", "position": math.nan}]},
            Error.INVALID_GOAL,
        ),
        (goal_of({1.0: [0.0], 0.5: [0.1]}), Error.INVALID_GOAL),
        (goal_of({9000.0: [0.0]}), Error.INVALID_GOAL),
        (goal_of({1.0: [0.0]}, ("gripper",)), Error.INVALID_GOAL),  # its position is not known
    ],
)
def test_saf_014_a_wrong_goal_is_rejected_with_a_reason(goal: dict[str, Any], error: Error) -> None:
    problem = read(goal)
    assert isinstance(problem, Problem) and problem.error is error and problem.text
