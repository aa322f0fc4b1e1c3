"""The result of a stop as a closed type. Pure.

Every operation that ends motion (stop, e-stop, release, the end of a task, cleanup) has one of three results. A
missing answer is never success (SAF-023), so ``None`` is no result.

    Confirmed      every motor was read back and is safe, or this tree has energised nothing
    Unconfirmed    the stop was ordered, and the named motors have not confirmed it
    Unreachable    no process answered that knows the state; all motors of the robot are named

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


class NothingRan(msgspec.Struct, frozen=True):
    """This program has started and commanded nothing, so it has energised nothing."""

    why: str = "nothing was running"


class Confirmed(msgspec.Struct, frozen=True):
    proof: StopReport | NothingRan


class Unconfirmed(msgspec.Struct, frozen=True):
    report: StopReport

    @property
    def unsafe(self) -> tuple[MotorReport, ...]:
        """The motors that have not confirmed the stop."""
        return tuple(motor for motor in self.report.motors if not motor.safe)


class Unreachable(msgspec.Struct, frozen=True):
    """No process answered. ``motors`` are those with an unknown state; empty if this program does not know the
    robot's motors."""

    refusal: Refused
    motors: tuple[str, ...]

    @property
    def text(self) -> str:
        named = ", ".join(self.motors) or "any of its motors"
        reason = f"{self.refusal.reason}. not confirmed by {named}"
        return msgspec.structs.replace(self.refusal, reason=reason, remedy=self.refusal.remedy or REMEDY).text


StopResult = Confirmed | Unconfirmed | Unreachable

REMEDY = "look at the robot, and cut its power if it still moves"


def of_report(report: StopReport) -> Confirmed | Unconfirmed:
    return Confirmed(report) if report.confirmed else Unconfirmed(report)


def of_answer(verb: str, answer: Message | None, motors: Sequence[str]) -> StopResult:
    """Return the result that an answer to a stop contains.

    Args:
        verb: The verb of the order, for refusals.
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
    return Unreachable(Refused(Code.NO_ANSWER, "no answer", REMEDY, verb=verb), tuple(motors))


def silent(
    verb: str, why: object, driver: Driver, remedy: str = REMEDY, code: str = Code.UNREACHABLE
) -> Unreachable:
    """Return the result of a stop without an answer."""
    return Unreachable(Refused(code, str(why), remedy, verb=verb), driver.axes)


def timed_out(why: str, result: StopResult, confirmed: str, remedy: str) -> Refused:
    """Return the refusal of a request that was not answered in time, so that the robot was stopped.

    Args:
        why: Which request was not answered.
        result: The result of the stop.
        confirmed: The text for a confirmed stop.
        remedy: The remedy for a confirmed stop.
    """
    match result:
        case Confirmed():
            return Refused(Code.TIMEOUT, f"{why}; {confirmed}", remedy)
        case Unconfirmed(report):
            named = ", ".join(report.unconfirmed) or "the robot"
            return Refused(Code.TIMEOUT, f"{why}; its stop is not confirmed by {named}", REMEDY)
        case Unreachable():
            return Refused(Code.TIMEOUT, f"{why}; {result.text}")
        case never:
            assert_never(never)
