"""The simulated base in memory, on a clock that the test moves, with requests that share no code with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from strands_actors.drivers.kinova.protocol import Frame, Kind
from strands_actors.drivers.kinova.robots import TABLES
from strands_actors.drivers.kinova.twin.base import Base

from .kortex_client import Fields, KortexError, blob, inside, messages, number, read, real, real_of, whole

CREATE_SESSION = 0x10001
EXECUTE_ACTION, EXECUTE_REFERENCE, STOP_ACTION = 0x20030, 0x2002F, 0x20032
ACTION_TOPIC, SEQUENCE_TOPIC = 0x2006A, 0x20066
STOP, CLEAR_FAULTS, ARM_STATE, SET_MODE = 0x20070, 0x20092, 0x200AF, 0x20098
TWIST, ANGLES, POSE, FEEDBACK = 0x20079, 0x2007E, 0x20073, 0x30003

END, ABORT, START, PREPROCESS_START, PREPROCESS_ABORT, PREPROCESS_END = 1, 2, 4, 5, 6, 7
"""Events of actions."""

HOME = (0.0, 15.0, 180.0, 230.0, 0.0, 55.0, 90.0)
TICK_S = 0.01


class World:
    """One base with one client. ``notifications`` has the frames that it got without a request."""

    def __init__(self, **options: Any) -> None:
        self.now_s = 100.0
        self.base = Base(TABLES.table("kinova_gen3"), now_s=lambda: self.now_s, **options)
        self.notifications: list[Frame] = []
        self.session = 0
        login = blob(1, b"admin") + number(2, 10**9) + blob(3, b"admin") + number(4, 10**9)
        self.session = self._answer(CREATE_SESSION, login).session

    def notify(self, frame: Frame) -> None:
        self.notifications.append(frame)

    def call(self, function: int, payload: bytes = b"", device: int = 0) -> Fields:
        """Return the fields of the answer. Raise ``KortexError`` if the base refuses the call."""
        answer = self._answer(function, payload, device)
        if answer.error:
            raise KortexError(answer.error, answer.sub_error)
        return read(answer.payload)

    def refusal(self, function: int, payload: bytes = b"", device: int = 0) -> tuple[int, int]:
        """Return the error code and the sub-error with which the base refuses a call; zeros if it accepts it."""
        answer = self._answer(function, payload, device)
        return answer.error, answer.sub_error

    def _answer(self, function: int, payload: bytes, device: int = 0) -> Frame:
        frame = Frame(Kind.REQUEST, function, 1, self.session, payload, device=device)
        return self.base.answer(self, frame)

    def run(self, seconds: float, look: Callable[[], None] = lambda: None) -> None:
        """Let the time pass, and call ``look`` again and again."""
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            self.base.advance()
            look()

    # -- actions

    def watch_actions(self) -> None:
        self.call(ACTION_TOPIC)

    def events(self, topic: int = ACTION_TOPIC) -> list[int]:
        """Return the events of a topic so far."""
        return [whole(read(frame.payload), 1) for frame in self.notifications if frame.call == topic]

    @property
    def abort_details(self) -> int:
        """The sub-error of the last event of an action."""
        return whole(read([frame for frame in self.notifications if frame.call == ACTION_TOPIC][-1].payload), 5)

    def finish(self, within_s: float = 30.0) -> list[int]:
        """Let the time pass until an action has ended. Return its events."""
        for _ in range(round(within_s / TICK_S)):
            if {END, ABORT} & set(self.events()[-1:]):
                break
            self.run(TICK_S)
        else:
            raise AssertionError(f"no end after {within_s} s: {self.events()}")
        return self.events()

    # -- measurements

    def degrees(self) -> list[float]:
        return [real_of(angle, 2) for angle in messages(self.call(ANGLES), 1)]

    def pose(self) -> list[float]:
        fields = self.call(POSE)
        return [real_of(fields, field) for field in range(1, 7)]

    def tool_m(self) -> Any:
        return np.array(self.pose()[:3])

    def of_base(self, field: int) -> float:
        return real_of(inside(self.call(FEEDBACK), 2), field)

    def faults(self) -> tuple[int, list[int]]:
        """Return the fault bank of the base, and of each actuator."""
        fields = self.call(FEEDBACK)
        return whole(inside(fields, 2), 31), [whole(each, 11) for each in messages(fields, 3)]

    def state(self) -> int:
        return whole(self.call(ARM_STATE), 1)

    def set_mode(self, mode: int) -> None:
        self.call(SET_MODE, number(1, mode))


def angles(degrees: Sequence[float], identifiers: bool = True) -> bytes:
    """Return ``JointAngles``."""
    rows = ((number(1, joint) if identifiers else b"") + real(2, value) for joint, value in enumerate(degrees))
    return b"".join(blob(1, row) for row in rows)


def reach_angles(degrees: Sequence[float], constraint: bytes = b"") -> bytes:
    """Return an ``Action`` that turns the joints."""
    return blob(2, b"an action") + blob(10, blob(1, angles(degrees)) + blob(2, constraint))


def numbers(values: Sequence[float]) -> bytes:
    return b"".join(real(field, value) for field, value in enumerate(values, 1))


def reach_pose(values: Sequence[float], speed: bytes = b"") -> bytes:
    """Return an ``Action`` that moves the tool."""
    return blob(9, blob(1, numbers(values)) + blob(2, speed))


def twist(values: Sequence[float], frame: int, duration: int = 0) -> bytes:
    """Return ``TwistCommand``."""
    return number(1, frame) + blob(2, numbers(values)) + number(3, duration)


def near(measured: Sequence[float], expected: Sequence[float], degrees: float = 0.5) -> bool:
    """Return True if angles are near to others, apart from whole turns."""
    return all(abs(math.remainder(a - b, 360.0)) < degrees for a, b in zip(measured, expected, strict=True))


def zone(
    shape: int, origin_m: Sequence[float], dimensions_m: Sequence[float], turn: Any = None, on: int = 1
) -> bytes:
    """Return ``ProtectionZone``. ``turn`` is the matrix of its orientation."""
    matrix = np.eye(3) if turn is None else turn
    rows = b"".join(blob(index, numbers(row)) for index, row in enumerate(matrix.tolist(), 1))
    dimensions = b"".join(real(4, value) for value in dimensions_m)
    return (
        blob(2, b"a zone")
        + number(4, on)
        + blob(5, number(1, shape) + blob(2, numbers(origin_m)) + blob(3, rows) + dimensions)
    )


def sphere(origin_m: Sequence[float], radius_m: float, on: int = 1) -> bytes:
    return zone(2, origin_m, (radius_m,), on=on)
