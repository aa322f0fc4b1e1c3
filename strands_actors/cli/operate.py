"""Stop, e-stop and resume of one robot of this user, by the way its actors speak to each other."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable

from ..directory import Directory
from ..rundir import Note
from ..runtime.contract import Reason
from ..runtime.messages import Refused
from ..supervisors.messages import Resumed, StopReport

Verb = Callable[[Directory, Note], Awaitable[tuple[bool, str]]]
"""Does it to one robot: whether that was confirmed, and a line for people."""


async def stop(joined: Directory, note: Note) -> tuple[bool, str]:
    return _told(await joined.stop(note, Reason.STOP, by()))


async def estop(joined: Directory, note: Note) -> tuple[bool, str]:
    confirmed, line = _told(await joined.stop(note, Reason.ESTOP, by(), lock=True))
    return confirmed, f"{line}; locked until `strands-actors resume {note.robot}`"


async def resume(joined: Directory, note: Note) -> tuple[bool, str]:
    answer = await joined.resume(note, by())
    if isinstance(answer, Resumed):
        return True, f"armed at the measured position, epoch {answer.epoch}"
    return False, answer.text


VERBS: dict[str, Verb] = {"stop": stop, "e-stop": estop, "resume": resume}


def _told(report: StopReport | Refused) -> tuple[bool, str]:
    if isinstance(report, Refused):
        return False, f"NOT CONFIRMED: {report.text}"
    if not report.confirmed:
        named = ", ".join(f"{m.axis} (id {m.id}): {m.detail}" for m in report.motors if not m.safe)
        return False, f"NOT CONFIRMED by {named or 'the robot'}. cut its power if it still moves"
    if not report.motors:
        return True, f"{report.rung}, it was already"
    how = " by the root's own path" if report.path == "second" else ""
    return True, f"{report.rung}, {_motors(len(report.motors))} confirmed in {report.took_ms:.1f} ms{how}"


def _motors(count: int) -> str:
    return "1 motor" if count == 1 else f"{count} motors"


def by() -> str:
    return f"the command line (process {os.getpid()})"
