"""What ``tests/drivers/test_modelled.py`` sends to the simulated base: each call and each action once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from strands_actors.drivers.kinova.protocol import ArmState, Frame, Kind, ServoingMode
from strands_actors.drivers.kinova.robots import TABLES
from strands_actors.drivers.kinova.twin.base import Base
from strands_actors.drivers.kinova.twin.functions import ACTIONS, CALLS
from tests.drivers.modelled.walk import Answer, Walk

from .kortex_client import blob, joint_speeds, number, real
from .world import (
    ACTION_TOPIC,
    ANGLES,
    ARM_STATE,
    CLEAR_FAULTS,
    CREATE_SESSION,
    EXECUTE_ACTION,
    EXECUTE_REFERENCE,
    FEEDBACK,
    HOME,
    POSE,
    SEQUENCE_TOPIC,
    SET_MODE,
    STOP,
    STOP_ACTION,
    TWIST,
    angles,
    numbers,
    reach_angles,
    sphere,
    twist,
)

CLOSE_SESSION, KEEP_ALIVE = 0x10002, 0x10003
CREATE_SEQUENCE, PLAY_SEQUENCE, CREATE_ZONE, CREATE_USER, CREATE_ACTION = (
    0x20008,
    0x2000F,
    0x20014,
    0x20001,
    0x2002A,
)
SERVICES = (0x1, 0x2, 0x3, 0x9, 0xA, 0x17)

LOGIN = blob(1, b"admin") + number(2, 60_000) + blob(3, b"admin") + number(4, 2000)
AWAY = (10.0, *HOME[1:])
POSE_AWAY = (0.55, 0.0, 0.4, 90.0, 0.0, 90.0)
SPEEDS = joint_speeds((5.0, *[0.0] * 6))
GRIPPER = number(1, 3) + blob(2, blob(1, number(1, 1) + real(2, 0.5)))
SLOWLY = twist((0.02, 0, 0, 0, 0, 0), 3)
SEQUENCE = blob(4, blob(2, reach_angles(AWAY)))
ZONE = sphere((0.0, 0.0, 2.0), 0.1)
USER = blob(1, blob(2, b"eve")) + blob(2, b"secret")
WAYPOINTS = blob(1, blob(2, blob(1, bytes(28))))
LOW_LEVEL = number(1, 0) + b"".join(blob(2, real(3, value + 1.0)) for value in HOME)
FIRST, OWN = number(1, 10_000), number(1, 3)
"""Handles: of the first entity that a client has created, and of the action Zero."""

REQUESTS: Mapping[int, bytes] = {
    CREATE_SESSION: LOGIN,
    CLOSE_SESSION: b"",
    KEEP_ALIVE: b"",
    CREATE_USER: USER,
    0x20004: FIRST,
    CREATE_SEQUENCE: SEQUENCE,
    0x2000A: FIRST,
    0x2000B: FIRST,
    0x2000C: b"",
    PLAY_SEQUENCE: FIRST,
    0x20011: FIRST,
    CREATE_ZONE: ZONE,
    0x20016: FIRST,
    0x20017: FIRST,
    0x20018: b"",
    CREATE_ACTION: reach_angles(AWAY),
    0x2002B: OWN,
    0x2002C: b"",
    0x2002D: FIRST,
    EXECUTE_REFERENCE: OWN,
    EXECUTE_ACTION: reach_angles(AWAY),
    STOP_ACTION: b"",
    0x20061: number(1, 1),
    0x20062: b"",
    SEQUENCE_TOPIC: b"",
    ACTION_TOPIC: b"",
    0x2006D: blob(1, numbers(POSE_AWAY)),
    STOP: b"",
    POSE: b"",
    TWIST: SLOWLY,
    0x2007C: blob(1, angles(AWAY)),
    ANGLES: b"",
    0x20084: SPEEDS,
    0x20088: GRIPPER,
    0x20089: number(1, 3),
    0x20091: b"",
    CLEAR_FAULTS: b"",
    SET_MODE: number(1, 3),
    0x20099: b"",
    0x2009A: b"",
    0x200AB: b"",
    ARM_STATE: b"",
    0x200B0: b"",
    0x200B7: b"",
    0x200B9: b"",
    0x200C6: b"",
    0x200E2: WAYPOINTS,
    0x200E9: angles(HOME),
    0x200EA: blob(1, numbers(POSE_AWAY)) + blob(2, angles(HOME)),
    0x200EB: WAYPOINTS,
    0x30001: LOW_LEVEL,
    0x30002: LOW_LEVEL,
    FEEDBACK: b"",
    **dict.fromkeys((0x90003, 0x90004, 0x90005, 0x90006, 0x90007, 0x90008, 0x90009, 0x9000C), b""),
    0xA0006: b"",
    0xA0007: number(1, 3),
    0x170001: b"",
}

KINDS = (1, 2, 4, 6, 7, 13, 14, 16, 17, 18, 22, 23, 25, 28, 29, 31, 32, 33, 34, 35, 39, 40, 41)
FIELDS = dict(
    zip(
        KINDS,
        (4, 5, 7, 9, 10, 16, 17, 19, 20, 21, 25, 26, 28, 31, 32, 34, 35, 36, 37, 38, 39, 40, 41),
        strict=True,
    )
)
"""The field of an action's parameters, by the number of its type."""

