"""Common steps for tests of any robot's tree: connect it, move it, check that it recovers.

The checks read the log of the twin's wire.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin, WireLog
from strands_actors.testing.wirelog import Entry
from tests.answers import PATIENCE_S, json_of, resumed, state, status, task, task_ended, until, why

Step = Callable[[Mapping[str, float]], dict[str, float]]
"""A policy as a function from an observation to an action."""

ATTEMPTS = 5
"""How often a rollout is started. On a machine that pauses, one may end before the fault of the test."""


@contextlib.contextmanager
def shared_twin(twin: Twin, *orders: str) -> Iterator[Twin]:
    """Give a test the twin that the tests of its module share, with an empty log, and repair it afterwards.

    Args:
        twin: The twin.
        orders: Orders to the twin that undo the faults which only this robot has.
    """
    os.truncate(twin.log.path, 0)
    yield twin
    twin.go_on()
    twin.fault("ok")
    twin.plug()
    for line in orders:
        twin.order(line)


def connected(robot: RealRobot) -> RealRobot:
    """Connect and arm the robot, and return it. On a busy machine a process may be late enough to count
    as frozen, so try again.
    """
    deadline_s = time.monotonic() + PATIENCE_S
    while (problem := robot.connect_eagerly()) is not None:
        assert time.monotonic() < deadline_s, f"the robot does not connect: {problem}"
    return robot


def is_lost_while_stuck(robot: RealRobot, twin: Twin, action: Mapping[str, float], refusal_text: str) -> None:
    """Freeze only the robot's reports, and check that it counts as lost until they change again.

    All connections stay open meanwhile, and every call is answered.

    Args:
        robot: The robot.
        twin: Its twin.
        action: An action that is sent, and refused, meanwhile.
        refusal_text: A part of the refusal's text.
    """
    twin.fault("stuck")
    until(lambda: state(robot) == "lost", "the robot counts as lost")
    lost_ns = time.monotonic_ns()
    assert refusal_text in why(robot.send_action(dict(action)))
    time.sleep(1.0)
    assert twin.log.host("setpoint", lost_ns) == []
    assert twin.log.host("safe", lost_ns), "the robot gets a safe frame"
    assert not status(robot)["connected"], "the robot is not connected again"
    twin.fault("ok")
    until(lambda: state(robot) == "disarmed", "the robot is connected again, disarmed")
    assert twin.log.host("setpoint", lost_ns) == []


@contextlib.contextmanager
def robot_on(port: str, name: str, **options: Any) -> Iterator[RealRobot]:
    """Give a connected and armed robot, and clean it up in any case."""
    robot = Robot(name, mode="real", port=port, **options)
    try:
        yield connected(robot)
    finally:
        robot.cleanup()


def armed(robot: RealRobot) -> None:
    """Resume the robot, unless it is armed or holding."""
    if state(robot) not in ("armed", "holding"):
        resumed(robot)


def nudge(robot: RealRobot, joint: str, step: float = 0.01) -> Mapping[str, Any]:
    """Send a small step of a joint from its position towards zero."""
    now = robot.get_observation().get(joint, 0.0)
    answer: Mapping[str, Any] = robot.send_action({joint: now - math.copysign(step, now)})
    return answer


def wave(amplitudes: Mapping[str, float], phase_step: float) -> Step:
    """Return a policy that swings joints from their first position and back. It counts calls and not
    time, so that joints do not jump after a pause."""
    zero: dict[str, float] = {}
    phase = 0.0

    def policy(observation: Mapping[str, float]) -> dict[str, float]:
        nonlocal phase
        if not zero:
            zero.update(observation)
        phase += phase_step
        return {joint: zero[joint] + size * (1 - math.cos(phase)) / 2 for joint, size in amplitudes.items()}

    return policy


def set_moving(robot: RealRobot, log: WireLog, new_policy: Callable[[], Step], setpoints: int = 30) -> None:
    """Begin a rollout, and wait for more than ``setpoints`` setpoints on the wire."""
    begin_moving(
        robot,
        lambda: robot.run_policy(new_policy(), duration=60.0),
        lambda _, began_ns: len(log.host("setpoint", began_ns)) > setpoints,
    )


def begin_moving(
    robot: RealRobot, begin: Callable[[], Mapping[str, Any]], moves: Callable[[dict[str, Any], int], bool]
) -> None:
    """Begin a task and wait until the robot moves.

    Args:
        robot: The robot.
        begin: Starts the task.
        moves: Decides whether the robot moves, from the status of the task and the time of its start in
            nanoseconds of CLOCK_MONOTONIC.
    """

    def moves_or_ended(began_ns: int) -> dict[str, Any] | None:
        now = task(robot)
        return now if not now["running"] or moves(now, began_ns) else None

    now: dict[str, Any] = {}
    for _ in range(ATTEMPTS):
        began_ns = time.monotonic_ns()
        armed(robot)
        json_of(begin())
        now = until(functools.partial(moves_or_ended, began_ns), "the robot moves or the task has ended")
        if now["running"]:
            return
    pytest.fail(f"the robot does not move: {now}")


def run_for(robot: RealRobot, new_policy: Callable[[], Step], duration_s: float) -> dict[str, Any]:
    """Run a rollout to its end, and return its last status."""
    return run_to_end(robot, lambda: robot.run_policy(new_policy(), duration=duration_s))


def run_to_end(
    robot: RealRobot, begin: Callable[[], Mapping[str, Any]], exit_reason: str = "duration"
) -> dict[str, Any]:
    """Begin a task by ``begin``, wait until it has ended for this reason, and return its last status."""
    now: dict[str, Any] = {}
    for _ in range(ATTEMPTS):
        armed(robot)
        json_of(begin())
        now = task_ended(robot)
        if now["exit_reason"] == exit_reason:
            return now
    pytest.fail(f"the task does not run to its end: {now}")


def first_safe(log: WireLog, since_ns: int, safe_state: str | None = None) -> Entry:
    """Wait for the first safe frame; with ``safe_state``, for the first that brings the whole robot into it."""

    def look() -> Entry | None:
        frames = log.host("safe", since_ns)
        return next((one for one in frames if safe_state is None or one.safe_state == safe_state), None)

    return until(look, "a safe frame" if safe_state is None else f"a frame of {safe_state}")


def made_safe(log: WireLog, since_ns: int) -> None:
    """Wait for the first safe frame, and check that no setpoint follows it."""
    first_safe(log, since_ns)
    time.sleep(0.3)
    log.no_setpoint_after_safe(since_ns)


def comes_back(robot: RealRobot, log: WireLog, move: Callable[[], Mapping[str, Any]], within: float = 0.01) -> None:
    """Check that the robot recovers by itself, disarmed, and moves only after a resume.

    Args:
        robot: The robot.
        log: The log of its wire.
        move: Sends a command.
        within: How far each axis may be from the position that the resume reported, in its unit.
    """
    back_ns = is_resumed(robot, log, move, within)
    json_of(move())
    until(lambda: log.host("setpoint", back_ns), "a setpoint")


def is_resumed(robot: RealRobot, log: WireLog, move: Callable[[], Mapping[str, Any]], within: float = 0.01) -> int:
    """Check as ``comes_back`` up to the resume. Return the time at which the robot had recovered."""
    until(lambda: state(robot) == "disarmed", "the robot is connected again, disarmed")
    until(lambda: not task(robot)["running"], "the rollout has ended")
    back_ns = time.monotonic_ns()
    assert "resume() first" in why(move())
    time.sleep(0.2)
    log.silent_after(back_ns, "setpoint", "enable")
    resumed = json_of(robot.resume())["position"]
    seen = robot.get_observation()
    assert all(abs(resumed[axis] - seen[axis]) < within for axis in seen)
    return back_ns


def answers_status(robot: RealRobot, times: int = 20) -> None:
    """Check that each of many requests for the status is answered with success."""
    for _ in range(times):
        json_of(robot.get_status())
        time.sleep(0.02)
