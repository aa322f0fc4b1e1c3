"""Decide which cause of a stop is kept: the most specific one that is known soon after it. Pure.

A fault shows itself in several ways, and the first symptom is seldom the cause. An arm that
collides first reports that it stands, then why. So a cause has a rank, and for ``SOON_NS`` after a
stop a cause of a lower rank takes its place.

    rank             cause
    ORDER            somebody wanted it: a stop, a cleanup
    1, 2, 3, ...     a condition of the robot is broken, in the order in which the driver lists them
    REPORTED         the robot reports a fault, and its driver has no conditions
    FAULT            the robot could not do what it was told: hold, be armed
    LINK             the robot is no longer heard
    LATE             no setpoint came in time, or its writer ended: a hold

Only conditions that no stop of ours can break are looked at (``OnResume.REFUSE``). A stopped arm is
stopped because it was stopped.
"""

from __future__ import annotations

import enum

import msgspec

from strands_actors.contract.driver import HOLDING_REASONS, Condition, Driver, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.clock import NS

SOON_NS = round(0.2 * NS)


class Rank(enum.IntEnum):
    """The lower, the more specific. Between ``ORDER`` and ``REPORTED`` are the conditions."""

    ORDER = 0
    REPORTED = 10_000
    FAULT = 10_001
    LINK = 10_002
    LATE = 10_003


class Lapse(enum.StrEnum):
    """How a command ended by itself. It decides who may move the robot next without a resume."""

    NONE = ""  # it did not
    EXPIRED = "expired"  # no setpoint followed in time
    GIVEN_BACK = "given_back"  # its writer gave the lease back
    ROLLOUT_ENDED = "rollout_ended"  # a rollout gave back the lease that it wrote under


class Cause(msgspec.Struct, frozen=True):
    """Why the robot is safe. ``text`` is for people, and nothing reads it back. ``until_ns``: until
    then a more specific cause takes its place. ``faults``: what the robot reported when the stop was
    made."""

    text: str = ""
    reason: Reason | None = None
    rank: int = Rank.ORDER
    until_ns: int = 0
    faults: dict[str, str] = {}
    lapse: Lapse = Lapse.NONE

    def or_more_specific(self, other: Cause, now_ns: int) -> Cause:
        """Return ``other``, unless this one is more specific and its time is not over."""
        return self if now_ns < self.until_ns and self.rank < other.rank else other

    def reported(self, now_ns: int) -> Cause:
        """Return it with ``SOON_NS`` from now: the stop was reported only now, and the wire reads
        nothing before."""
        if self.rank == Rank.ORDER:
            return self
        return msgspec.structs.replace(self, until_ns=max(self.until_ns, now_ns + SOON_NS))

    def refined(self, driver: Driver, observation: Observation, now_ns: int) -> Cause:
        """Return the more specific cause that this reading shows, or this one."""
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
        """Return a more specific cause in its place. A command that a fault has ended has not ended by
        itself."""
        return msgspec.structs.replace(self, text=text, reason=reason, rank=rank, lapse=Lapse.NONE)


def rank_of_condition(driver: Driver, condition: Condition) -> int:
    """Return the rank of a condition as a cause."""
    return Rank.LINK if condition.is_silence else Rank.ORDER + 1 + driver.conditions.index(condition)


def rank_of(reason: Reason) -> Rank:
    """Return the rank of a cause of which only its reason is known."""
    if reason in HOLDING_REASONS:
        return Rank.LATE
    if reason in (Reason.FAULT, Reason.WIRE):
        return Rank.FAULT
    return Rank.LINK if reason is Reason.LINK else Rank.ORDER