ACTION_REQUESTS: Mapping[int, bytes] = {
    1: SLOWLY,
    4: SPEEDS,
    6: blob(1, numbers(POSE_AWAY)),
    7: blob(1, angles(AWAY)),
    28: b"",
    29: b"",
    31: number(1, 2),
    32: OWN,
    33: GRIPPER,
    35: b"",
    41: WAYPOINTS,
}


def ask(base: Base, call: int, payload: bytes) -> Answer:
    """Send a request in a session of its own, which is closed so that it does not count as an effect."""
    session = base.answer("client", Frame(Kind.REQUEST, CREATE_SESSION, 1, 0, LOGIN)).session
    device = 1 if call >> 16 == 0xA else 0
    answer = base.answer("client", Frame(Kind.REQUEST, call, 2, session, payload, device=device))
    if call != CREATE_SESSION:
        base.answer("client", Frame(Kind.REQUEST, CLOSE_SESSION, 3, session))
    base.sessions._number = 0
    return Answer(answer.error == 0, answer.payload)


def ask_action(base: Base, kind: int, parameters: bytes) -> Answer:
    return ask(base, EXECUTE_ACTION, blob(FIELDS[kind], parameters))


def after(*calls: int) -> Callable[[Base], None]:
    """Return what brings a base into the state after these calls."""

    def prepare(base: Base) -> None:
        for call in calls:
            assert ask(base, call, REQUESTS[call]).accepted

    return prepare


def fault(base: Base) -> None:
    base.set_state(ArmState.IN_FAULT)


def low_level(base: Base) -> None:
    base.set_mode(ServoingMode.LOW_LEVEL)


def subscribe(base: Base) -> None:
    base.topics.subscribe(ACTION_TOPIC, "client", 0)


PREPARE: Mapping[int, Callable[[Base], None]] = {
    0x20004: after(CREATE_USER),
    **dict.fromkeys((0x2000A, 0x2000B, 0x2000C, PLAY_SEQUENCE), after(CREATE_SEQUENCE)),
    0x20011: after(CREATE_SEQUENCE, PLAY_SEQUENCE),
    **dict.fromkeys((0x20016, 0x20017, 0x20018), after(CREATE_ZONE)),
    0x2002D: after(CREATE_ACTION),
    STOP_ACTION: after(EXECUTE_ACTION),
    0x20061: subscribe,
    STOP: after(0x20084),
    CLEAR_FAULTS: fault,
    **dict.fromkeys((0x30001, 0x30002, 0xA0007), low_level),
}


def still() -> float:
    return 100.0


def base() -> Base:
    return Base(TABLES.table("kinova_gen3"), now_s=still)


def walks() -> Iterator[Walk]:
    yield Walk(
        "kinova",
        CALLS,
        [service << 16 | function for service in SERVICES for function in range(256)],
        base,
        ask,
        REQUESTS,
        (b"", b"\x08\x01"),
        PREPARE,
        frozenset((CLOSE_SESSION, KEEP_ALIVE)),  # test_twin.py closes and keeps one
    )
    yield Walk(
        "kinova actions",
        ACTIONS,
        list(FIELDS),
        base,
        ask_action,
        ACTION_REQUESTS,
        (b"",),
        {29: fault, 35: after(0x20084)},
    )
