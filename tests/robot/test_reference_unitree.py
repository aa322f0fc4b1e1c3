"""What the tests of strands-robots assert of a G1 and a Go2, as behaviours of ours: on one twin each,
through the public names."""

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
        """Legs have no torque after a rollout: as after a stop, they are taken up by who asks."""
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
        """A command to stay, of one moment: what it is told. Its end lets a robot on legs go."""

        def send() -> dict[str, Any] | None:
            self.robot.resume()
            here = self.robot.get_observation()
            action = {joint: {"q": here[joint], **gains} if gains else here[joint] for joint in joints}
            answer = self.robot.send_action(action)
            return json_of(answer) if answer["status"] == "success" else None

        return until(send, "it is written")

    def refuses(self, action: Any, says: str) -> None:
        """For the reason that is meant, not because it was just let go."""

        def refused() -> bool:
            if status(self.robot)["state"] != "armed":
                self.robot.resume()
            return says in why(self.robot.send_action(action))

        until(refused, f"{action} is refused: {says}")


class Stand:
    """Keeps one joint where it is first seen: others may lie past their travel, once let go."""

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self._home: dict[str, float] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self._home = self._home or {self._joint: observation[self._joint]}
        return [self._home] * 250  # half a second: the machine may be busy


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
    """One after the other: a tree at 500 Hz and its twin take a processor."""
    name = request.param
    yield from bench_of(f"unitree_{name}", *JOINTS[name], tmp_path_factory.mktemp(name))


@pytest.fixture
def bench(either: Bench) -> Bench:
    """Ready to be moved: whichever test of this file ran before."""
    if not status(either.robot).get("sport_mode_released", True):
        either.released()
    return either


def test_what_they_tell_of_themselves(bench: Bench) -> None:
    is_g1 = bench.robot.name == "unitree_g1"
    joints = 29 if is_g1 else 12
    told = json_of(bench.robot.state())
    assert len(told["joints"]) == len(told["joint_velocities"]) == joints
    assert told["battery_pct"] == 80.0
    assert len(told["imu"]["rpy"]) == 3 and len(told["imu"]["quaternion"]) == 4
    said = status(bench.robot)
    assert "network_interface" in said  # of a robot that was heard
    assert sorted(said["motors"].values()) == list(range(joints))
    if is_g1:
        assert json_of(bench.robot.state())["fsm_id"] == 801
    else:  # The wire's order, which is not that of the description: front right first.
        legs = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
        assert list(said["motors"]) == legs


@pytest.mark.parametrize("either", ["go2"], indirect=True)
def test_until_it_is_released_a_go2_is_moved_by_no_verb(either: Bench) -> None:
    either.twin.order("mode normal")
    either.sensor("sport_mode_released", 0.0)
    assert status(either.robot)["sport_mode_released"] is False
    for answer in (
        either.robot.send_action({either.joint: either.here()}),
        either.robot.run_policy(hold),
    ):
        assert "sport mode" in why(answer) and "release_sport_mode" in why(answer)
    assert either.robot.start_task("walk")["status"] == "error"
    for attempts in (0, -1, True, "3"):  # the robot is not asked
        told = either.robot.release_sport_mode(attempts=attempts)  # type: ignore[attr-defined]
        assert f"attempts is {attempts!r}" in why(told)
    assert status(either.robot)["sport_mode_released"] is False
    either.released()


@pytest.mark.parametrize("either", ["g1"], indirect=True)
def test_what_is_commanded_is_told(either: Bench) -> None:
    told = either.moved(either.joint, either.other)
    assert (told["topic"], told["fsm_id"]) == ("rt/lowcmd", 801)
    assert told["joints"] == sorted([either.joint, either.other])
    assert either.moved(either.joint, kp=20.0, kd=1.0, dq=0.1, tau=0.05)["joints"] == [either.joint]


