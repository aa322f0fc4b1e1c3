"""The common interface of the two services by which Unitree's robots walk. Pure.

The service of a Go2 and a B2, ``sport``, has a request for each posture, and reports its mode in SportModeState
(see ``sport.py``). The service of an H1 (``loco``) and of a G1 (also called ``sport``) is a state machine. One
request sets the number of its state (FSM id), and another request reads this number (see ``loco.py``).

A ``Dialect`` describes one such service. The modes of both are numbers, in three groups:

    walks    the robot walks if it receives a velocity
    rests    the robot ignores a velocity, and stands or lies still
    others   the robot is moving, for example getting up or jumping
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from .states import STATE_TOPIC

MOVE_S = 0.3
"""Lifetime of one velocity. A G1 and an H1 receive this time with the velocity, and stop by themselves. A Go2 and a
B2 are stopped by this driver."""


class Order(NamedTuple):
    """One request to the service: its number, and its parameter as JSON."""

    api: int
    parameter: str = "{}"


class Posture(NamedTuple):
    """A change of posture, such as ``stand_up()``: the requests that it needs, in order.

    Each request comes with modes. The request is done when the robot reports one of them.
    """

    about: str
    steps: tuple[tuple[Order, frozenset[int]], ...]
    after: frozenset[int]
    """Modes in which this posture may be requested."""
    done: frozenset[int]
    """Modes in which the robot already has this posture."""


class Dialect(msgspec.Struct, frozen=True):
    """The requests and the modes of one service for walking."""

    stop: Order
    """Request that stops walking. The robot stays on its feet. The service always answers this request, but may not
    answer a velocity."""
    balance: Order
    """Request after which a standing robot no longer steps on the spot."""
    damp: Order
    """Request that brakes every joint, so that the robot sinks to the floor. The vendor's own emergency stop."""
    names: Mapping[int, str]
    walks: frozenset[int]
    rests: frozenset[int]
    damped: int
    postures: Mapping[str, Posture]
    settles: frozenset[int] = frozenset()
    """Modes that the robot already reports while it still moves into them. They are reached once the joints
    rest."""
    posture_s: float = 10.0
    """Longest time for a posture [assumed: standing up takes a Go2 some two seconds]."""
    mode_source: str = "SportModeState"
    """Name of the source of the mode, for error messages."""
    state_topic: str = STATE_TOPIC
    """Topic on which the robot publishes its odometry and, without ``ask_mode``, its mode. Empty without a
    topic."""
    ask_mode: int = 0
    """Number of the request that reads the mode. 0 if the mode is in SportModeState."""
    ask_odometry: int = 0
    """Number of the request that reads the pose. 0 if the pose is in SportModeState."""
    opening_orders: tuple[Order, ...] = ()
    """Requests that make the service report its pose."""

    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        raise NotImplementedError

    def name(self, mode: int) -> str:
        return self.names.get(mode, f"mode {mode}")
