"""A session with a Franka arm by pylibfranka: ``libfranka_session.py HOST``. Each event is printed as JSON.

It runs in the environment of pylibfranka, so it imports nothing of this project.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import pylibfranka as franka

SECONDS = 1.0
TURN_RAD = 0.1
RISE_M = 0.05
CYCLES = 20_000
SETTLE_S = 0.5
START_S = 4.0
START_RAD = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)
"""The pose from which both robots move. Each simulator begins in another one."""
IMPEDANCE = franka.ControllerMode.JointImpedance
JOINTS = range(7)


def say(
    name: str,
    answer: str = "",
    values: dict[str, float] | None = None,
    *,
    took_s: float | None = None,
    near: float = 0.01,
) -> None:
    event = {"name": name, "answer": answer, "took_s": took_s, "values": values or {}, "near": near}
    print(json.dumps(event), flush=True)


def joints(prefix: str, row: Sequence[float]) -> dict[str, float]:
    return {f"{prefix}{number + 1}": float(row[number]) for number in JOINTS}


def place(state: Any) -> list[float]:
    return [float(value) for value in state.O_T_EE[12:15]]


def error_of(step: Callable[[], object]) -> str:
    """Return the class of the error that a step raises, and the robot's reason in it."""
    try:
        step()
    except Exception as error:
        text = str(error)
        reason = text.partition("[")[2].partition("]")[0] if "[" in text else ""
        return f"{type(error).__name__} {reason}".strip()
    return "done"


def run(active: Any, command: Callable[[Any, float], Any], seconds: float = SECONDS) -> float:
    """Run a motion, and return the controller's seconds. ``command`` takes the first state and the share of the
    time that has passed."""
    start, elapsed = None, 0.0
    for _ in range(CYCLES):
        state, duration = active.readOnce()
        start = start or state
        elapsed += duration.to_sec()
        value = command(start, min(elapsed / seconds, 1.0))
        value.motion_finished = elapsed >= seconds
        active.writeOnce(value)
        if elapsed >= seconds:
            break
    return elapsed


def swing(share: float) -> float:
    """The share of the way after a share of the time: a cosine from 0 to 1."""
    return 0.5 * (1 - math.cos(math.pi * share))


def speed(share: float) -> float:
    """The speed that covers the way 1 in ``SECONDS``."""
    return 0.5 * math.pi / SECONDS * math.sin(math.pi * share)


def to_start(first: Any, share: float) -> Any:
    way = [goal - here for goal, here in zip(START_RAD, first.q_d, strict=True)]
    return franka.JointPositions([here + by * swing(share) for here, by in zip(first.q_d, way, strict=True)])


def turned(first: Any, share: float) -> Any:
    return franka.JointPositions([first.q_d[0] + TURN_RAD * swing(share), *first.q_d[1:]])


def turning_back(_: Any, share: float) -> Any:
    return franka.JointVelocities([-TURN_RAD * speed(share), *([0.0] * 6)])


def raised(first: Any, share: float) -> Any:
    pose = list(first.O_T_EE_c if any(first.O_T_EE_c) else first.O_T_EE)
    pose[14] += RISE_M * swing(share)
    return franka.CartesianPose(pose)


def sinking(_: Any, share: float) -> Any:
    return franka.CartesianVelocities([0.0, 0.0, -RISE_M * speed(share), 0.0, 0.0, 0.0])


def jumping(first: Any, share: float) -> Any:
    return franka.JointPositions([first.q_d[0] + (0.2 if share > 0.1 else 0.0), *first.q_d[1:]])


def settled(robot: Any) -> Any:
    time.sleep(SETTLE_S)
    return robot.read_once()


def motion(robot: Any, name: str, begin: Callable[..., Any], command: Callable[[Any, float], Any]) -> None:
    """Run one motion, and say how far joints and end effector moved."""
    before = robot.read_once()
    controller_s = 0.0

    def step() -> None:
        nonlocal controller_s
        controller_s = run(begin(IMPEDANCE), command)

    answer = error_of(step)
    say(name, answer, took_s=controller_s)
    after = settled(robot)
    moved = [there - here for there, here in zip(after.q, before.q, strict=True)]
    x, y, z = (there - here for there, here in zip(place(after), place(before), strict=True))
    say(f"after {name}", str(after.robot_mode), {**joints("q", moved), "x": x, "y": y, "z": z})


def main(host: str) -> None:
    robot = franka.Robot(host, franka.RealtimeConfig.kIgnore)
    begin = robot.start_joint_position_control
    say("connected")
    state = settled(robot)
    say("first state", str(state.robot_mode))
    say("to the start pose", error_of(lambda: run(begin(IMPEDANCE), to_start, START_S)))
    x, y, z = place(state := settled(robot))
    say("start pose", str(state.robot_mode), {**joints("q", state.q), "x": x, "y": y, "z": z})
    say("at rest", values=joints("dq", state.dq), near=0.02)
    say("torques at rest", values=joints("tau", state.tau_J), near=2.0)
    motion(robot, "joint positions", robot.start_joint_position_control, turned)
    motion(robot, "joint velocities", robot.start_joint_velocity_control, turning_back)
    motion(robot, "Cartesian pose", robot.start_cartesian_pose_control, raised)
    motion(robot, "Cartesian velocities", robot.start_cartesian_velocity_control, sinking)
    say("jump of a joint", error_of(lambda: run(begin(IMPEDANCE), jumping)))
    say("after the jump", str(robot.read_once().robot_mode))
    say("recovery", error_of(robot.automatic_error_recovery))
    say("after the recovery", str(settled(robot).robot_mode))
    motion(robot, "joint positions again", robot.start_joint_position_control, turned)
    say("stop", error_of(robot.stop))


if __name__ == "__main__":
    main(sys.argv[1])
    os._exit(0)
