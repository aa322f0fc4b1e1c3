"""Motions with a duration: ``move_to``, ``move_along`` a path, and ``hold`` speeds for some seconds.

Each motion is a stream of setpoints from this process at the control rate. A setpoint expires after its
lifetime. The stream needs the lease (the right to command the robot). A stop, a hold, or a dead or frozen
program ends it. If the robot plans such a motion by itself (``Driver.timed``), one command is sent instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import trio

from strands_actors.contract.plain_numbers import as_python
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.failsafe import Mode

from ..session.motions import (
    LONGEST_HELD_S,
    LONGEST_S,
    Motion,
    RobotReading,
    plan_hold,
    plan_move,
    refuse_seconds,
    refuse_targets,
)
from ..session.paths import MOVE_ALONG, Path, check_along, plan_along, read_path
from ..session.tree import RobotTree
from . import envelopes as answers
from .envelopes import Answer

LOOK_S = 0.05
"""Period of the check of a robot that carries out a motion by itself."""
CHECKED = 50
"""Number of steps of a path that are checked at once. Between them this process sends heartbeats."""
DEFAULT_S = 2.0
"""Default duration of ``move_to``."""


async def move_to(tree: RobotTree, targets: Mapping[str, Any], seconds: float, wait: bool) -> Answer:
    """Move the named joints to their targets. The arguments are those of ``RealRobot.move_to``."""
    driver, seconds = tree.driver, as_python(seconds)
    refusal = refuse_targets(driver, targets) or refuse_seconds("move_to", "seconds", seconds, LONGEST_S)
    if refusal is not None:
        return answers.refused(refusal)
    status = await tree.status()
    observation = None if status is None else status.observation
    timed = None if observation is None else driver.timed(targets, seconds, observation)
    if isinstance(timed, Refused):
        return answers.refused(timed.about("move_to"))
    if timed is not None:
        return await _command_once(tree, targets, timed, seconds, wait)
    period_s = 1.0 / driver.timing.control_hz
    motion = await tree.rollouts.move(
        "move_to", lambda reading: plan_move(driver, targets, seconds, reading, period_s)
    )
    return await to_its_end(tree, motion, wait)


async def hold(tree: RobotTree, verb: str, action: Mapping[str, Any], seconds: float, wait: bool) -> Answer:
    """Send a command repeatedly for some seconds, then set its speeds to zero.

    Args:
        tree: The robot.
        verb: Name of the user's verb, for refusals.
        action: The command.
        seconds: How long to send it, at most ``LONGEST_HELD_S``.
        wait: True returns at the end, False at once.
    """
    driver, seconds = tree.driver, as_python(seconds)
    refusal = refuse_seconds(verb, "duration_s", seconds, LONGEST_HELD_S)
    if refusal is not None:
        return answers.refused(refusal)
    period_s = 1.0 / driver.timing.control_hz
    motion = await tree.rollouts.move(
        verb, lambda reading: plan_hold(driver, verb, action, seconds, reading, period_s)
    )
    if isinstance(motion, Refused):
        return answers.refused(motion)
    reply = {"robot": tree.robot, "commanded": motion.action(1), "unit": driver.unit, "duration_s": seconds}
    return await _ended(tree, verb, reply, (), wait)


async def move_along(tree: RobotTree, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool) -> Answer:
    """Move to the first row, then along all rows. The arguments are those of ``RealRobot.move_along``."""
    driver, period_s = tree.driver, 1.0 / tree.driver.timing.control_hz
    path = read_path(driver, rows, as_python(hz))
    if isinstance(path, Refused):
        return answers.refused(path)
    refusal = await _refuse_along(tree, path, period_s)
    if refusal is not None:
        return answers.refused(refusal)
    motion = await tree.rollouts.move(MOVE_ALONG, lambda reading: plan_along(driver, path, reading, period_s))
    return await to_its_end(tree, motion, wait, rows=len(path.rows))


async def _refuse_along(tree: RobotTree, path: Path, period_s: float) -> Refused | None:
    """Check each step of a path with the driver's gates (its checks of range and speed).

    Return the first refusal, or None. If the robot was not read or not armed yet, the result is None as well, and
    the motion itself is refused later.
    """
    status = await tree.status()
    if status is None or status.observation is None or not status.target:
        return None
    reading = RobotReading(status.observation, status.target, status.observation.t_ns)
    motion = plan_along(tree.driver, path, reading, period_s)
    if isinstance(motion, Refused):
        return motion
    for number, refusal in enumerate(check_along(tree.driver, motion, path, reading)):
        if refusal is not None:
            return refusal
        if number % CHECKED == 0:
            await trio.lowlevel.checkpoint()
    return None


async def to_its_end(tree: RobotTree, motion: Motion | Refused, wait: bool, **more: Any) -> Answer:
    """Return the answer of a verb that moves the robot to a target, after the motion's end if ``wait`` is true.

    ``motion`` is the started motion, or the refusal to start it.
    """
    if isinstance(motion, Refused):
        return answers.refused(motion)
    last = motion.action(motion.n_steps)
    unit, seconds = tree.driver.unit, round(motion.seconds, 3)
    reply = {"robot": tree.robot, **more, "commanded": last, "unit": unit, "seconds": seconds}
    return await _ended(tree, motion.verb, reply, tuple(last), wait)


async def _ended(tree: RobotTree, verb: str, reply: dict[str, Any], joints: tuple[str, ...], wait: bool) -> Answer:
    """Wait for the end of a motion if ``wait`` is true, and return the answer.

    If the wait is cancelled, the motion ends.
    """
    if not wait:
        return answers.success({**reply, "running": True})
    try:
        ended = await tree.rollouts.wait()
    except trio.Cancelled:
        with trio.CancelScope(shield=True):
            await tree.rollouts.stop_task()
        raise
    reply |= {"took_s": round(ended.elapsed_s, 3)}
    if ended.exit_reason != "n_steps":
        problem = f"{verb}: it did not come to its end: {ended.exit_reason}"
        return answers.error(f"{problem}: {ended.exit_detail}" if ended.exit_detail else problem, reply)
    return answers.success({**reply, **await _position(tree, joints)})


async def _command_once(
    tree: RobotTree, targets: Mapping[str, Any], action: Mapping[str, Any], seconds: float, wait: bool
) -> Answer:
    """Send one command to a robot that plans motions by itself, and watch the robot for ``seconds``."""
    accepted = await tree.send_action(action)
    if isinstance(accepted, Refused):
        return answers.refused(accepted.about("move_to"))
    driver = tree.driver
    reply = {"robot": tree.robot, **driver.accepted(action, accepted.values, accepted.sensors), "seconds": seconds}
    if not wait:
        return answers.success({**reply, "running": True})
    try:
        until_s = trio.current_time() + seconds
        while (remaining_s := until_s - trio.current_time()) > 0:
            await trio.sleep(min(LOOK_S, remaining_s))
            status = await tree.status()
            if status is None:
                return answers.error(
                    "move_to: the process that talks to the robot does not answer, so the result is not known",
                    reply,
                )
            if status.mode not in (Mode.ARMED, Mode.HOLDING):
                return answers.error(f"move_to: the robot is {status.mode} ({status.cause})", reply)
    except trio.Cancelled:
        with trio.CancelScope(shield=True):
            await tree.release()
        raise
    joints = tuple(str(key).removesuffix(".pos") for key in targets)
    return answers.success({**reply, **await _position(tree, joints)})


async def _position(tree: RobotTree, joints: tuple[str, ...]) -> dict[str, Any]:
    """Return the measured positions of the joints, if the robot can be read."""
    observation = await tree.observe()
    if isinstance(observation, Refused) or not joints:
        return {}
    row = answers.positions(tree.driver, observation)
    return {"position": {key: row[key] for key in joints if key in row}}


async def end_motion(tree: RobotTree) -> Answer:
    """End a motion of this module after its caller has stopped waiting for it."""
    status, result = await tree.rollouts.stop_task()
    if status.exit_reason == "stopped":
        return answers.stop_result("stop_task", result)
    released = await tree.release()
    return answers.refused(released) if isinstance(released, Refused) else answers.stop_result("release", released)


__all__ = ["DEFAULT_S", "end_motion", "hold", "move_along", "move_to", "to_its_end"]
