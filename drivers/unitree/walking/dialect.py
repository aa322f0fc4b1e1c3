"""What the walking services of Unitree's robots have in common. Pure.

Two services walk. ``sport`` of a Go2 and a B2 has a request for each posture, and tells its mode in
SportModeState (``sport.py``). ``loco`` (G1: it is called ``sport`` there; H1) is a state machine that
is set to a number, its FSM id, and is asked for it (``loco.py``). Here both have modes, which are
numbers:

    walks    a velocity is carried out
    rests    no velocity is, and none moves the robot
    others   a motion is under way: getting up, a jump
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from .states import STATE_TOPIC

MOVE_S = 0.3
"""Lifetime of one velocity. G1 and H1 are told it; a Go2 and a B2 are told to stop by us."""


class Order(NamedTuple):
    """One request."""

    api: int
    parameter: str = "{}"


class Posture(NamedTuple):
    """How one service of the handle is carried out: requests one by one, each done when the robot
    reports one of its modes."""

    about: str
    steps: tuple[tuple[Order, frozenset[int]], ...]
    after: frozenset[int]
    """Modes in which it may be asked for."""
    done: frozenset[int]
    """Modes in which there is nothing to do."""


class Dialect(msgspec.Struct, frozen=True):
    """One service: its words for the same things."""

    stop: Order
    """Ends a velocity; is answered, as a velocity need not be. The robot stays on its feet."""
    balance: Order
    """Ends a gait on the spot, once it stands."""
    damp: Order
    """Brakes every joint: it sinks to the floor. The vendor's own emergency stop."""
    names: Mapping[int, str]
    walks: frozenset[int]
    rests: frozenset[int]
    damped: int
    postures: Mapping[str, Posture]
    settles: frozenset[int] = frozenset()
    """Modes that it reports as soon as it begins to move there: they are reached once its joints rest."""
    posture_s: float = 10.0
    """Longest time for a posture [assumed: standing up takes a Go2 some two seconds]."""
    mode_source: str = "SportModeState"
    """Where the mode comes from, for people."""
    state_topic: str = STATE_TOPIC
    """Of its odometry, and of its mode where that is not asked for. Empty: there is none."""
    ask_mode: int = 0
    """The request that is answered with the mode. 0: SportModeState has it."""
    ask_odometry: int = 0
    """The request that is answered with the pose. 0: SportModeState has it."""
    at_open: tuple[Order, ...] = ()
    """Requests without which it does not tell its pose."""

    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        raise NotImplementedError

    def name(self, mode: int) -> str:
        return self.names.get(mode, f"mode {mode}")
