"""``stop``, ``estop`` and ``resume`` from another process than the robot's own."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable

import trio

from .. import directory
from ..directory import Directory
from ..rundir import Note
from ..runtime.contract import Reason
from ..runtime.messages import Refused
from ..supervisors.messages import Resumed, StopReport
from .errors import Problem

NOT_CONFIRMED = 1

Verb = Callable[[Directory, Note], Awaitable[tuple[bool, str]]]
"""Does it to one robot: whether that was confirmed, and a line for people."""


def stop(robot: str | None, every: bool) -> int:
    return trio.run(_each, robot, every, _stop)


def estop(robot: str | None, every: bool) -> int:
    return trio.run(_each, robot, every, _estop)


def resume(robot: str | None, every: bool) -> int:
    return trio.run(_each, robot, every, _resume)


async def _stop(joined: Directory, note: Note) -> tuple[bool, str]:
    return _told(await joined.stop(note, Reason.STOP, _by()))


async def _estop(joined: Directory, note: Note) -> tuple[bool, str]:
    confirmed, line = _told(await joined.stop(note, Reason.ESTOP, _by(), lock=True))
    return confirmed, f"{line}; locked until `strands-actors resume {note.robot}`"


async def _resume(joined: Directory, note: Note) -> tuple[bool, str]:
    answer = await joined.resume(note, _by())
    if isinstance(answer, Resumed):
        return True, f"armed at the measured position, epoch {answer.epoch}"
    return False, answer.text


VERBS: dict[str, Verb] = {"stop": _stop, "e-stop": _estop, "resume": _resume}


async def _each(robot: str | None, every: bool, verb: Verb) -> int:
    if (robot is None) != every:
        raise Problem("name a robot, or --all")
    async with directory.join() as joined:
        chosen = [note for note in joined.notes if every or note.robot == robot]
        if not chosen:
            names = ", ".join(note.robot for note in joined.notes)
            missing = "no robot" if every else f"no robot {robot!r}"
            raise Problem(f"{missing} of this user is running{f'. there are {names}' if names else ''}")
        confirmed: list[bool] = []

        async def run(note: Note) -> None:
            done, line = await verb(joined, note)
            confirmed.append(done)
            print(f"{note.robot}: {line}", file=sys.stdout if done else sys.stderr, flush=True)

        async with trio.open_nursery() as nursery:  # all at once: none waits for another
            for note in chosen:
                nursery.start_soon(run, note)
    return 0 if all(confirmed) else NOT_CONFIRMED


def _told(report: StopReport | Refused) -> tuple[bool, str]:
    if isinstance(report, Refused):
        return False, f"NOT CONFIRMED: {report.text}"
    if not report.confirmed:
        named = ", ".join(f"{m.axis} (id {m.id}): {m.detail}" for m in report.motors if not m.safe)
        return False, f"NOT CONFIRMED by {named or 'the robot'}. cut its power if it still moves"
    if not report.motors:
        return True, f"{report.rung}, it was already"
    by = " by the root's own path" if report.path == "second" else ""
    return True, f"{report.rung}, {_motors(len(report.motors))} confirmed in {report.took_ms:.1f} ms{by}"


def _motors(count: int) -> str:
    return "1 motor" if count == 1 else f"{count} motors"


def _by() -> str:
    return f"the command line (process {os.getpid()})"
