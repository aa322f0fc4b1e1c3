"""The locomotion service of a G1 (where it is called ``sport``) and of an H1 (``loco``): requests and states. Pure.

The service is a state machine. The request SetFsmId sets the number of its state, and GetFsmId reads it. The
service answers success even if it ignores a number or a velocity. So this driver relies only on the number that
GetFsmId reports. The number already changes when the robot begins to move into the new posture [assumed], so the
driver also waits until the joints rest. Every velocity is sent with a duration, after which the robot stops by
itself.

Numbers of requests and states, and their names, come from the vendor's SDK, ``unitree_sdk2`` (BSD-3).
"""

from __future__ import annotations

import json

from strands_actors.drivers.unitree import rpc

from .dialect import MOVE_S, Dialect, Order, Posture

STOP_DURATION_S = 1.0
"""Duration of a velocity of zero, as in the vendor's StopMove."""
POSTURE_S = 20.0
"""Longest time for a posture [assumed: standing up takes a G1 some five seconds]."""
ODOMETRY_TOPIC = "rt/odommodestate"
"""Topic of a G1: a SportModeState without a valid mode. Not every G1 has it."""

ZERO_TORQUE, DAMP = 0, 1
SQUAT, SIT, STAND, START = 2, 3, 4, 500
"""States of a G1. In ``STAND`` it stands with locked joints, in ``START`` it balances and walks."""
H1_STAND, H1_START = 2, 204


class LocoDialect(Dialect, frozen=True, kw_only=True):
    set_mode: int
    set_velocity: int
    set_balance: int
    stand: int
    """State in which the robot stands with locked joints."""
    start: int
    """State in which the robot walks."""
    down: frozenset[int] = frozenset()
    """States that lower the robot on bent legs."""

    def move(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float) -> Order:
        return Order(self.set_velocity, _velocity((vx_m_s, vy_m_s, wz_rad_s), MOVE_S))


def _velocity(twist: tuple[float, float, float], duration_s: float) -> str:
    return json.dumps({"velocity": twist, "duration": duration_s})


def _number(api: int, number: int) -> Order:
    return Order(api, json.dumps({"data": number}))


def _postures(
    set_mode: int, stand: int, start: int, walks: frozenset[int], down: dict[str, tuple[str, int]]
) -> dict[str, Posture]:
    """Return the changes of posture that this service offers, by name.

    The state 706, which toggles between squatting and standing, is never requested: a repeated request would undo
    the first one.

    Args:
        set_mode: The number of the request that sets a state.
        stand: The state in which the robot stands with locked joints.
        start: The state that is requested for walking.
        walks: All states in which the robot can walk.
        down: Name of each posture that lowers the robot -> its description, and the state to request.
    """

    def to(number: int) -> tuple[Order, frozenset[int]]:
        return _number(set_mode, number), frozenset((number,))

    lower = frozenset((DAMP, *(number for _, number in down.values())))
    upright = frozenset((stand, *walks))
    begin = _number(set_mode, start), walks
    postures = {
        "stand_up": Posture(
            "stand up, held by its hanger or from squatting, and balance",
            (to(stand), begin),
            lower | {stand},
            walks,
        ),
        "balance": Posture(
            "unlock the joints of a robot that stands, so that it balances and can walk", (begin,), upright, walks
        ),
        "damp": Posture(
            "brake every joint: a robot that stands sinks to the floor unless its hanger holds it",
            (to(DAMP),),
            lower | upright | {ZERO_TORQUE},
            frozenset((DAMP,)),
        ),
    }
    for name, (about, number) in down.items():
        postures[name] = Posture(about, (to(number),), lower | upright, frozenset((number,)))
    return postures


_G1_WALKS = frozenset((START, 501, 801))
_G1_DOWN = {
    "squat": ("squat down; the joints stay locked", SQUAT),
    "sit": ("sit down; something to sit on must be behind it", SIT),
}

G1 = LocoDialect(
    stop=Order(rpc.SET_VELOCITY, _velocity((0.0, 0.0, 0.0), STOP_DURATION_S)),
    balance=_number(rpc.SET_BALANCE_MODE, 0),
    damp=_number(rpc.SET_FSM_ID, DAMP),
    names=rpc.FSM_WORDS,
    walks=_G1_WALKS,
    rests=frozenset((ZERO_TORQUE, DAMP, SQUAT, SIT, STAND)),
    damped=DAMP,
    postures=_postures(rpc.SET_FSM_ID, STAND, START, _G1_WALKS, _G1_DOWN),
    settles=frozenset((SQUAT, SIT, STAND)),
    posture_s=POSTURE_S,
    mode_source="answer to GetFsmId",
    state_topic=ODOMETRY_TOPIC,
    ask_mode=rpc.GET_FSM_ID,
    set_mode=rpc.SET_FSM_ID,
    set_velocity=rpc.SET_VELOCITY,
    set_balance=rpc.SET_BALANCE_MODE,
    stand=STAND,
    start=START,
    down=frozenset((SQUAT, SIT)),
)
H1 = LocoDialect(
    stop=Order(rpc.LOCO_SET_VELOCITY, _velocity((0.0, 0.0, 0.0), STOP_DURATION_S)),
    balance=_number(rpc.LOCO_SET_BALANCE_MODE, 0),
    damp=_number(rpc.LOCO_SET_FSM_ID, DAMP),
    names={ZERO_TORQUE: "zero torque", DAMP: "damp", H1_STAND: "stand with locked joints", H1_START: "start"},
    walks=frozenset((H1_START,)),
    rests=frozenset((ZERO_TORQUE, DAMP, H1_STAND)),
    damped=DAMP,
    postures=_postures(rpc.LOCO_SET_FSM_ID, H1_STAND, H1_START, frozenset((H1_START,)), {}),
    settles=frozenset((H1_STAND,)),
    posture_s=POSTURE_S,
    mode_source="answer to GetFsmId",
    state_topic="",
    ask_mode=rpc.LOCO_GET_FSM_ID,
    ask_odometry=rpc.LOCO_GET_ODOM,
    opening_orders=(Order(rpc.LOCO_ENABLE_ODOM),),
    set_mode=rpc.LOCO_SET_FSM_ID,
    set_velocity=rpc.LOCO_SET_VELOCITY,
    set_balance=rpc.LOCO_SET_BALANCE_MODE,
    stand=H1_STAND,
    start=H1_START,
)
