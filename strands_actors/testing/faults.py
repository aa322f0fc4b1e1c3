"""Faults, victims, the expected safe states and bounds, and the requirements that each cell proves.

Tables only.

A *cell* is one victim with one fault. Victims are the processes of a running robot, named by role, and the robot
itself (``Victims.TWIN``).

* Caller, policy, wire, root and robot are in control: if one of them fails, the robot must receive a safe state.
* Every other process is a *bystander*. If only a bystander fails, the commands to the robot do not change. So its
  trial ends with a stop, which must be as quick as without the fault. A process with any other role is a bystander.

Every combination of victim and fault exists. A combination that makes no sense has a text with the reason.
"""

from __future__ import annotations

import enum
import math
import signal
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from strands_actors.contract.driver import Driver, Reason
from strands_actors.supervisors.gate.messages import LEASE_TTL_S
from strands_actors.supervisors.root.stopped_detector import noticed_s
from strands_actors.supervisors.wire.transport import BACKOFF_S


class Victims(enum.StrEnum):
    """The victims (processes, or the robot) whose fault leads to a safe state of the robot.

    Other victims are named by their role.
    """

    CALLER = "caller"  # the user's script
    HOST = "host"  # the host that keeps the robot for scripts; only in the columns of hosted robots
    POLICY = "policy"
    WIRE = "wire"
    ROOT = "root"
    TWIN = "twin"  # the robot, and the cable to it


class Faults(enum.StrEnum):
    """The ways in which a process, the robot or its cable fails."""

    KILL = "kill"  # the process gets SIGKILL
    FREEZE = "freeze"  # the process gets SIGSTOP, and later SIGCONT
    SPIN = "spin"  # the process computes for ever
    EXCEPTION = "exception"
    EXIT = "exit"  # the process calls sys.exit
    SIGNAL = "signal"  # the process gets SIGTERM
    INTERRUPT = "interrupt"  # the process gets SIGINT
    LINK_LOSS = "link loss"  # the cable is pulled, and put back
    GARBAGE = "garbage"  # the robot's replies are damaged
    SLOW = "slow"  # replies come later, but within their timeouts
    STUCK = "stuck"  # the robot repeats old readings and does not move
    # The readings do not match the robot's motion.
    WRONG = "wrong"
    DELAYED = "delayed"  # every reply comes after its timeout
    INTERMITTENT = "intermittent"  # every third reply is missing
    LATE_REPLY = "late reply"  # some replies come after their timeout, and then the fault ends
    HALF_OPEN = "half-open"  # the robot receives and obeys, but its replies do not arrive


SIGNALS = {
    Faults.KILL: signal.SIGKILL,
    Faults.FREEZE: signal.SIGSTOP,
    Faults.SIGNAL: signal.SIGTERM,
    Faults.INTERRUPT: signal.SIGINT,
}

PROCESSES = (Victims.CALLER, Victims.HOST, Victims.POLICY, Victims.WIRE, Victims.ROOT)
PROCESS_FAULTS = (*SIGNALS, Faults.SPIN, Faults.EXCEPTION, Faults.EXIT)
ROBOT_FAULTS = (
    Faults.FREEZE,
    Faults.LINK_LOSS,
    Faults.GARBAGE,
    Faults.SLOW,
    Faults.STUCK,
    Faults.WRONG,
    Faults.DELAYED,
    Faults.INTERMITTENT,
    Faults.LATE_REPLY,
    Faults.HALF_OPEN,
)
LIVING = (Faults.FREEZE, Faults.SPIN)
"""Faults that leave the process running."""
HOST_FAULTS = (Faults.KILL, Faults.FREEZE)
"""A host that spins harms no robot: their processes do not depend on it."""
BYSTANDER_FAULTS = (Faults.KILL, Faults.FREEZE)
"""A bystander runs no code that could be ordered to fail in another way."""
STARTED_AGAIN = ("standby", "recorder")
"""Bystanders that their tree, or the bench, restarts at once. A camera that ends again and again restarts after
a pause."""
RETURNING = (Faults.FREEZE, Faults.LINK_LOSS)
"""Faults of the robot during which nothing can be written. Their time is measured from the end of the fault,
that of other faults from a stop."""
LOSING = (Faults.GARBAGE,)
"""Faults of the robot after which the link may count as lost before a stop is ordered."""
CONFIRMED = (Faults.SLOW, Faults.LATE_REPLY)
"""Faults of the robot in which every motor must still confirm a stop."""

RETURN_S = BACKOFF_S[-1] + 1.0
"""The published bound from the return of a link to the safe frame: the longest pause between two attempts, and
one attempt, with room."""


@dataclass(frozen=True)
class Cell:
    """One victim with one fault, which is a cell of the kill matrix.

    Attributes:
        victim: The role of a process, or ``Victims.TWIN``.
        fault: The fault.
        why_not: Why the combination makes no sense; empty if it makes sense.
        proves: Ids of requirements (docs/safety.md).
    """

    victim: str
    fault: Faults
    why_not: str = ""
    proves: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.victim}-{self.fault}".replace(" ", "-")

    @property
    def members(self) -> tuple[str, ...]:
        """The roles of the victims (broken processes). A cell has one victim, a pair has two."""
        return (self.victim,)

    @property
    def faults(self) -> tuple[tuple[str, Faults], ...]:
        """The victim with its fault. ``Pair`` has the same attribute."""
        return ((self.victim, self.fault),)

    @property
    def returns(self) -> bool:
        """True if the time is measured from the end of the fault, when the robot has returned."""
        return self.victim is Victims.TWIN and self.fault in RETURNING

    @property
    def stops(self) -> bool:
        """True if the time is measured from a stop, which is ordered during the fault or just after it."""
        return self.victim is Victims.TWIN and self.fault not in RETURNING


