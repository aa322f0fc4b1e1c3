"""The safe states of a robot, in order of severity.

A later member gives up more than an earlier one. An order for a safe state is never answered with an earlier
state than the ordered one.
"""

from __future__ import annotations

import enum


class SafeState(enum.StrEnum):
    """A safe state. The members stand in order, from the mildest to the most severe."""

    HOLD = "hold"  # energised, at the present position; a drone hovers
    ZERO = "zero"  # a base or a pair of wheels: velocity zero, energised
    STOP = "stop"  # motion ended by the robot's own controller, which keeps it up
    SETTLE = "settle"  # sit or lie down, then without power (Spot: settle, then cut)
    LAND = "land"  # a drone: down, then motors off
    DAMP = "damp"  # motors brake the joints, then let go
    LIMP = "limp"  # no torque on any motor
    ZERO_TORQUE = "zero_torque"  # frames that ask for no torque, at once
    OFF = "off"  # motors off or power cut, even if a load falls

    @property
    def severity(self) -> int:
        """The index in the order of severity, from 0, the mildest."""
        return _ORDER[self]

    def at_least(self, other: SafeState) -> bool:
        """Return True if this state is as severe as ``other``, or more."""
        return self.severity >= other.severity

    def or_more(self, other: SafeState) -> SafeState:
        """Return the more severe of the two."""
        return self if self.at_least(other) else other


_ORDER = {state: at for at, state in enumerate(SafeState)}
