"""Two processes break within a moment of each other: who with whom, what the wire must show then.
Tables only."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

from strands_actors.contract.driver import HOLDING_REASONS, Driver, Reason
from strands_actors.supervisors.standby.watch import look_s, silent_s

from .faults import Faults, Victims, bound_s

APART_S = 0.05
"""Longest time between the two."""


class Members(enum.StrEnum):
    """Processes of a tree. The standby is none of ``Victims``: alone it changes nothing that the
    wire shows."""

    CALLER = "caller"
    POLICY = "policy"
    WIRE = "wire"
    ROOT = "root"
    STANDBY = "standby"


class Ways(enum.StrEnum):
    KILLS = "kill + kill"
    FREEZE_AND_KILL = "freeze + kill"  # the first is frozen, the second killed, in either order
    FREEZES = "freeze + freeze"
    PKILL = "pkill python"  # whoever has a name with python in it: SIGTERM


FAULTS = {
    Ways.KILLS: (Faults.KILL, Faults.KILL),
    Ways.FREEZE_AND_KILL: (Faults.FREEZE, Faults.KILL),
    Ways.FREEZES: (Faults.FREEZE, Faults.FREEZE),
}
ALL = "all"
_LAST_TWO = {Members.ROOT, Members.WIRE}


@dataclass(frozen=True)
class Pair:
    """As ``faults.Cell``, of two. ``members``: empty for a row of its own, ``PKILL``."""

    members: tuple[Members, ...]
    way: Ways
    why_not: str = ""
    proves: tuple[str, ...] = ()

    @property
    def victim(self) -> str:
        return " + ".join(self.members) or ALL

    @property
    def fault(self) -> str:
        return self.way

    @property
    def faults(self) -> tuple[tuple[Members, Faults], ...]:
        """What is done to whom."""
        return tuple(zip(self.members, FAULTS[self.way], strict=True)) if self.members else ()

    def __str__(self) -> str:
        return f"{self.victim}-{self.fault}".replace(" + ", "+").replace(" ", "-")


def pairs_of(driver: Driver) -> Iterator[Pair]:
    """Every two of ``Members`` in every way, and the row of ``PKILL``."""
    for way in FAULTS:
        twos = permutations(Members, 2) if way is Ways.FREEZE_AND_KILL else combinations(Members, 2)
        for members in twos:
            why_not = (driver.ROLLOUTS or driver.TASKS) if Members.POLICY in members else ""
            yield Pair(members, way, why_not, () if why_not else ("SAF-002", "SAF-016"))
    yield Pair((), Ways.PKILL, "", ("SAF-002", "SAF-016"))


def pair_named(victim: str, fault: str) -> Pair:
    """The pair whose ``victim`` and ``fault`` these are. Raise ``ValueError``."""
    members = () if victim == ALL else tuple(map(Members, victim.split(" + ")))
    return Pair(members, Ways(fault))


_LIVING = {
    Members.CALLER: Reason.LEASE,
    Members.POLICY: Reason.EXPIRED,
    Members.WIRE: Reason.WIRE,
    Members.ROOT: Reason.ROOT,
}
_ENDED = _LIVING | {Members.CALLER: Reason.CALLER, Members.POLICY: Reason.POLICY}


def _decisive(pair: Pair) -> dict[Members, tuple[Faults, Reason]]:
    """The faults that the wire shows: those that stop the robot; when none does, those that hold
    it."""
    found: dict[Members, tuple[Faults, Reason]] = {
        member: (fault, (_LIVING if fault is Faults.FREEZE else _ENDED)[member])
        for member, fault in pair.faults
        if member is not Members.STANDBY
    }
    stops = {member: each for member, each in found.items() if each[1] not in HOLDING_REASONS}
    return stops or found


def expected_safe_states(driver: Driver, pair: Pair) -> tuple[str, ...]:
    """One of these."""
    reasons = [reason for _, reason in _decisive(pair).values()] or [Reason.CALLER]
    return tuple(dict.fromkeys(driver.fallbacks[reason] for reason in reasons))


def pair_bound_s(driver: Driver, pair: Pair) -> float:
    """Published, from the later of the two faults. Root and wire: the standby's. All others: the
    longer one of the two alone, since somebody is left who acts."""
    timing = driver.timing
    if set(pair.members) == _LAST_TWO:
        frozen = pair.way is not Ways.KILLS
        return driver.bound_s + (silent_s(timing) + look_s(timing) if frozen else 0.0)
    alone = (bound_s(driver, Victims(member), fault) for member, (fault, _) in _decisive(pair).items())
    return max(alone, default=driver.bound_s)
