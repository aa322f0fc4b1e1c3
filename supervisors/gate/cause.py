"""Decide which cause of a stop is kept: the most specific one that is known shortly after the stop. Pure.

A fault has several symptoms, and the first symptom is seldom the cause. An arm that collides first reports that it
does not move, and only then why. So each cause has a rank. Within ``SOON_NS`` after a stop, a cause with a lower
rank replaces the present one.

    rank             cause
    ORDER            a person or a program ordered a stop or a cleanup
    1, 2, 3, ...     a condition of the robot is broken (the conditions in the driver's order)
    REPORTED         the robot reports a fault, and its driver has no conditions
    FAULT            the robot did not obey: it could not be held or armed
    LINK             the robot no longer answers
    LATE             no setpoint came in time, or its writer ended, so the robot holds

Only conditions that our own stop cannot break are checked (``OnResume.REFUSE``). Otherwise the stop itself would
appear as the cause, since a stopped arm breaks other conditions.
"""

from __future__ import annotations

import enum

import msgspec

from strands_actors.contract.driver import HOLDING_REASONS, Condition, Driver, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS

SOON_NS = round(0.2 * NS)


class Rank(enum.IntEnum):
    """How specific a cause is. A lower rank is more specific. The ranks of the conditions are between ``ORDER`` and
    ``REPORTED``."""

    ORDER = 0
    REPORTED = 10_000
    FAULT = 10_001
    LINK = 10_002
    LATE = 10_003


class Lapse(enum.StrEnum):
    """How a command ended, if no stop or fault ended it. This decides which writer may move the robot next without
    a resume."""

    NONE = ""  # a stop or a fault ended the command, or there was no command
    EXPIRED = "expired"  # the lifetime of the last setpoint ended
    LEASE_RELEASED = "given_back"  # the writer released its lease
    ROLLOUT_ENDED = "rollout_ended"  # a rollout released the lease under which it wrote


class Cause(msgspec.Struct, frozen=True):
    """Why the robot is in its safe state.

    Attributes:
        text: The cause as a text for people. No program reads it.
        reason: The reason of the stop.
        rank: How specific the cause is.
        until_ns: Before this time a more specific cause replaces this one.
        faults: The faults that the robot reported when it was stopped.
        lapse: How the last command ended, if no stop or fault ended it.
    """

    text: str = ""
    reason: Reason | None = None
    rank: int = Rank.ORDER
    until_ns: int = 0
    faults: dict[str, str] = {}
    lapse: Lapse = Lapse.NONE

    def or_more_specific(self, newer: Cause, now_ns: int) -> Cause:
        """Return the cause to keep. It is ``newer``, unless this cause is more specific and recent."""
        return self if now_ns < self.until_ns and self.rank < newer.rank else newer

    def reported(self, now_ns: int) -> Cause:
        """Return this cause with a later ``until_ns``, so that a more specific cause can replace it for at least
        ``SOON_NS`` from now. An order to stop is returned unchanged. More time is needed because the wire process
        reads the robot's faults only after it has reported the stop."""
        if self.rank == Rank.ORDER:
            return self
        return msgspec.structs.replace(self, until_ns=max(self.until_ns, now_ns + SOON_NS))

    def refined(self, driver: Driver, observation: Observation, now_ns: int) -> Cause:
        """Return a more specific cause if this observation of the robot shows one; otherwise this cause."""
        if now_ns >= self.until_ns:
            return self
        for rank, condition in enumerate(driver.conditions, Rank.ORDER + 1):
            if rank >= self.rank:
                break
            if condition.on_resume is OnResume.REFUSE and not condition.is_silence:
                refusal = condition.check(observation, now_ns)
                if refusal is not None:
                    text = refusal.reason
                    return self._replaced(text, condition.reason, rank)
        if not driver.conditions and self.rank > Rank.REPORTED:
            new = {name: fault for name, fault in observation.faults.items() if self.faults.get(name) != fault}
            if new:
                text = ", ".join(f"{name}: {fault}" for name, fault in new.items())
                return self._replaced(text, Reason.FAULT, Rank.REPORTED)
        return self

    def _replaced(self, text: str, reason: Reason, rank: int) -> Cause:
        """Return this cause with a more specific text and reason. ``lapse`` is cleared, since a fault ended the
        command."""
        return msgspec.structs.replace(self, text=text, reason=reason, rank=rank, lapse=Lapse.NONE)


def rank_of_condition(driver: Driver, condition: Condition) -> int:
    """Return the rank, as a cause of a stop, of a failed condition (a check of the robot's state)."""
    return Rank.LINK if condition.is_silence else Rank.ORDER + 1 + driver.conditions.index(condition)


def rank_of(reason: Reason) -> Rank:
    """Return the rank of a cause of which only the reason is known."""
    if reason in HOLDING_REASONS:
        return Rank.LATE
    if reason in (Reason.FAULT, Reason.WIRE):
        return Rank.FAULT
    return Rank.LINK if reason is Reason.LINK else Rank.ORDER
