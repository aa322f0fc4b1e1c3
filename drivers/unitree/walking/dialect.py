"""The common interface of the two services by which Unitree's robots walk. Pure.

``sport`` of a Go2 and a B2 has a request for each posture, and reports its mode in SportModeState
(``sport.py``). ``loco`` of an H1, which is called ``sport`` on a G1, is a state machine: one request sets its
number, the FSM id, and another one asks for it (``loco.py``). Here the modes of both are numbers:

    walks    the robot carries out a velocity
    rests    it ignores a velocity, and nothing moves it
    others   a motion is under way, such as getting up or a jump
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from .states import STATE_TOPIC

MOVE_S = 0.3
"""Lifetime of one velocity. G1 and H1 receive it with the velocity. We stop a Go2 and a B2 after it."""


class Order(NamedTuple):
    """One request."""

    api: int
    parameter: str = "{}"


class Posture(NamedTuple):
    """How one service of the robot's handle is carried out: the requests are sent one after the other. Each
    is done when the robot reports one of its modes."""

    about: str
    steps: tuple[tuple[Order, frozenset[int]], ...]
    after: frozenset[int]
    """Modes from which it may be requested."""
    done: frozenset[int]
    """Modes in which nothing has to be done."""


class Dialect(msgspec.Struct, frozen=True):
    """One service: its requests and its modes."""

    stop: Order
    """Ends a velocity. The service always answers it, which it need not do for a velocity. The robot stays on
    its feet."""
    balance: Order
    """Ends stepping on the spot, once the robot stands."""
    damp: Order
    """Brakes every joint, so the robot sinks to the floor. The vendor's own emergency stop."""
    names: Mapping[int, str]
    walks: frozenset[int]
    rests: frozenset[int]
    damped: int
    postures: Mapping[str, Posture]
    settles: frozenset[int] = frozenset()
    """Modes that are reported when the motion into them begins. They are reached once the joints rest."""
    posture_s: float = 10.0
    """Longest time for a posture [assumed: standing up takes a Go2 some two seconds]."""
    mode_source: str = "SportModeState"
    """Source of the mode, for messages."""
    state_topic: str = STATE_TOPIC
    """Topic of the odometry, and of the mode unless that is asked for. Empty if there is no topic."""
    ask_mode: int = 0
    """The request for the mode. 0: SportModeState has it."""
    ask_odometry: int = 0
    """The request for the pose. 0: SportModeState has it."""
    at_open: tuple[Order, ...] = ()
    """Requests that make the service report its pose."""

    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        raise NotImplementedError

    def name(self, mode: int) -> str:
        return self.names.get(mode, f"mode {mode}")
