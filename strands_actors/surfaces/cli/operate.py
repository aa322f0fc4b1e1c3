"""Stop, e-stop and resume of one robot of this user, by the way its actors speak to each other."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Sequence
from typing import assert_never

import trio

from strands_actors.caller import strays
from strands_actors.caller.directory import Directory
from strands_actors.caller.run_directory import Note, locks_dir
from strands_actors.caller.stop_lines import line_of
from strands_actors.caller.strays import Stray
from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import Resumed, StopReport
from strands_actors.supervisors.root.locks import Locks, locked_robots
from strands_actors.supervisors.stop_result import Confirmed, StopResult, Unconfirmed, Unreachable

Verb = Callable[[Directory, Note], Awaitable[tuple[bool, str]]]
"""Does it to one robot: whether that was confirmed, and a line for people."""


async def stop(joined: Directory, note: Note) -> tuple[bool, str]:
    return _told(await joined.stop(note, Reason.STOP, by()))


async def estop(joined: Directory, note: Note) -> tuple[bool, str]:
    result = await joined.stop(note, Reason.ESTOP, by(), lock=True)
    confirmed, line = _told(result)
    return confirmed, line + locked_until(note.robot, _why_not_locked(result, note))


def _why_not_locked(result: StopResult, note: Note) -> str:
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
    return False, answer.text


VERBS: dict[str, Verb] = {"stop": stop, "e-stop": estop, "resume": resume}


def _told(result: StopResult) -> tuple[bool, str]:
    return isinstance(result, Confirmed), line_of(result)


async def end(lost: Sequence[Stray], lock: bool) -> tuple[bool, str]:
    """End trees that nobody can ask: never more than half done, since no motor was read back
    here."""
    gone = all([await trio.to_thread.run_sync(strays.end, stray) for stray in lost])
    robot, what = lost[0].robot, lost[0].text
    became = "its wire has ended after it: it makes safe first" if gone else "ITS WIRE HAS NOT ENDED"
    line = f"NOT CONFIRMED: {what}, which was ended. {became}. cut its power if it still moves"
    return False, line + (locked_until(robot, _lock_the_next(robot)) if lock else "")


def locked_until(robot: str, problem: str) -> str:
    """For people. ``problem``: why the lock is not on the disk."""
    return f"; locked until `strands-actors resume {robot}`{f'. BUT {problem}' if problem else ''}"


def _lock_the_next(robot: str, port: str = "") -> str:
    """Nobody of its tree has answered: its next tree is to be locked at least, and the next one on
    its port, whatever that is called. Why that cannot be, or nothing."""
    try:
        Locks(locks_dir(), robot, port).put(by())
    except OSError as error:
        return f"the lock cannot be kept: {error}"
    return ""


def locked() -> list[str]:
    """Return the names of robots that are locked, whether a tree of theirs runs or not. Raise
    ``OSError``."""
    return locked_robots(locks_dir())


def lift(robot: str) -> tuple[bool, str]:
    """The lock of a robot of which no tree runs: whether it is gone, and a line for people."""
    locks = Locks(locks_dir(), robot)
    lock = locks.find()
    try:
        locks.lift()
    except OSError as error:
        return False, f"its lock cannot be lifted: {error}"
    if lock is None:
        return True, "it was not locked"
    since = f", {lock.since}" if lock.since else ""
    return True, f"the e-stop by {lock.by}{since} is lifted. no tree of it runs: nothing was energised"


def by() -> str:
    return f"the command line (process {os.getpid()})"
