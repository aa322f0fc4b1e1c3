"""Pairs of processes that break shortly after each other, with the expected safe states and bounds. Tables only."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

from strands_actors.contract.driver import HOLDING_REASONS, Driver, Reason
from strands_actors.supervisors.standby.watch import look_s, silent_s

from .faults import Faults, Victims, bound_s, is_bystander, victim_named

APART_S = 0.05
"""Longest time between the two faults, in seconds."""


class Combination(enum.StrEnum):
    """The combinations of two faults, and the case that ``pkill`` kills all processes."""

    KILLS = "kill + kill"
    FREEZE_AND_KILL = (
        "freeze + kill"  # the first victim is frozen and the second killed; either fault may come first
    )
    FREEZES = "freeze + freeze"
    PKILL = "pkill python"  # SIGTERM to all processes with python in their names


FAULTS = {
    Combination.KILLS: (Faults.KILL, Faults.KILL),
    Combination.FREEZE_AND_KILL: (Faults.FREEZE, Faults.KILL),
    Combination.FREEZES: (Faults.FREEZE, Faults.FREEZE),
}
ALL = "all"
_LAST_TWO = {Victims.ROOT, Victims.WIRE}


@dataclass(frozen=True)
class Pair:
    """Two victims with a combination of faults, with the same interface as ``faults.Cell``.

    ``members`` is empty in the case ``PKILL``, in which all processes are killed.
    """

    members: tuple[str, ...]
    combination: Combination
    why_not: str = ""
    proves: tuple[str, ...] = ()

    @property
    def victim(self) -> str:
        """The roles of both victims as one text; ``all`` in the case ``PKILL``."""
        return " + ".join(self.members) or ALL

    @property
    def fault(self) -> str:
        """The combination of faults. ``Cell`` has the same attribute."""
        return self.combination

    @property
    def faults(self) -> tuple[tuple[str, Faults], ...]:
        """The two victims (processes that are broken), each with its fault."""
        return tuple(zip(self.members, FAULTS[self.combination], strict=True)) if self.members else ()

    @property
    def stops(self) -> bool:
        """True if the trial ends with a stop, because neither fault changes the commands to the robot."""
        return bool(self.members) and all(map(is_bystander, self.members))

    def __str__(self) -> str:
        return f"{self.victim}-{self.fault}".replace(" + ", "+").replace(" ", "-")


def pairs_of(driver: Driver, roles: Iterable[str]) -> Iterator[Pair]:
    """Yield every two processes of a robot with every combination of faults, and the case ``PKILL``.

    Args:
        driver: The driver of the robot.
        roles: The roles in its running tree (``bench.roles_of``).
    """
    victims = [victim_named(role) for role in dict.fromkeys(roles) if role != Victims.TWIN]
    for combination in FAULTS:
        twos = permutations(victims, 2) if combination is Combination.FREEZE_AND_KILL else combinations(victims, 2)
        for members in twos:
            why_not = (driver.ROLLOUTS or driver.TASKS) if Victims.POLICY in members else ""
            yield Pair(members, combination, why_not, () if why_not else ("SAF-002", "SAF-016"))
    yield Pair((), Combination.PKILL, "", ("SAF-002", "SAF-016"))


def pair_named(victim: str, fault: str) -> Pair:
    """Return the pair with these texts in ``victim`` and ``fault``.

    Raise ``ValueError`` if there is no such pair.
    """
    members = () if victim == ALL else tuple(map(victim_named, victim.split(" + ")))
    return Pair(members, Combination(fault))


_LIVING = {
    Victims.CALLER: Reason.LEASE,
    Victims.POLICY: Reason.EXPIRED,
    Victims.WIRE: Reason.WIRE,
    Victims.ROOT: Reason.ROOT,
}
_ENDED = _LIVING | {Victims.CALLER: Reason.CALLER, Victims.POLICY: Reason.POLICY}


def _decisive(pair: Pair) -> dict[str, tuple[Faults, Reason]]:
    """Return the faults that decide the safe state: those that stop the robot, or else those that make it hold."""
    effective: dict[str, tuple[Faults, Reason]] = {
        member: (fault, (_LIVING if fault is Faults.FREEZE else _ENDED)[Victims(member)])
        for member, fault in pair.faults
        if not is_bystander(member)
    }
    stops = {member: each for member, each in effective.items() if each[1] not in HOLDING_REASONS}
    return stops or effective


def expected_safe_states(driver: Driver, pair: Pair) -> tuple[str, ...]:
    """Return the safe states of which the robot must receive one."""
    usual = Reason.STOP if pair.stops else Reason.CALLER
    reasons = [reason for _, reason in _decisive(pair).values()] or [usual]
    return tuple(dict.fromkeys(driver.fallbacks[reason] for reason in reasons))


def pair_bound_s(driver: Driver, pair: Pair) -> float:
    """Return the published bound, in seconds from the later fault.

    If root and wire process fail, the standby process stops the robot, and the bound is the standby's. For all
    other pairs a process remains that stops the robot. The bound is then the longer one of the bounds for each
    fault alone.
    """
    timing = driver.timing
    if set(pair.members) == _LAST_TWO:
        frozen = pair.combination is not Combination.KILLS
        return driver.bound_s + (silent_s(timing) + look_s(timing) if frozen else 0.0)
    alone = (bound_s(driver, member, fault) for member, (fault, _) in _decisive(pair).items())
    return max(alone, default=driver.bound_s)
