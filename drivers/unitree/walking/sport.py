"""The service ``sport`` of a Go2 and a B2: its requests, and the meaning of its modes. Pure.

The numbers of the requests are from the vendor's SDK, ``unitree_sdk2`` (BSD-3). The modes are from the vendor's
documentation of SportModeState and from the examples of the SDK.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

from strands_actors.drivers.unitree import rpc

from .dialect import Dialect, Order, Posture

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
