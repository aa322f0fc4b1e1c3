"""The process that answers each state of the controller with a command, a thousand times a second.

It does one thing, so that nothing of the tree's delays it (beside a loop that computed 15 % of the
time a thread was late 3 to 11 times in a hundred): hear a state, take the next step of the
trajectory, send it. What it may do is the wire process's to say, over a pair of sockets (``Order``,
``Report``) and a page of memory that both share: there it notes when it heard the last state, and
there the wire notes that the last setpoint still stands. Without that note it brakes, and ends the
motion. It never begins one: a motion is begun, and stopped, on TCP, which is the wire process's
alone and ends with it.
"""

from __future__ import annotations

import contextlib
import ctypes
import enum
import gc
import os
import select
import signal
import socket
import struct
import sys
import time
from typing import Any, NamedTuple, Protocol

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
from strands_actors.kernel.health.realtime import WIRE_PRIORITY, run_first

from . import protocol as p
from .generator import STEP_S, Limits, Trajectory

ENTRY = "strands_actors.drivers.franka.cycle:main"
WIRE_END, CYCLE_END = 0, 1
"""Of the page."""

FEED_S = 0.2
"""So long a setpoint stands without a word of the wire process. It re-sends every 50 ms."""
SILENT_MS = 20
"""Between two looks at whether the wire process is there, while no state comes."""
JUMP_TICKS = 5000
"""No controller that is still connected was silent for so long: a number beyond is no state's of
this one."""
START_TICKS = 1000
"""For a motion to begin, from the order to the first state that shows it."""

SAME_RAD = 3e-7
"""Below, the controller is where it was told to be: states of FCI 10 have single precision."""
LARGEST_GAP_RAD = 0.1
"""Nobody goes so far by himself in the 20 ms after which a controller ends a motion."""

MOST_STATES, MOST_ORDERS = 64, 64
"""Taken at once: a flood does not keep this process from looking at who else is there. The system
keeps fewer states for a socket."""

_ORDER = struct.Struct("<Q7d")
_REPORT = struct.Struct("<BQQQ")
LARGEST = _REPORT.size + 4096


class Ends(Protocol):
    """What is used of a socket for datagrams. Both raise ``OSError``."""

    def recv(self, size: int, /) -> bytes: ...

    def send(self, data: bytes, /) -> int: ...


class Phase(enum.IntEnum):
    IDLE = 0  # nothing to do
    STARTING = 1  # a goal, and the controller has not begun the motion yet
    MOVING = 2
    FINISHING = 3  # at the goal; the controller has been told


class Order(msgspec.Struct, frozen=True):
    """A goal from the wire process. Number 0: none any more, send nothing."""

    number: int
    goal: tuple[float, ...]

    def pack(self) -> bytes:
        return _ORDER.pack(self.number, *self.goal)


STAND_DOWN = Order(0, (0.0,) * 7)


class Report(msgspec.Struct, frozen=True):
    """What the wire process is told, with a state as it came."""

    phase: int
    reached: int  # number of the last order whose goal was reached
    missed: int  # milliseconds of motions whose state was not answered
    stamp_ns: int  # when the state was heard
    state: bytes

    @classmethod
    def unpack(cls, data: bytes) -> Report:
        phase, reached, missed, stamp_ns = _REPORT.unpack_from(data)
        return cls(phase, reached, missed, stamp_ns, data[_REPORT.size :])

    def pack(self) -> bytes:
        return _REPORT.pack(self.phase, self.reached, self.missed, self.stamp_ns) + self.state


class _Told(NamedTuple):
    """What the controller leads the arm to: rad, rad/s, rad/s^2."""

    position: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]

    def later(self, ticks: int) -> list[float]:
        """Return where that is so many milliseconds later, at a constant acceleration."""
        return [
            rad + (rad_s + rad_s2 * STEP_S * (ticks + 1) / 2) * STEP_S * ticks
            for rad, rad_s, rad_s2 in zip(*self, strict=True)
        ]


