"""What the wire and the stop channels of a robot of parts know of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from strands_actors.contract.driver import ORDERED, Reason, Timing
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport

WRITE_S = 0.3
"""Longest wait for the answers of all parts to a setpoint."""
HELD, STOPPED = 1.0, 2.0
"""Values of the sensor ``PART_STATE``: the part holds, or was stopped, without an order. 0: neither."""
PART_STATE = "part_state"


class PartConfig(msgspec.Struct, frozen=True):
    """One part of a robot.

    Attributes:
        name: The name of the part.
        prefix: What stands before the names of its axes, sensors and cameras.
        robot: The name of the part among the robots that run.
        first: Index of its first axis among the axes of the robot.
        keys: Its axes, by their own names.
        ids: The motor of each axis.
        timing: The times of its driver.
        late_s: As ``Driver.late_s``.
        fallbacks: Its safe state for each reason.
        energised: Its safe states in which its motors keep torque.
    """

    name: str
    prefix: str
    robot: str
    first: int
    keys: tuple[str, ...]
    ids: tuple[int, ...]
    timing: Timing
    late_s: float
    fallbacks: Mapping[Reason, SafeState]
    energised: frozenset[SafeState]

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of its axes in the whole robot."""
        return tuple(self.prefix + key for key in self.keys)

    @property
    def span(self) -> slice:
        """Its axes among those of the robot."""
        return slice(self.first, self.first + len(self.keys))

    def has(self, index: int) -> bool:
        """Return True if the axis of the robot with this index belongs to the part."""
        return self.first <= index < self.first + len(self.keys)

    def reports(self, written: bool, safe: bool, detail: str = "") -> tuple[MotorReport, ...]:
        """Return the same report for each motor of the part."""
        rows = zip(self.axes, self.ids, strict=True)
        return tuple(MotorReport(axis, number, written, written, safe, detail) for axis, number in rows)


class PartsConfig(msgspec.Struct, frozen=True):
    """All parts of a robot.

    Attributes:
        robot: The name of the robot among those that run.
        directory: The run directory with the sockets of the parts.
        parts: The parts.
        fallbacks: The robot's safe state for each reason: the most severe one of its parts.
    """

    robot: str
    directory: str
    parts: tuple[PartConfig, ...]
    fallbacks: Mapping[Reason, SafeState]

    def socket(self, part: PartConfig, role: str) -> str:
        """Return the path of the socket of a part's root or wire process."""
        return str(Path(self.directory) / f"{part.robot}.{role}.sock")

    def reason_for(self, safe_state: SafeState) -> Reason:
        """Return a reason for which the parts go to this safe state, for a stop channel that knows no reason.

        Each part goes to the state that its own table declares for the reason. The first reasons are those of a
        stop without the wire process.
        """
        reasons = (Reason.WIRE, Reason.STOP, Reason.FAULT, Reason.LINK, Reason.EXPIRED)
        return next((reason for reason in reasons if self.fallbacks[reason] == safe_state), Reason.ESTOP)


def ordered(reason: Reason, part: PartConfig, holds: bool) -> Reason:
    """Return the reason with which a part is stopped.

    A reason that ends the processes of a robot is replaced, since the parts outlive an order. If the whole robot is
    stopped for this reason, a part that would hold is stopped, too.

    Args:
        reason: The reason for which the robot is stopped.
        part: The part.
        holds: True if the robot stays energised.
    """
    if reason in (Reason.CALLER, Reason.CLEANUP, Reason.ROOT):
        reason = Reason.STOP
    if reason not in ORDERED and not holds and part.fallbacks[reason] in part.energised:
        return Reason.STOP
    return reason
