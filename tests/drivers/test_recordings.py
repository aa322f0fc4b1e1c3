"""Replay a recording of a robot on each wire: gate and watchdog decide again, with equal results. It covers
commands, refusals, the wire's own services and a stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import Twin
from tests.answers import json_of, resumed, state, task_ended, until, why
from tests.trees import connected


class Deeds(NamedTuple):
    """The calls on a robot before and after a stop."""

    before: Callable[[RealRobot, Twin], None]
    afterwards: dict[str, Any]  # a command


def booster(t1: RealRobot, twin: Twin) -> None:
    assert "enable_upper_body() first" in why(t1.send_action({"left_elbow_pitch": 0.1}))
    json_of(t1.enable_upper_body())
    json_of(t1.send_action({"left_elbow_pitch": 0.1}))
    json_of(t1.move(vx=0.2))
    assert "steps" in why(t1.send_action({"left_elbow_pitch": 1.0}))
    time.sleep(0.5)


def crazyflie(drone: RealRobot, twin: Twin) -> None:
    assert "takeoff() first" in why(drone.send_action({"vx": 0.2}))
    json_of(drone.takeoff(height=0.5, duration=1.0))
    json_of(drone.send_action({"vx": 0.2, "z": 0.6}))
    assert "is past" in why(drone.send_action({"z": 2.5}))
    time.sleep(0.5)


def earthrover(rover: RealRobot, twin: Twin) -> None:
    json_of(rover.send_action({"linear": 0.2}))
    json_of(rover.send_action({"lamp": 1.0}))
    assert "is past" in why(rover.send_action({"linear": 1.5}))
    time.sleep(0.5)
    json_of(rover.run_policy(lambda seen: {"linear": 0.1, "angular": 0.1}, duration=1.0))
    task_ended(rover)


def microduck(duck: RealRobot, twin: Twin) -> None:
    assert "Call enable() first" in why(duck.send_action({"vx": 0.1}))
    json_of(duck.enable())
    json_of(duck.send_action({"vx": 0.2, "duration": 0.4}))
    json_of(duck.send_action({"head_yaw": 0.3}))
    assert "vx=0.5 m/s is over 0.3 for walk" in why(duck.send_action({"vx": 0.5}))
    time.sleep(0.6)
    json_of(duck.do(skill="kick_left"))


def reachy_mini(reachy: RealRobot, twin: Twin) -> None:
    json_of(reachy.send_action({"head_yaw": 20.0}))
    assert "is past" in why(reachy.send_action({"head_pitch": 41.0}))
    json_of(reachy.wake())
    json_of(reachy.send_action({"look_x": 1.0, "look_y": 0.2, "look_z": 0.0}))
    json_of(reachy.stop())
    assert "disarmed" in why(reachy.express(move="yes1"))
    json_of(reachy.resume())


def spot(robot: RealRobot, twin: Twin) -> None:
    json_of(robot.resume())
    assert "Call stand() first" in why(robot.send_action({"vx": 0.2}))
    json_of(robot.service("stand"))
    json_of(robot.send_action({"vx": 0.2}))
    json_of(robot.send_action({"arm_sh0": 0.3}))
    assert "is past" in why(robot.send_action({"vx": 2.0}))
    time.sleep(0.8)
    for _ in range(8):
        json_of(robot.send_action({"vy": 0.1, "wz": 0.1}))
        time.sleep(0.1)


def stretch(robot: RealRobot, twin: Twin) -> None:
    json_of(robot.send_action({"lift": 0.52, "head_pan": 0.2}))
    for _ in range(5):
        json_of(robot.set_twist(vx=0.1))
        time.sleep(0.1)
    assert "soft limits" in why(robot.send_action({"arm": 0.6}))
    assert "cannot strafe" in why(robot.set_twist(vy=0.1))
    time.sleep(0.5)


def yahboom(m3: RealRobot, twin: Twin) -> None:
    json_of(m3.home())  # the robot does not report its arm
    json_of(m3.send_action({"linear.x": 0.2}))
    json_of(m3.send_action({"arm1": 0.3, "time_ms": 300}))
    assert "is past" in why(m3.send_action({"linear.x": 1.5}))
    time.sleep(0.5)
    for _ in range(8):
        json_of(m3.send_action({"linear.y": 0.1, "angular.z": 0.1}))
        time.sleep(0.1)


def arm(joint: str, past: dict[str, float], trouble: str, over: str) -> Callable[[RealRobot, Twin], None]:
    """Return the calls for an arm that its controller stops in between."""

    def deeds(robot: RealRobot, twin: Twin) -> None:
        here = robot.get_observation()[joint]
        json_of(robot.send_action({joint: here + 0.02}))
        assert "steps" in why(robot.send_action({joint: here + 1.0}))
        assert "is past" in why(robot.send_action(past))
        began_s = time.monotonic()
        sway = lambda seen: {joint: here + 0.02 + 0.05 * math.sin(time.monotonic() - began_s)}  # noqa: E731
        json_of(robot.run_policy(sway, duration=1.0))
        task_ended(robot)
        twin.order(trouble)
        until(lambda: state(robot) == "disarmed", "it is disarmed")
        twin.order(over)
        resumed(robot)

    return deeds


ROBOTS = {
    "booster_t1": Deeds(booster, {}),
    "crazyflie": Deeds(crazyflie, {}),
    "earthrover": Deeds(earthrover, {"angular": -0.2}),
    "microduck": Deeds(microduck, {"vyaw": -0.2, "duration": 0.3}),
    "rby1": Deeds(
        arm("head_0", {"torso_0": 4.0}, "emergency-stop pressed", "emergency-stop released"),
        {},
    ),
    "reachy_mini": Deeds(reachy_mini, {"antenna_left": 5.0}),
    "spot": Deeds(spot, {"arm_f1x": -0.5}),
    "stretch3": Deeds(stretch, {"wrist_roll": 0.2}),
    "xarm7": Deeds(arm("joint1", {"joint4": 4.0}, "error 31", "error 0"), {}),
    "yahboom_m3pro": Deeds(yahboom, {"linear.x": 0.1}),
}
"""Other wires have their recordings tested in their own tests: so101, Franka, Kinova and KUKA."""


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ROBOTS)
def test_a_recording_replays_with_equal_decisions(name: str, tmp_path: Path, run_dir: Path) -> None:
    deeds = ROBOTS[name]
    path = tmp_path / "run.mcap"
    with (
        Twin(name, tmp_path) as twin,
        Robot(name, mode="real", port=twin.port) as robot,
        record(connected(robot), path),
    ):
        deeds.before(robot, twin)
        json_of(robot.stop())
        until(lambda: state(robot) == "disarmed", "it is disarmed")
        json_of(robot.resume())
        if deeds.afterwards:
            json_of(robot.send_action(deeds.afterwards))
        time.sleep(0.4)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