def is_bystander(role: str) -> bool:
    """Return True if the robot's commands do not change when only this process fails."""
    return role not in list(Victims)


def spoils(victim: str, fault: str) -> bool:
    """Return True if the processes of the robot cannot be used for another trial after this fault."""
    if is_bystander(victim):
        return fault == Faults.KILL and victim not in STARTED_AGAIN
    return victim in (Victims.CALLER, Victims.HOST)


def victim_named(role: str) -> str:
    """Return the member of ``Victims`` with this name. If there is no such member, return the name as a role."""
    return role if is_bystander(role) else Victims(role)


def cells_of(driver: Driver, roles: Iterable[str] = ()) -> Iterator[Cell]:
    """Yield a cell for every victim (process, or robot) with every fault.

    Args:
        driver: The driver of the robot.
        roles: The roles of the robot's processes (``bench.roles_of``). The roles in ``Victims`` are always
            included, except the host, which only a hosted robot has.
    """
    roles = tuple(roles)
    bystanders = [role for role in dict.fromkeys(roles) if is_bystander(role)]
    for victim in (*(each for each in Victims if each is not Victims.HOST or each in roles), *bystanders):
        for fault in Faults:
            why_not = _why_not(driver, victim, fault)
            yield Cell(victim, fault, why_not, () if why_not else proves(victim, fault))


def _why_not(driver: Driver, victim: str, fault: Faults) -> str:
    if is_bystander(victim):
        return "" if fault in BYSTANDER_FAULTS else "a test has no means to cause such a fault in this process"
    if victim is Victims.TWIN:
        if fault is Faults.KILL:
            return "after its end there is no simulated robot that could get a safe frame"
        return "" if fault in ROBOT_FAULTS else "a real robot is not a process and cannot have such a fault"
    if fault not in PROCESS_FAULTS:
        return "only the robot itself can have such a fault"
    if victim is Victims.HOST and fault not in HOST_FAULTS:
        return "the robot's processes depend only on the host's life, and not on its work"
    if victim is Victims.POLICY and (driver.ROLLOUTS or driver.TASKS):
        return driver.ROLLOUTS or driver.TASKS
    return ""


def proves(victim: str, fault: Faults) -> tuple[str, ...]:
    """Return the ids of the requirements (docs/safety-evidence.md) that a safe result of this cell proves.

    A cell is a victim with a fault.
    """
    if victim is Victims.TWIN:
        if fault in RETURNING:
            return ("SAF-002", "SAF-008", "SAF-012")
        return ("SAF-002", "SAF-005", "SAF-010") if fault is Faults.LATE_REPLY else ("SAF-002", "SAF-005")
    ids = ["SAF-002", "SAF-003"]
    if fault in LIVING:
        ids.append("SAF-004")
    if victim is Victims.POLICY:
        ids += ["SAF-001"] if fault in LIVING else []
    if victim is Victims.WIRE:
        ids.append("SAF-008")
    if victim in (Victims.CALLER, Victims.HOST) and fault not in LIVING:
        ids.append("SAF-015")
    return tuple(sorted(ids))


def bound_s(driver: Driver, victim: str, fault: str) -> float:
    """Return the published bound of a cell (a victim with a fault), in seconds.

    It is the longest time from the fault, or from a stop after it, to the stop command.

    After the end of a process, or after a stop, the bound is that of the driver. A freeze or an endless loop is
    detected only after some time, which is added.
    """
    if is_bystander(victim):
        return driver.bound_s
    if victim == Victims.TWIN:
        return RETURN_S if fault in RETURNING else driver.bound_s
    if fault not in LIVING:
        # An exception in a policy is caught. Then the policy run ends, and the policy's process ends, too.
        return driver.bound_s
    timing = driver.timing
    heartbeat_ttl_s = timing.heartbeat_ttl_s
    # A command without an end is valid as long as its lease.
    caller_s = timing.oneshot_ttl_s or LEASE_TTL_S
    lapses_s = {
        "caller": caller_s,
        "host": math.inf,
        "policy": timing.stream_ttl_s,
        "wire": heartbeat_ttl_s,
        "root": heartbeat_ttl_s,
    }
    lapse_s = lapses_s[victim]
    if fault == Faults.FREEZE and victim in (Victims.CALLER, Victims.HOST, Victims.POLICY):
        lapse_s = min(lapse_s, noticed_s(timing))
    return lapse_s + driver.bound_s


def expected_safe_states(driver: Driver, victim: str, fault: str, hosted: bool = False) -> tuple[str, ...]:
    """Return the safe states of which the robot must receive one.

    The driver declares them: for the reason that the fault leads to, or for a stop if the victim is a bystander.

    Args:
        driver: The driver of the robot.
        victim: The role of a process, or ``Victims.TWIN``.
        fault: The fault.
        hosted: True if a host keeps the robot. The robot's processes then outlive the caller.
    """
    living = fault in LIVING
    reasons = {
        "caller": Reason.LEASE if living or hosted else Reason.CALLER,
        "host": Reason.CALLER,
        "policy": Reason.EXPIRED if living else Reason.POLICY,
        "wire": Reason.WIRE,
        "root": Reason.ROOT,
        "twin": Reason.LINK if fault in RETURNING else Reason.STOP,
    }
    reason = Reason.STOP if is_bystander(victim) else reasons[victim]
    safe_states = [driver.fallbacks[reason]]
    if fault in LOSING and driver.fallbacks[Reason.LINK] not in safe_states:
        safe_states.append(driver.fallbacks[Reason.LINK])
    return tuple(safe_states)
