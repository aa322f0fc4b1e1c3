"""Behaviours of a G1 and a Go2 that the tests of strands-robots require, tested on one twin each through
the public names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, resumed, status, task, task_ended, until, why
from tests.trees import connected

from .test_reference_feetech import ask, hold

NAN = float("nan")


class Bench(NamedTuple):
    robot: RealRobot
    twin: Twin
    joint: str
    other: str

    def here(self) -> float:
        return float(self.robot.get_observation()[self.joint])

    def armed(self) -> None:
        """Arm the robot. A rollout leaves legs without torque, as a stop does, so each test must arm them
        again.
        """
        resumed(self.robot)

    def released(self) -> None:
        assert json_of(self.robot.release_sport_mode())["sport_mode_released"] is True  # type: ignore[attr-defined]
        self.sensor("sport_mode_released", 1.0)

    def sensor(self, name: str, value: float) -> None:
        until(lambda: status(self.robot)["sensors"].get(name, [None])[0] == value, f"{name} is {value}")

    def runs(self, policy: Any, **budget: Any) -> dict[str, Any]:
        self.armed()
        json_of(self.robot.run_policy(policy, **budget))
        return task_ended(self.robot)

    def moved(self, *joints: str, **gains: float) -> dict[str, Any]:
        """Send one command to stay and return its answer. The end of the command makes a robot on legs limp."""

        def send() -> dict[str, Any] | None:
            self.robot.resume()
            here = self.robot.get_observation()
            action = {joint: {"q": here[joint], **gains} if gains else here[joint] for joint in joints}
            answer = self.robot.send_action(action)
            return json_of(answer) if answer["status"] == "success" else None

        return until(send, "the command is accepted")

    def refuses(self, action: Any, says: str) -> None:
        """Check that an action is refused for the expected reason, and not because the robot is not armed."""

        def refused() -> bool:
            if status(self.robot)["state"] != "armed":
                self.robot.resume()
            return says in why(self.robot.send_action(action))

        until(refused, f"{action} is refused: {says}")


class Stand:
    """Keep one joint at its first position. Without torque, other joints may have fallen beyond their
    limits.
    """

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self._home: dict[str, float] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self._home = self._home or {self._joint: observation[self._joint]}
        return [self._home] * 250  # half a second, because the machine may be busy


def bench_of(kind: str, joint: str, other: str, directory: Any) -> Iterator[Bench]:
    with Twin(kind, directory) as twin:
        robot = Robot(kind, mode="real", port=twin.port, battery_floor_pct=15.0)
        assert status(robot)["connected"] is False and dict(robot.get_observation()) == {}
        assert "not connected" in why(robot.run_policy(hold))
        assert "not connected" in why(ask(robot, action="sensors"))
        assert not task(robot)["running"]
        assert connected(robot).connect_eagerly() is None
        yield Bench(robot, twin, joint, other)
        robot.cleanup()
        robot.cleanup()
        assert not robot.is_connected


JOINTS = {"g1": ("left_elbow", "right_elbow"), "go2": ("FL_calf_joint", "FL_hip_joint")}


@pytest.fixture(scope="module", params=["g1", "go2"])
def either(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Use one robot after the other: a tree at 500 Hz and its twin need a whole processor."""
    name = request.param
    yield from bench_of(f"unitree_{name}", *JOINTS[name], tmp_path_factory.mktemp(name))


@pytest.fixture
def bench(either: Bench) -> Bench:
    """Prepare a robot to be moved, whichever test of this file ran before."""
    if not status(either.robot).get("sport_mode_released", True):
        either.released()
    return either


def test_state_and_status_describe_the_robot(bench: Bench) -> None:
    is_g1 = bench.robot.name == "unitree_g1"
    joints = 29 if is_g1 else 12
    reading = json_of(bench.robot.state())
    assert len(reading["joints"]) == len(reading["joint_velocities"]) == joints
    assert reading["battery_pct"] == 80.0
    assert len(reading["imu"]["rpy"]) == 3 and len(reading["imu"]["quaternion"]) == 4
    reported = status(bench.robot)
    assert "network_interface" in reported  # only if the robot has answered
    assert sorted(reported["motors"].values()) == list(range(joints))
    if is_g1:
        assert json_of(bench.robot.state())["fsm_id"] == 801
    else:  # The order on the wire begins at the front right; the order of the model differs.
        legs = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
        assert list(reported["motors"]) == legs


@pytest.mark.parametrize("either", ["go2"], indirect=True)
def test_a_go2_in_sport_mode_is_moved_by_no_verb_until_release_sport_mode(either: Bench) -> None:
    either.twin.order("mode normal")
    either.sensor("sport_mode_released", 0.0)
    assert status(either.robot)["sport_mode_released"] is False
    for answer in (
        either.robot.send_action({either.joint: either.here()}),
        either.robot.run_policy(hold),
    ):
        assert "sport mode" in why(answer) and "release_sport_mode" in why(answer)
    assert either.robot.start_task("walk")["status"] == "error"
    for attempts in (0, -1, True, "3"):  # the request is not sent to the robot
        answer = either.robot.release_sport_mode(attempts=attempts)  # type: ignore[attr-defined]
        assert f"attempts is {attempts!r}" in why(answer)
    assert status(either.robot)["sport_mode_released"] is False
    either.released()


@pytest.mark.parametrize("either", ["g1"], indirect=True)
def test_the_answer_to_a_command_names_topic_fsm_and_joints(either: Bench) -> None:
    sent = either.moved(either.joint, either.other)
    assert (sent["topic"], sent["fsm_id"]) == ("rt/lowcmd", 801)
    assert sent["joints"] == sorted([either.joint, either.other])
    assert either.moved(either.joint, kp=20.0, kd=1.0, dq=0.1, tau=0.05)["joints"] == [either.joint]


