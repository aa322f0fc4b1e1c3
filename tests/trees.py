"""What the tests of any robot's tree do: connect it, have it move, and see it come back. Judged by
the twin's log."""

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
"""A policy that is a function: from an observation to an action."""

ATTEMPTS = 5
"""A machine that pauses ends a rollout before anything was broken: then it is begun again."""


@contextlib.contextmanager
def shared_twin(twin: Twin, *orders: str) -> Iterator[Twin]:
    """Lend a twin that the tests of a module share, with an empty log. Afterwards it is well again:
    ``orders`` undo what only this robot has."""
    os.truncate(twin.log.path, 0)
    yield twin
    twin.go_on()
    twin.fault("ok")
    twin.plug()
    for line in orders:
        twin.order(line)


def connected(robot: RealRobot) -> RealRobot:
    """Connect and arm it; return it. More than one try: on a busy machine a process may be late
    enough to count as frozen."""
    deadline_s = time.monotonic() + PATIENCE_S
    while (problem := robot.connect_eagerly()) is not None:
        assert time.monotonic() < deadline_s, f"it does not connect: {problem}"
    return robot


def is_lost_while_stuck(robot: RealRobot, twin: Twin, action: Mapping[str, float], said: str) -> None:
    """Nothing but its reports stands still: every connection is open, and every call is answered.
    ``said``: of why ``action`` is refused."""
    twin.fault("stuck")
    until(lambda: state(robot) == "lost", "it is noticed")
    lost_ns = time.monotonic_ns()
    assert said in why(robot.send_action(dict(action)))
    time.sleep(1.0)
    assert twin.log.host("setpoint", lost_ns) == []
    assert twin.log.host("safe", lost_ns), "it is told to be safe"
    assert not status(robot)["connected"], "nor is it connected anew"
    twin.fault("ok")
    until(lambda: state(robot) == "disarmed", "it is back, disarmed")
    assert twin.log.host("setpoint", lost_ns) == []


@contextlib.contextmanager
def robot_on(port: str, name: str, **options: Any) -> Iterator[RealRobot]:
    """A robot that is connected and armed, and cleaned up whatever the test does."""
    robot = Robot(name, mode="real", port=port, **options)
    try:
        yield connected(robot)
    finally:
        robot.cleanup()


def armed(robot: RealRobot) -> None:
    """Resume it, if it was disarmed."""
    if state(robot) not in ("armed", "holding"):
        resumed(robot)


def nudge(robot: RealRobot, joint: str, step: float = 0.01) -> Mapping[str, Any]:
    """Ask for a small step from where the joint is, towards zero."""
    now = robot.get_observation().get(joint, 0.0)
    answer: Mapping[str, Any] = robot.send_action({joint: now - math.copysign(step, now)})
    return answer


def wave(amplitudes: Mapping[str, float], phase_step: float) -> Step:
    """Return a policy: joints go to and fro from where they are first seen. A pause does not make
    them jump."""
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
    """Begin a rollout, and see so many setpoints on the wire."""
    begin_moving(
        robot,
        lambda: robot.run_policy(new_policy(), duration=60.0),
        lambda _, began_ns: len(log.host("setpoint", began_ns)) > setpoints,
    )


def begin_moving(
    robot: RealRobot, begin: Callable[[], Mapping[str, Any]], moves: Callable[[dict[str, Any], int], bool]
) -> None:
    """Begin what ``begin`` asks for, and see it move. ``moves``: from what is told of it, and from
    when it began."""

    def moves_or_ended(began_ns: int) -> dict[str, Any] | None:
        now = task(robot)
        return now if not now["running"] or moves(now, began_ns) else None

    now: dict[str, Any] = {}
    for _ in range(ATTEMPTS):
        began_ns = time.monotonic_ns()
        armed(robot)
        json_of(begin())
        now = until(functools.partial(moves_or_ended, began_ns), "it moves or has ended")
        if now["running"]:
            return
    pytest.fail(f"it does not move: {now}")


def run_for(robot: RealRobot, new_policy: Callable[[], Step], duration_s: float) -> dict[str, Any]:
    """Run a rollout to its end; return what is told of it then."""
    return run_to_end(robot, lambda: robot.run_policy(new_policy(), duration=duration_s))


def run_to_end(
    robot: RealRobot, begin: Callable[[], Mapping[str, Any]], exit_reason: str = "duration"
) -> dict[str, Any]:
    """Begin what ``begin`` asks for; return what is told of it when it has ended, for that reason."""
    now: dict[str, Any] = {}
    for _ in range(ATTEMPTS):
        armed(robot)
        json_of(begin())
        now = task_ended(robot)
        if now["exit_reason"] == exit_reason:
            return now
    pytest.fail(f"it does not run to its end: {now}")


def first_safe(log: WireLog, since_ns: int, safe_state: str | None = None) -> Entry:
    """Wait for the first safe frame; with ``safe_state``, for one that brings all of the robot to it."""

    def look() -> Entry | None:
        frames = log.host("safe", since_ns)
        return next((one for one in frames if safe_state is None or one.safe_state == safe_state), None)

    return until(look, "a safe frame" if safe_state is None else f"a frame of {safe_state}")


def made_safe(log: WireLog, since_ns: int) -> None:
    """Wait for the first safe frame, and see that no setpoint comes after it."""
    first_safe(log, since_ns)
    time.sleep(0.3)
    log.no_setpoint_after_safe(since_ns)


def comes_back(robot: RealRobot, log: WireLog, move: Callable[[], Mapping[str, Any]], within: float = 0.01) -> None:
    """It is back by itself, disarmed; what ``move`` asks for is done only after a resume, from where
    the robot is, ``within`` so much of each axis."""
    back_ns = is_resumed(robot, log, move, within)
    json_of(move())
    until(lambda: log.host("setpoint", back_ns), "a setpoint")


def is_resumed(robot: RealRobot, log: WireLog, move: Callable[[], Mapping[str, Any]], within: float = 0.01) -> int:
    """As ``comes_back``, up to the resume; return since when it is back."""
    until(lambda: state(robot) == "disarmed", "it is back, disarmed")
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
    """Ask for its status again and again: each answer comes in time, and says something."""
    for _ in range(times):
        json_of(robot.get_status())
        time.sleep(0.02)
