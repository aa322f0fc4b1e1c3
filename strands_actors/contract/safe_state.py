"""The safe states of a robot, in order of severity.

A later member takes more control away from the motors than an earlier one. A stop never ends in a milder state than
the requested one.
"""

from __future__ import annotations

import enum


class SafeState(enum.StrEnum):
    """A safe state of a robot. The members are ordered from the mildest to the most severe."""

    HOLD = "hold"  # energised, at the present position; a drone hovers
    ZERO = "zero"  # velocity zero, energised, for a mobile base or wheels
    STOP = "stop"  # the robot's own controller ends the motion and keeps the robot upright
    LOWERED = "lowered"  # the arm is brought down under control, and then has no torque
    SETTLE = "settle"  # the robot sits or lies down, and its power is switched off (Spot: settle, then cut)
    LAND = "land"  # a drone lands, and then its motors are switched off
    DAMP = "damp"  # the motors brake the joints, and then let them move freely
    LIMP = "limp"  # no torque on any motor
    ZERO_TORQUE = "zero_torque"  # frames that command zero torque, at once
    OFF = "off"  # motors off or power cut, even if a load falls

    @property
    def first(self) -> SafeState:
        """The state to which the first frame of a stop brings the robot. An arm that is lowered holds first."""
        return SafeState.HOLD if self is SafeState.LOWERED else self

    @property
    def cut_short(self) -> SafeState:
        """The state that a further stop leads to while the robot is still on its way to this one.

        An arm that is being lowered moves. Whoever stops it once more wants it to stop at once.
        """
        return SafeState.LIMP if self is SafeState.LOWERED else self

    @property
    def severity(self) -> int:
        """The position of the state in the order of severity, from 0 (the mildest)."""
        return _ORDER[self]

    def at_least(self, other: SafeState) -> bool:
        """Return True if this state is at least as severe as ``other``."""
        return self.severity >= other.severity

    def or_more(self, other: SafeState) -> SafeState:
        """Return this state or ``other``, the more severe one."""
        return self if self.at_least(other) else other


_ORDER = {state: severity for severity, state in enumerate(SafeState)}