def unusable(joint: str, q: float) -> list[tuple[Any, str]]:
    return [
        ({}, "names no joint"),
        ([joint], "a mapping of joints to numbers"),
        ({"elbow_typo": 0.2, joint: q}, "elbow_typo is not a joint"),
        ({joint: {"kp": 10.0}}, "has no q"),
        ({joint: {"q": q, "K_p": 50.0}}, "K_p is not known"),
        ({joint: "hold"}, f"{joint}.q is hold"),
        ({joint: NAN}, f"{joint}.q is nan"),
        ({joint: {"q": q, "kp": NAN}}, f"{joint}.kp is nan"),
        ({joint: {"q": q, "tau": True}}, f"{joint}.tau is True"),
    ]


def test_an_action_with_one_unusable_value_is_refused_as_a_whole(bench: Bench) -> None:
    for action, says in unusable(bench.joint, bench.here()):
        bench.refuses(action, says)
    is_g1 = bench.robot.name == "unitree_g1"
    foreign = "FL_hip_joint" if is_g1 else "left_knee"
    if is_g1:  # a Go2 without torque lies beyond its limits by now, and that refusal comes first
        bench.refuses({bench.joint: {"q": bench.here(), "kp": -1.0}}, "outside 0..200")
    bench.refuses({foreign: 0.0}, f"{foreign} is not a joint")
    assert "so101" in why(bench.robot.send_action({bench.joint: bench.here()}, robot_name="so101"))


def test_an_invalid_duration_or_step_count_starts_nothing(bench: Bench) -> None:
    bench.armed()
    for name, values in {
        "duration": (NAN, float("inf"), 0, -1, "3"),
        "n_steps": (True, 0, -1, 2.5),
    }.items():
        for value in values:
            assert f"{name} is {value!r}" in why(bench.robot.run_policy(hold, **{name: value}))
    for policy in (None, object()):
        assert "get_actions_sync" in why(bench.robot.run_policy(policy))
    assert not task(bench.robot)["running"]


def test_a_rollout_ends_with_its_reason_in_a_soft_stop(bench: Bench) -> None:
    for make, budget, reason, says in (
        (lambda: Stand(bench.other), {"n_steps": 5}, "n_steps", "5 steps"),
        (lambda: Stand(bench.other), {"duration": 0.05}, "duration", "0.05 s"),
        (lambda: lambda seen: None, {}, "policy", "not an action"),
        (lambda: lambda seen: 1 / 0, {}, "policy", "division by zero"),
        (lambda: lambda seen: {"typo": 1.0}, {}, "gate", "typo is not a joint"),
    ):
        until(  # each time with a new policy, because the joint has fallen since the last one
            lambda make=make, budget=budget, reason=reason: bench.runs(make(), **budget)["exit_reason"] == reason,
            f"the rollout ends by {reason}",  # a busy machine may end it for another reason
        )
        ended = task(bench.robot)
        assert says in ended["exit_detail"], ended
        assert task(bench.robot) == ended  # a later call gets the same answer
        assert bench.twin.log.host("safe")[-1].safe_state == "zero_torque"
    bench.armed()
    json_of(bench.robot.run_policy(Stand(bench.other), duration=30.0))
    assert "already running" in why(bench.robot.run_policy(hold))
    halted = json_of(bench.robot.stop_task())
    assert halted["stopped"] and halted["exit_reason"] == "stopped"
    assert json_of(bench.robot.stop_task()) == halted


def test_below_the_battery_floor_no_verb_moves_the_robot(bench: Bench) -> None:
    bench.armed()
    bench.twin.order("battery 4")
    bench.sensor("battery_pct", 4.0)
    bench.refuses({bench.joint: bench.here()}, "battery 4.0 % is below the minimum of 15.0 %")
    assert bench.robot.run_policy(hold)["status"] == "error"
    assert bench.robot.start_task("walk")["status"] == "error"
    bench.twin.order("battery 80")
    bench.sensor("battery_pct", 80.0)


@pytest.mark.parametrize("either", ["g1"], indirect=True)
def test_a_g1_is_moved_only_in_fsm_500_501_and_801(either: Bench) -> None:
    either.armed()
    for fsm in (0, 1, 3, 4):
        either.twin.order(f"fsm {fsm}")
        either.sensor("fsm", fsm)
        either.refuses({either.joint: either.here()}, f"FSM {fsm} ")
        assert all(
            each in why(either.robot.send_action({either.joint: either.here()})) for each in ("500", "501", "801")
        )
        assert either.robot.run_policy(hold)["status"] == "error"
    for fsm in (500, 501, 801):
        either.twin.order(f"fsm {fsm}")
        either.sensor("fsm", fsm)
        assert either.moved(either.joint)["fsm_id"] == fsm


def test_the_verbs_of_an_agent_are_those_of_the_schema(bench: Bench) -> None:
    verbs = bench.robot.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["sensors", "status", "stop", *bench.robot.driver.SERVICES], "the services need an approval"
    for other in ("home", "walk", ""):
        assert repr(other) in why(ask(bench.robot, action=other))
    sensed = json_of(ask(bench.robot, action="sensors"))["sensors"]
    assert sensed["battery_pct"] == [80.0] and len(sensed["rpy_rad"]) == 3
    stopped = json_of(ask(bench.robot, action="stop"))
    assert stopped["safe_state"] == "zero_torque" and stopped["unconfirmed"] == []
    assert "resume() first" in why(bench.robot.send_action({bench.joint: 0.0}))