class Cycle:
    """What becomes of each state. Pure but for the page: bytes in, bytes out."""

    def __init__(self, dialect: p.Dialect, limits: Limits, heartbeat: Heartbeat) -> None:
        self.dialect = dialect
        self._limits = limits
        self._heartbeat = heartbeat
        self._trajectory: Trajectory | None = None
        self._order = STAND_DOWN
        self._ended_by_itself = False
        self._waited = 0
        self._last_id = 0
        self._heard = 0.0
        self.phase = Phase.IDLE
        self.reached = 0
        self.missed = 0
        self.went_on = 0
        """How often the controller went on by itself."""
        self._told: _Told | None = None  # by the last state
        self._sent: tuple[float, ...] | None = None

    def obey(self, data: bytes) -> None:
        if len(data) != _ORDER.size:
            return
        number, *goal = _ORDER.unpack(data)
        self._order = order = Order(number, tuple(goal))
        if not number:
            self.phase, self._trajectory = Phase.IDLE, None
        elif self.phase is Phase.MOVING and self._trajectory is not None and not self._ended_by_itself:
            self._trajectory.aim(order.goal)
        elif self.phase is Phase.IDLE:
            self.phase, self._waited = Phase.STARTING, 0
        # while it finishes or brakes: the wire process sees that the goal was not reached, and asks
        # again

    def is_news(self, data: bytes) -> bool:
        """Return whether ``data`` is a state, and the controller's clock has gone on since the
        last. One that tells no joints is none: the wire process could not take it either."""
        if not (self.dialect.is_plausible(data) and self.dialect.tells_joints(data)):
            return False
        (heard,) = self.dialect.get(data, "message_id")
        if self._heard and not 0 < heard - self._heard <= JUMP_TICKS:
            return False  # an old one
        self._heard = heard
        return True

    def answer(self, state: bytes, now_ns: int) -> bytes | None:
        """Return the command that answers a state; None: nothing is to be sent."""
        (message_id,) = self.dialect.get(state, "message_id")
        elapsed = int(message_id) - self._last_id
        if self.phase is Phase.IDLE:
            self._last_id = int(message_id)
            return None
        if not 0 < elapsed <= JUMP_TICKS:
            return None
        self._last_id = int(message_id)
        (generator,) = self.dialect.get(state, "generator")
        running = generator == p.Generator.JOINT_POSITION
        if self.phase is Phase.STARTING:
            self._waited += elapsed
            if not running:
                if self._waited > START_TICKS:
                    self.phase = Phase.IDLE
                return None
            if not self._begin(self.dialect.get(state, "q_d")):
                return None
            elapsed = 1
        elif not running:  # it has ended, or was ended
            self.phase, self._trajectory = Phase.IDLE, None
            return None
        trajectory = self._trajectory
        if trajectory is None:
            return None
        self.missed += elapsed - 1
        fed = now_ns - self._heartbeat.heard_ns <= FEED_S * NS
        if self.phase is Phase.MOVING and not fed and not self._ended_by_itself:
            self._ended_by_itself = True
            trajectory.brake()
        for _ in range(min(elapsed, p.MISSED_TICKS) - 1):
            trajectory.step()  # the path keeps its time
        told = _Told(*(self.dialect.get(state, name) for name in ("q_d", "dq_d", "ddq_d")))
        if self._went_on(told, elapsed):
            self.went_on += 1
            trajectory.meet(*told)
        self._told = told
        self._sent = position = trajectory.step()
        if self.phase is Phase.MOVING and trajectory.arrived:
            self.phase = Phase.FINISHING
            if not self._ended_by_itself:
                self.reached = self._order.number
        return self.dialect.position_command(int(message_id), position, self.phase is Phase.FINISHING)

    def _went_on(self, told: _Told, elapsed: int) -> bool:
        """Return whether the controller has gone on by itself, since an answer came too late: by a
        constant acceleration (libfranka's rate_limiting.h). A difference that is no such motion is
        its own affair."""
        before, sent = self._told, self._sent
        if before is None or sent is None:
            return False
        apart_rad = max(abs(there - here) for there, here in zip(told.position, sent, strict=True))
        if not SAME_RAD < apart_rad < LARGEST_GAP_RAD:
            return False
        by_itself = before.later(elapsed)
        return max(abs(there - here) for there, here in zip(told.position, by_itself, strict=True)) < apart_rad

    def _begin(self, q_d: tuple[float, ...]) -> bool:
        if not all(abs(rad) <= p.LARGEST_NUMBER for rad in q_d):
            return False
        self._trajectory = Trajectory(self._limits, q_d)
        self._trajectory.aim(self._order.goal)
        self._ended_by_itself = False
        self._told = self._sent = None
        self.phase = Phase.MOVING
        return True


