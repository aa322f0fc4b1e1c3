"""Decide which cause of a stop is kept: the most specific one that is known soon after it. Pure.

A fault has several symptoms, and the first one is seldom the cause. An arm that collides first
reports that it stands, then why. So a cause has a rank, and for ``SOON_NS`` after a stop a cause of
a lower rank replaces it.

    rank             cause
    ORDER            an order: a stop, a cleanup
    1, 2, 3, ...     a condition of the robot is broken, in the driver's order
    REPORTED         the robot reports a fault, and its driver has no conditions
    FAULT            the robot did not obey: it could not be held or armed
    LINK             the robot no longer answers
    LATE             no setpoint came in time, or its writer ended: a hold

Only conditions that our own stop cannot break are checked (``OnResume.REFUSE``). Otherwise a stopped
arm would be the cause of its stop.
"""

from __future__ import annotations

import enum

import msgspec

from strands_actors.contract.driver import HOLDING_REASONS, Condition, Driver, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS

SOON_NS = round(0.2 * NS)


class Rank(enum.IntEnum):
    """How specific a cause is; a lower rank is more specific. The conditions lie between ``ORDER`` and
    ``REPORTED``."""

    ORDER = 0
    REPORTED = 10_000
    FAULT = 10_001
    LINK = 10_002
    LATE = 10_003


class Lapse(enum.StrEnum):
    """How a command ended by itself. It decides which writer may move the robot next without a
    resume."""

    NONE = ""  # it did not end by itself
    EXPIRED = "expired"  # no setpoint followed in time
    GIVEN_BACK = "given_back"  # its writer gave the lease back
    ROLLOUT_ENDED = "rollout_ended"  # a rollout gave back the lease that it wrote under


class Cause(msgspec.Struct, frozen=True):
    """Why the robot is in its safe state.

    Attributes:
        text: For people. No program reads it.
        reason: The reason of the stop.
        rank: How specific the cause is.
        until_ns: Until then a more specific cause replaces this one.
        faults: The faults that the robot reported at the time of the stop.
        lapse: How the last command ended, if it ended by itself.
    """

    text: str = ""
    reason: Reason | None = None
    rank: int = Rank.ORDER
    until_ns: int = 0
    faults: dict[str, str] = {}
    lapse: Lapse = Lapse.NONE

    def or_more_specific(self, other: Cause, now_ns: int) -> Cause:
        """Return ``other``, or this cause while it is the more specific one and may be replaced."""
        return self if now_ns < self.until_ns and self.rank < other.rank else other

    def reported(self, now_ns: int) -> Cause:
        """Return this cause with ``SOON_NS`` from now. The wire reads the robot only after it has reported
        the stop."""
        if self.rank == Rank.ORDER:
            return self
        return msgspec.structs.replace(self, until_ns=max(self.until_ns, now_ns + SOON_NS))

    def refined(self, driver: Driver, observation: Observation, now_ns: int) -> Cause:
        """Return the more specific cause that this observation shows, or this one."""
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
        """Return a more specific cause. The command did not end by itself then: the fault ended it."""
        return msgspec.structs.replace(self, text=text, reason=reason, rank=rank, lapse=Lapse.NONE)


def rank_of_condition(driver: Driver, condition: Condition) -> int:
    """Return the rank of a condition as a cause."""
    return Rank.LINK if condition.is_silence else Rank.ORDER + 1 + driver.conditions.index(condition)


def rank_of(reason: Reason) -> Rank:
    """Return the rank of a cause when only its reason is known."""
    if reason in HOLDING_REASONS:
        return Rank.LATE
    if reason in (Reason.FAULT, Reason.WIRE):
        return Rank.FAULT
    return Rank.LINK if reason is Reason.LINK else Rank.ORDER
