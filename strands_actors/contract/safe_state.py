"""The safe states a robot can be brought to, in order of severity.

A later member gives up more than an earlier one. An order to be safe is never answered by an
earlier state than the one that was asked for.
"""

from __future__ import annotations

import enum


class SafeState(enum.StrEnum):
    """From the mildest to the most severe."""

    HOLD = "hold"  # energised, at the present position; a drone hovers
    ZERO = "zero"  # a base or a pair of wheels: velocity zero, energised
    STOP = "stop"  # motion ended by the robot's own controller, which keeps it up
    SETTLE = "settle"  # sit or lie down, then without power (Spot: settle, then cut)
    LAND = "land"  # a drone: down, then motors off
    DAMP = "damp"  # motors brake the joints, then let go
    LIMP = "limp"  # no torque on any motor
    ZERO_TORQUE = "zero_torque"  # frames that ask for no torque, at once
    OFF = "off"  # motors off or power cut, whatever that means for what they carried

    @property
    def severity(self) -> int:
        return _ORDER[self]

    def at_least(self, other: SafeState) -> bool:
        """Return whether this state gives up no less than ``other``."""
        return self.severity >= other.severity

    def or_more(self, other: SafeState) -> SafeState:
        """Return the more severe of the two."""
        return self if self.at_least(other) else other


_ORDER = {state: at for at, state in enumerate(SafeState)}
