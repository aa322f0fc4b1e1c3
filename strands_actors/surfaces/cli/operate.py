"""Stop, e-stop and resume one robot of this user by direct messages to the robot's processes, without the mesh
API."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Sequence
from typing import assert_never

import trio

from strands_actors.caller.handle.stop_lines import line_of
from strands_actors.caller.processes import strays
from strands_actors.caller.processes.directory import Directory
from strands_actors.caller.processes.run_directory import Note, locks_dir
from strands_actors.caller.processes.strays import Stray
from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import Resumed, StopReport
from strands_actors.supervisors.root.locks import Locks, locked_robots
from strands_actors.supervisors.stop_result import Confirmed, StopResult, Unconfirmed, Unreachable

from .remedies import OF_RESUME, with_remedy

Verb = Callable[[Directory, Note], Awaitable[tuple[bool, str]]]
"""Carries out a verb on one robot. Returns whether it was confirmed, and a line for the user."""


async def stop(joined: Directory, note: Note) -> tuple[bool, str]:
    return _described(await joined.stop(note, Reason.STOP, by()))


async def estop(joined: Directory, note: Note) -> tuple[bool, str]:
    result = await joined.stop(note, Reason.ESTOP, by(), lock=True)
    confirmed, line = _described(result)
    return confirmed, line + locked_until(note.robot, _reason_not_locked(result, note))


def _reason_not_locked(result: StopResult, note: Note) -> str:
    match result:
        case Confirmed(StopReport(note=problem)) | Unconfirmed(StopReport(note=problem)):
            return problem
        case Confirmed() | Unconfirmed() | Unreachable():
            return _lock_the_next(note.robot, note.port)
        case _:
            assert_never(result)


async def resume(joined: Directory, note: Note) -> tuple[bool, str]:
    answer = await joined.resume(note, by())
    if isinstance(answer, Resumed):
        return True, f"armed at the measured position, epoch {answer.epoch}"
    return False, with_remedy(answer, OF_RESUME).text


VERBS: dict[str, Verb] = {"stop": stop, "e-stop": estop, "resume": resume}


def _described(result: StopResult) -> tuple[bool, str]:
    return isinstance(result, Confirmed), line_of(result)


async def end(lost: Sequence[Stray], lock: bool) -> tuple[bool, str]:
    """End the processes of a robot that cannot be reached by messages.

    The result is never a confirmed stop, since no motor is read.

    Args:
        lost: The unreachable processes of one robot.
        lock: Lock the robot, as an e-stop does.
    """
    all_ended = all([await trio.to_thread.run_sync(strays.end, stray) for stray in lost])
    robot, text = lost[0].robot, lost[0].text
    became = (
        "its wire process, which stops the robot before it ends, has ended"
        if all_ended
        else "ITS WIRE PROCESS HAS NOT ENDED"
    )
    line = f"NOT CONFIRMED: {text}, which was ended. {became}. Cut its power if it still moves"
    return False, line + (locked_until(robot, _lock_the_next(robot)) if lock else "")


def locked_until(robot: str, problem: str) -> str:
    """Return the end of a line for the user. It has the command that lifts the lock of the robot.

    Args:
        robot: The robot's name.
        problem: Why the lock could not be written to the disk. Empty if it was written.
    """
    return f"; locked until `strands-actors resume {robot}`{f'. BUT {problem}' if problem else ''}"


def _lock_the_next(robot: str, port: str = "") -> str:
    """Lock a robot after its processes have not answered. When the robot is started again, the lock prevents
    its motion until a resume.

    Args:
        robot: The robot's name.
        port: The robot's port. A robot with another name on this port is locked, too. Empty if not known.

    Returns:
        Why the lock could not be written. Empty if it was written.
    """
    try:
        Locks(locks_dir(), robot, port).put(by())
    except OSError as error:
        return f"the lock cannot be kept: {error}"
    return ""


def locked() -> list[str]:
    """Return the names of the locked robots, running or not. Raise ``OSError`` if locks cannot be read."""
    return locked_robots(locks_dir())


def lift(robot: str) -> tuple[bool, str]:
    """Lift the lock of a robot that is not running. Return whether it is lifted, and a line for the user."""
    locks = Locks(locks_dir(), robot)
    lock = locks.find()
    try:
        locks.lift()
    except OSError as error:
        return False, f"its lock cannot be lifted: {error}"
    if lock is None:
        return True, "it was not locked"
    since = f", {lock.since}" if lock.since else ""
    return True, f"the e-stop by {lock.by}{since} is lifted. The robot is not running, so nothing was energised"


def by() -> str:
    return f"the command line (process {os.getpid()})"
