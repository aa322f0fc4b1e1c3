"""What the walking services of Unitree's robots are asked, and what their modes mean. Pure.

Two services walk. ``sport`` of a Go2 and a B2 has a request for each posture, and tells its mode in
SportModeState. ``loco`` (G1: it is called ``sport`` there; H1) is a state machine that is set to a
number, its FSM id, which it is asked for. Here both have modes, which are numbers:

    walks    a velocity is carried out
    rests    no velocity is, and none moves the robot
    others   a motion is under way: getting up, a jump

Ids of requests: the vendor's SDK, ``unitree_sdk2`` (BSD-3), whose ``Move`` and ``SetVelocity`` are
these. Modes: its documentation of SportModeState, and the examples of its SDK.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.robots import Walks

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
    """Ends a velocity, and whatever else it does; is answered, as a velocity need not be. The robot
    stays on its feet."""
    balance: Order
    """Ends a gait on the spot, once it stands."""
    damp: Order
    """Brakes every joint: it sinks to the floor. The vendor's own emergency stop."""
    names: Mapping[int, str]
    walks: frozenset[int]
    rests: frozenset[int]
    damped: int
    postures: Mapping[str, Posture]

    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        raise NotImplementedError

    def name(self, mode: int) -> str:
        return self.names.get(mode, f"mode {mode}")


# -- Go2 and B2

IDLE, BALANCE, POSE, LOCOMOTION, LIE, LOCK, DAMPING, RECOVERY, SIT = 0, 1, 2, 3, 5, 6, 7, 8, 10
SPORT_MODES: Mapping[int, str] = {
    IDLE: "idle",
    BALANCE: "balance stand",
    POSE: "pose",
    LOCOMOTION: "locomotion",
    LIE: "lying down",
    LOCK: "standing with locked joints",
    DAMPING: "damping",
    RECOVERY: "recovery stand",
    SIT: "sitting",
    11: "front flip",
    12: "front jump",
    13: "front pounce",
}
WALKING = frozenset((IDLE, BALANCE, LOCOMOTION))
STANDING = frozenset((*WALKING, POSE, LOCK))
ON_THE_FLOOR = frozenset((LIE, DAMPING))


class SportDialect(Dialect, frozen=True):
    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        return Order(rpc.MOVE, json.dumps({"x": vx_m_s, "y": vy_m_s, "z": wz_rad_s}))


def _sport(sits: bool) -> SportDialect:
    balance = (Order(rpc.BALANCE_STAND), WALKING)
    postures = {
        "stand_up": Posture(
            "stand up from lying or from damping, and balance",
            ((Order(rpc.STAND_UP), frozenset((LOCK,))), balance),
            frozenset((*ON_THE_FLOOR, *STANDING)),
            WALKING,
        ),
        "lie_down": Posture(
            "lie down; the joints stay locked",
            ((Order(rpc.STAND_DOWN), frozenset((LIE,))),),
            STANDING,
            frozenset((LIE,)),
        ),
        "balance": Posture(
            "unlock the joints of a robot that stands, so that it balances and can walk",
            ((Order(rpc.BALANCE_STAND), frozenset((BALANCE,))),),
            STANDING,
            frozenset((BALANCE,)),
        ),
        "recover": Posture(
            "get up from wherever it lies, turned over or not, and balance",
            ((Order(rpc.RECOVERY_STAND), WALKING),),
            frozenset((*ON_THE_FLOOR, *STANDING, RECOVERY)),
            frozenset((BALANCE,)),
        ),
    }
    if sits:
        postures["sit"] = Posture("sit down", ((Order(rpc.SIT), frozenset((SIT,))),), STANDING, frozenset((SIT,)))
        postures["rise"] = Posture(
            "rise from sitting, and balance", ((Order(rpc.RISE_SIT), WALKING),), frozenset((SIT,)), WALKING
        )
    return SportDialect(
        stop=Order(rpc.STOP_MOVE),
        balance=Order(rpc.BALANCE_STAND),
        damp=Order(rpc.DAMP),
        names=SPORT_MODES,
        walks=WALKING,
        rests=frozenset((POSE, LIE, LOCK, DAMPING, SIT)),
        damped=DAMPING,
        postures=postures,
    )


GO2, B2 = _sport(sits=True), _sport(sits=False)


def dialect_of(walks: Walks) -> Dialect:
    """Return the words of the service by which a robot walks."""
    return GO2 if walks.sits else B2
