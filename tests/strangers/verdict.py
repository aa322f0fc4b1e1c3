"""Judge a program by what the robot's body did. Pure functions: no I/O, no clock.

the program                 the body                       verdict
ran to its end              is where it was sent           REACHED
ran to its end              moved, and no place is given   MOVED
ran to its end              was not asked to move          RAN
ran to its end              was sent and stood still       NOTHING   the robot said "done" and did nothing
ran to its end              did something else             ELSEWHERE
got the robot's own error   (any)                          REFUSED   the row of the table says why
    has a fault of its own      (any)                          BROKEN    the row of the table says which
failed                      (any)                          FAILED
did not end by itself       (any)                          CUT_OFF   for an endless program as if it had ended
(any)                       could not be read              LOST      the twin has ended
"""

from __future__ import annotations

import enum
import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from .body import AxisWay
from .table import Program

ASKING = ("setpoint",)
"""Kinds of frames that ask the robot to move."""


class Verdict(enum.StrEnum):
    """What became of a program."""

    REACHED = "reached"
    MOVED = "moved"
    RAN = "ran"
    REFUSED = "refused"
    BROKEN = "broken"
    NOTHING = "done for nothing"
    ELSEWHERE = "elsewhere"
    FAILED = "failed"
    CUT_OFF = "cut off"
    LOST = "the twin ended"
    ABSENT = "not run"


GOOD = (Verdict.REACHED, Verdict.MOVED, Verdict.RAN)
HONEST = (*GOOD, Verdict.REFUSED, Verdict.BROKEN, Verdict.ABSENT)
"""With another verdict the command ends with an error."""


class Seen(NamedTuple):
    """What was seen of one run of a program.

    Attributes:
        code: Its exit code. None: it was ended after its time.
        output: The last lines of its output, and of its errors.
        calls: The number of frames that it sent, by kind.
        rows: The way of every axis.
        moved: The way of the axes that moved.
        lost: Why the body could not be read; empty if it could.
        errors: The errors that the robot sent, as the twin has logged them.
    """

    code: int | None
    output: str
    calls: Mapping[str, int]
    rows: Mapping[str, AxisWay]
    moved: Mapping[str, AxisWay]
    lost: str = ""
    errors: tuple[str, ...] = ()


class Judged(NamedTuple):
    """A verdict, and its reason in a few words. The reason is empty if the verdict says all."""

    verdict: Verdict
    reason: str = ""


def judge(program: Program, seen: Seen) -> Judged:
    """Return the verdict on one run of a program."""
    if seen.lost:
        return Judged(Verdict.LOST, seen.lost)
    refused = re.search(program.refusal, seen.output) if program.refusal else None
    if refused is not None and program.broken:
        return Judged(Verdict.BROKEN, program.broken)
    if refused is not None:
        return Judged(Verdict.REFUSED, program.lacks or one_line(refused.group()))
    if seen.code is None and not program.endless:
        return Judged(Verdict.CUT_OFF, f"after {program.seconds:g} s")
    if seen.code:
        return Judged(Verdict.FAILED, last_line(seen.output) or f"exit code {seen.code}")
    judged = _judge_body(program, seen)
    if judged.verdict is Verdict.NOTHING and seen.errors:
        # The robot has not said "done". The client has kept its error from the program.
        return Judged(Verdict.REFUSED, program.lacks or one_line(seen.errors[0]))
    return judged


def _judge_body(program: Program, seen: Seen) -> Judged:
    """Return the verdict on a program that ran to its end."""
    sent = _axes_sent(program)
    if unknown := [axis for axis in sent if axis not in seen.rows]:
        names = ", ".join(seen.rows)
        return Judged(Verdict.ELSEWHERE, f"the body has no axis {unknown[0]}. It has {names}")
    stood = [axis for axis in sent if axis not in seen.moved]
    if sent and len(stood) == len(sent):
        return Judged(Verdict.NOTHING, f"{', '.join(sent)} did not move")
    # An axis that was at its place from the begin need not move.
    stood = [axis for axis in stood if axis not in program.reaches or _is_elsewhere(program, seen, axis)]
    if not seen.moved and _should_move(program, seen):
        return Judged(Verdict.NOTHING, "no axis moved")
    if program.moves is False and seen.moved:
        return Judged(Verdict.ELSEWHERE, f"{', '.join(seen.moved)} moved, but it only reads")
    if missed := "; ".join([*(f"{axis} did not move" for axis in stood), *_missed(program, seen)]):
        return Judged(Verdict.ELSEWHERE, missed)
    if program.reaches or program.passes:
        return Judged(Verdict.REACHED)
    return Judged(Verdict.MOVED if _should_move(program, seen) else Verdict.RAN)


def _axes_sent(program: Program) -> tuple[str, ...]:
    """Return the axes that the row of the table names."""
    named = program.moves if isinstance(program.moves, tuple) else ()
    return tuple(dict.fromkeys([*named, *program.reaches, *program.passes]))


def _should_move(program: Program, seen: Seen) -> bool:
    if _axes_sent(program):
        return True
    if isinstance(program.moves, bool):
        return program.moves
    return any(seen.calls.get(kind, 0) for kind in ASKING)


def _missed(program: Program, seen: Seen) -> Iterator[str]:
    """Yield which axes are not where the program sent them."""
    for axis, goal in program.reaches.items():
        if _is_elsewhere(program, seen, axis):
            yield f"{axis} is at {seen.rows[axis].end:.3g}, sent to {goal:g}"
    for axis, goal in program.passes.items():
        row = seen.rows[axis]
        if not min(abs(row.least - goal), abs(row.most - goal)) <= program.within:
            yield f"{axis} was between {row.least:.3g} and {row.most:.3g}, and should turn at {goal:g}"


def _is_elsewhere(program: Program, seen: Seen, axis: str) -> bool:
    return not abs(seen.rows[axis].end - program.reaches[axis]) <= program.within


def one_line(text: str, longest: int = 100) -> str:
    """Return a text as one line without paths of this machine, and not longer than ``longest``."""
    line = re.sub(r"(?:/[\w.+@-]+){2,}/", "", " ".join(text.split()))
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def last_line(output: str) -> str:
    """Return the last line of an output that names an error, else the last line."""
    lines = [line for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if re.match(r"[\w.]*(?:Error|Exception)\b", line)]
    return one_line((errors or lines)[-1]) if lines else ""


__all__ = ["GOOD", "HONEST", "Judged", "Seen", "Verdict", "judge", "last_line", "one_line"]
