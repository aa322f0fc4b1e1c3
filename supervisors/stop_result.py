"""The result of a stop as a closed type. Pure.

Every operation that ends motion (stop, e-stop, release, the end of a task, cleanup) has one of three results. A
missing answer never counts as success (SAF-023), so ``None`` is no result.

    Confirmed      every motor was read back and is safe, or this program has energised nothing
    Unconfirmed    the stop was ordered, and the named motors have not confirmed it
    Unreachable    no process that knows the state has answered; all motors of the robot are named

``match`` a result exhaustively and end with ``assert_never``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

import msgspec

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import Released, StopReport

from . import refusals
from .refusals import REMEDY


class NothingRan(msgspec.Struct, frozen=True):
    """This program has started no robot and sent no command, so it has energised nothing."""

    reason: str = "nothing was running"


class Confirmed(msgspec.Struct, frozen=True):
    proof: StopReport | NothingRan


class Unconfirmed(msgspec.Struct, frozen=True):
    report: StopReport

    @property
    def unsafe(self) -> tuple[MotorReport, ...]:
        """Return the reports of the motors that have not confirmed the stop."""
        return tuple(motor for motor in self.report.motors if not motor.safe)


class Unreachable(msgspec.Struct, frozen=True):
    """No process has answered. ``motors`` are all motors of the robot, since their state is not known. It is empty
    if this program does not know the motors."""

    refusal: Refused
    motors: tuple[str, ...]

    @property
    def text(self) -> str:
        named = ", ".join(self.motors) or "any of its motors"
        reason = f"{self.refusal.reason}. Not confirmed by {named}"
        return msgspec.structs.replace(self.refusal, reason=reason, remedy=self.refusal.remedy or REMEDY).text


StopResult = Confirmed | Unconfirmed | Unreachable


def of_report(report: StopReport) -> Confirmed | Unconfirmed:
    return Confirmed(report) if report.confirmed else Unconfirmed(report)


def of_answer(verb: str, answer: Message | None, motors: Sequence[str]) -> StopResult:
    """Return the result of a stop from the answer to it.

    Args:
        verb: Name of the operation, for the text of a refusal.
        answer: The answer; None if it is missing.
        motors: All motors of the robot.
    """
    match answer:
        case StopReport():
            return of_report(answer)
        case Released():
            return of_report(answer.report)
        case Refused():
            return Unreachable(answer, tuple(motors))
    return Unreachable(refusals.no_stop_answer(verb), tuple(motors))


def silent(
    verb: str, reason: object, driver: Driver, remedy: str = REMEDY, code: str = Code.UNREACHABLE
) -> Unreachable:
    """Return the result of a stop that was not answered. ``reason`` is the reason for people."""
    return Unreachable(refusals.unreachable(verb, str(reason), remedy, code), driver.axes)


def timed_out(request: str, result: StopResult, confirmed: str, remedy: str) -> Refused:
    """Return the refusal of a request that was not answered in time. The robot was stopped because of this.

    Args:
        request: Which request was not answered.
        result: The result of the stop.
        confirmed: Text to add if the stop was confirmed.
        remedy: What the user should do if the stop was confirmed.
    """
    match result:
        case Confirmed():
            return refusals.late_stopped(request, confirmed, remedy)
        case Unconfirmed(report):
            named = ", ".join(report.unconfirmed) or "the robot"
            return refusals.late_unconfirmed(request, named)
        case Unreachable():
            return refusals.late_unreachable(request, result.text)
        case never:
            assert_never(never)