class Reporter:
    """Which states the wire process is told of: each ``stride``-th, and each that shows something
    new."""

    def __init__(self, dialect: p.Dialect, stride: int) -> None:
        self._dialect = dialect
        self._stride = stride
        self._next_id = 0.0
        self._told: tuple[Any, ...] = ()

    def is_due(self, state: bytes, phase: Phase) -> bool:
        get = self._dialect.get
        (message_id,) = get(state, "message_id")
        shown = (phase, get(state, "robot_mode"), get(state, "generator"))
        if shown == self._told and self._next_id - self._stride <= message_id < self._next_id:
            return False
        self._told, self._next_id = shown, message_id + self._stride
        return True


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry of the process."""
    _end_with(args["parent"])
    run_first(WIRE_PRIORITY)
    gc.disable()  # nothing here makes cycles; a pause would be a missed command
    dialect = p.DIALECTS[args["fci"]]
    limits = msgspec.convert(args["limits"], Limits)
    udp = socket.socket(fileno=args["udp"])
    wire = socket.socket(fileno=args["wire"])
    wire.setblocking(False)
    heartbeat = Heartbeat(words_of(args["page"]), CYCLE_END, WIRE_END)
    os.close(args["page"])
    run(Cycle(dialect, limits, heartbeat), Reporter(dialect, args["stride"]), udp, wire, sock, heartbeat)


def run(
    cycle: Cycle,
    reporter: Reporter,
    udp: socket.socket,
    wire: socket.socket,
    parent: socket.socket,
    heartbeat: Heartbeat,
) -> None:
    """Until the wire process is gone."""
    parent.setblocking(False)
    udp.setblocking(False)
    arrived = select.poll()
    arrived.register(udp, select.POLLIN)
    while True:
        state = newest(udp) if arrived.poll(SILENT_MS) else b""
        if turn(cycle, reporter, state, udp, wire, heartbeat, time.monotonic_ns()) and _is_gone(parent):
            return


def turn(
    cycle: Cycle, reporter: Reporter, state: bytes, udp: Ends, wire: Ends, heartbeat: Heartbeat, now_ns: int
) -> bool:
    """Answer a state, and report it. Return whether it is time to look for the wire process: it was
    reported, or nothing new came."""
    for _ in range(MOST_ORDERS):
        if (order := _receive(wire)) is None:
            break
        cycle.obey(order)
    if not cycle.is_news(state):
        return True
    heartbeat.beat(now_ns)
    command = cycle.answer(state, now_ns)
    if command is not None:
        _send(udp, command)
    if not reporter.is_due(state, cycle.phase):
        return False
    _send(wire, Report(cycle.phase, cycle.reached, cycle.missed, now_ns, state).pack())
    return True


def newest(udp: Ends) -> bytes:
    """Return the newest state of those that wait; empty when there is none."""
    state = b""
    with contextlib.suppress(OSError):  # no more, or a command met a closed port
        for _ in range(MOST_STATES):
            state = udp.recv(LARGEST)
    return state


def _receive(wire: Ends) -> bytes | None:
    try:
        return wire.recv(_ORDER.size + 1)
    except OSError:  # nothing there, or nobody any more
        return None


def _send(there: Ends, data: bytes) -> None:
    """Send a datagram now or not at all: one that waits would be late. Who reads nothing is judged
    by others."""
    with contextlib.suppress(OSError):
        there.send(data)


def _is_gone(parent: socket.socket) -> bool:
    try:
        return parent.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def _end_with(parent: int) -> None:
    """End when the wire process ends, even stopped: nobody else would wake us up then."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os._exit(1)