def unusable(joint: str, q: float) -> list[tuple[Any, str]]:
    return [
        ({}, "names no joint"),
        ([joint], "must be a mapping"),
        ({"elbow_typo": 0.2, joint: q}, "elbow_typo is not a joint"),
        ({joint: {"kp": 10.0}}, "has no q"),
        ({joint: {"q": q, "K_p": 50.0}}, "K_p is not known"),
        ({joint: "hold"}, f"{joint}.q is hold"),
        ({joint: NAN}, f"{joint}.q is nan"),
        ({joint: {"q": q, "kp": NAN}}, f"{joint}.kp is nan"),
        ({joint: {"q": q, "tau": True}}, f"{joint}.tau is True"),
    ]


def test_an_unusable_action_is_refused_whole(bench: Bench) -> None:
    for action, says in unusable(bench.joint, bench.here()):
        bench.refuses(action, says)
    is_g1 = bench.robot.name == "unitree_g1"
    foreign = "FL_hip_joint" if is_g1 else "left_knee"
    if is_g1:  # a Go2 that was let go lies past its travel by now, which is said first
        bench.refuses({bench.joint: {"q": bench.here(), "kp": -1.0}}, "outside 0..200")
    bench.refuses({foreign: 0.0}, f"{foreign} is not a joint")
    assert "so101" in why(bench.robot.send_action({bench.joint: bench.here()}, robot_name="so101"))


def test_a_budget_that_bounds_nothing_starts_nothing(bench: Bench) -> None:
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


def test_a_rollout_ends_by_name_in_a_soft_stop(bench: Bench) -> None:
    for make, budget, reason, says in (
        (lambda: Stand(bench.other), {"n_steps": 5}, "n_steps", "5 steps"),
        (lambda: Stand(bench.other), {"duration": 0.05}, "duration", "0.05 s"),
        (lambda: lambda seen: None, {}, "policy", "not an action"),
        (lambda: lambda seen: 1 / 0, {}, "policy", "division by zero"),
        (lambda: lambda seen: {"typo": 1.0}, {}, "gate", "typo is not a joint"),
    ):
        until(  # by a policy of its own each time: let go, the joint has fallen since
            lambda make=make, budget=budget, reason=reason: bench.runs(make(), **budget)["exit_reason"] == reason,
            f"it ends by {reason}",  # a busy machine ends it by another
        )
        ended = task(bench.robot)
        assert says in ended["exit_detail"], ended
        assert task(bench.robot) == ended  # for who asks late
        assert bench.twin.log.host("safe")[-1].safe_state == "zero_torque"
    bench.armed()
    json_of(bench.robot.run_policy(Stand(bench.other), duration=30.0))
    assert "already running" in why(bench.robot.run_policy(hold))
    halted = json_of(bench.robot.stop_task())
    assert halted["stopped"] and halted["exit_reason"] == "stopped"
    assert json_of(bench.robot.stop_task()) == halted


def test_under_the_battery_floor_no_verb_moves_it(bench: Bench) -> None:
    bench.armed()
    bench.twin.order("battery 4")
    bench.sensor("battery_pct", 4.0)
    bench.refuses({bench.joint: bench.here()}, "battery 4.0 % is under the floor of 15.0 %")
    assert bench.robot.run_policy(hold)["status"] == "error"
    assert bench.robot.start_task("walk")["status"] == "error"
    bench.twin.order("battery 80")
    bench.sensor("battery_pct", 80.0)


@pytest.mark.parametrize("either", ["g1"], indirect=True)
def test_a_g1_is_moved_only_in_the_states_that_shake_hands(either: Bench) -> None:
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


def test_an_agents_verbs_are_those_of_the_schema(bench: Bench) -> None:
    verbs = bench.robot.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["sensors", "status", "stop", *bench.robot.driver.SERVICES], "services with approval"
    for other in ("home", "walk", ""):
        assert repr(other) in why(ask(bench.robot, action=other))
    sensed = json_of(ask(bench.robot, action="sensors"))["sensors"]
    assert sensed["battery_pct"] == [80.0] and len(sensed["rpy_rad"]) == 3
    stopped = json_of(ask(bench.robot, action="stop"))
    assert stopped["safe_state"] == "zero_torque" and stopped["unconfirmed"] == []
    assert "resume() first" in why(bench.robot.send_action({bench.joint: 0.0}))
