"""The process that answers each state of the controller with a command, a thousand times a second.

It is a separate process, so that no other work delays it. A thread in a process that was busy for 15 % of the time
sent 3 to 11 % of its commands late. This process only receives a state, computes the next step of the trajectory
and sends it.

The wire process (it talks to the controller on TCP) sends an ``Order`` with a goal over a pair of sockets, and
receives a ``Report``. The two processes also share a page of memory. On this page the cycle process writes the time
of the last state, and the wire process writes the time at which its setpoint was last valid. If the wire process
stops writing that time, the cycle process brakes the arm and ends the motion.

The cycle process cannot begin or stop a motion, because both are requested on TCP. The TCP connection ends with the
wire process.

The phases of a motion:

    IDLE         nothing to send
    STARTING     there is a goal, but the controller has not begun the motion
    MOVING       each state is answered with a step
    FINISHING    the arm is at the goal, and the commands are marked as finished, until the controller ends the
                 motion
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
"""Indices in the shared page."""

FEED_S = 0.2
"""A setpoint is valid for this long without a note of the wire process. The wire re-sends every 50 ms."""
SILENT_MS = 20
"""Period of the check for the wire process while no state arrives."""
JUMP_TICKS = 5000
"""No controller that is still connected is silent for this long. A message id that is further ahead does not
belong to a state of this controller."""
START_TICKS = 1000
"""Most milliseconds from the order to the first state in which the motion has begun."""

SAME_RAD = 3e-7
"""Below this difference the controller is at the commanded position: states of FCI 10 have single precision."""
LARGEST_GAP_RAD = 0.1
"""A controller does not move further than this by itself in the 20 ms after which it ends a motion."""

MOST_STATES, MOST_ORDERS = 64, 64
"""Most datagrams to take at once, so that a flood cannot keep this process from checking for its parent. The
system buffers fewer states for a socket."""

_ORDER = struct.Struct("<Q7d")
_REPORT = struct.Struct("<BQQQ")
LARGEST = _REPORT.size + 4096


class Ends(Protocol):
    """The two methods of a datagram socket that this module calls. Both may raise ``OSError``."""

    def recv(self, size: int, /) -> bytes: ...

    def send(self, data: bytes, /) -> int: ...


class Phase(enum.IntEnum):
    IDLE = 0
    STARTING = 1
    MOVING = 2
    FINISHING = 3


class Order(msgspec.Struct, frozen=True):
    """A goal from the wire process. An order with number 0 cancels the last goal: no further command is sent."""

    number: int
    goal: tuple[float, ...]

    def pack(self) -> bytes:
        return _ORDER.pack(self.number, *self.goal)


STAND_DOWN = Order(0, (0.0,) * 7)


class Report(msgspec.Struct, frozen=True):
    """A report to the wire process: the progress of its order, and one state of the controller, not decoded."""

    phase: int
    reached: int  # number of the last order whose goal was reached
    missed: int  # milliseconds of motions in which a state was not answered
    stamp_ns: int  # when the state was received
    state: bytes

    @classmethod
    def unpack(cls, data: bytes) -> Report:
        phase, reached, missed, stamp_ns = _REPORT.unpack_from(data)
        return cls(phase, reached, missed, stamp_ns, data[_REPORT.size :])

    def pack(self) -> bytes:
        return _REPORT.pack(self.phase, self.reached, self.missed, self.stamp_ns) + self.state


class _Motion(NamedTuple):
    """Position, speed and acceleration that the controller commands to the joints (rad, rad/s, rad/s^2)."""

    position: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]

    def later(self, ticks: int) -> list[float]:
        """Return the joint positions after ``ticks`` milliseconds of constant acceleration."""
        return [
            rad + (rad_s + rad_s2 * STEP_S * (ticks + 1) / 2) * STEP_S * ticks
            for rad, rad_s, rad_s2 in zip(*self, strict=True)
        ]


class Cycle:
    """Compute the command that answers each state. Apart from the page of memory that it shares with the wire
    process, it reads and writes nothing."""

    def __init__(self, dialect: p.Dialect, limits: Limits, heartbeat: Heartbeat) -> None:
        self.dialect = dialect
        self._limits = limits
        self._heartbeat = heartbeat
        self._trajectory: Trajectory | None = None
        self._order = STAND_DOWN
        self._ended_by_itself = False
        self._waited = 0
        self._last_id = 0
        self._last_message_id = 0.0
        self.phase = Phase.IDLE
        self.reached = 0
        self.missed = 0
        self.times_continued = 0
        """Number of times that the controller continued by itself."""
        self._last_motion: _Motion | None = None  # The motion that the last state reported.
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
        # A goal that arrives while the motion finishes or brakes is ignored. The wire process sees that this goal
        # was not reached, and sends it again.

    def is_news(self, data: bytes) -> bool:
        """Return whether ``data`` is a state with a later controller time than the last one. A state without
        valid joints does not count, because the wire process could not use it either."""
        if not (self.dialect.is_plausible(data) and self.dialect.has_plausible_joints(data)):
            return False
        (message_id,) = self.dialect.get(data, "message_id")
        if self._last_message_id and not 0 < message_id - self._last_message_id <= JUMP_TICKS:
            return False  # This state is older than the last one, or not from this controller.
        self._last_message_id = message_id
        return True

    def answer(self, state: bytes, now_ns: int) -> bytes | None:
        """Return the command that answers a state; None if nothing must be sent."""
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
        elif not running:  # The motion has ended.
            self.phase, self._trajectory = Phase.IDLE, None
            return None
        trajectory = self._trajectory
        if trajectory is None:
            return None
        self.missed += elapsed - 1
        fed = now_ns - self._heartbeat.last_received_ns <= FEED_S * NS
        if self.phase is Phase.MOVING and not fed and not self._ended_by_itself:
            self._ended_by_itself = True
            trajectory.brake()
        for _ in range(min(elapsed, p.MISSED_TICKS) - 1):
            trajectory.step()  # Skip the steps of missed states, so that the trajectory stays on time.
        commanded = _Motion(*(self.dialect.get(state, name) for name in ("q_d", "dq_d", "ddq_d")))
        if self._continued_by_itself(commanded, elapsed):
            self.times_continued += 1
            trajectory.meet(*commanded)
        self._last_motion = commanded
        self._sent = position = trajectory.step()
        if self.phase is Phase.MOVING and trajectory.arrived:
            self.phase = Phase.FINISHING
            if not self._ended_by_itself:
                self.reached = self._order.number
        return self.dialect.position_command(int(message_id), position, self.phase is Phase.FINISHING)

    def _continued_by_itself(self, commanded: _Motion, elapsed: int) -> bool:
        """Return whether the controller has continued the motion by itself because a command came too late.

        The controller then keeps the acceleration constant (libfranka's rate_limiting.h). If its position does not
        fit a constant acceleration, the difference has another cause and is ignored.
        """
        before, sent = self._last_motion, self._sent
        if before is None or sent is None:
            return False
        apart_rad = max(abs(rad - sent_rad) for rad, sent_rad in zip(commanded.position, sent, strict=True))
        if not SAME_RAD < apart_rad < LARGEST_GAP_RAD:
            return False
        by_itself = before.later(elapsed)
        error_rad = max(abs(rad - expected) for rad, expected in zip(commanded.position, by_itself, strict=True))
        return error_rad < apart_rad

    def _begin(self, q_d: tuple[float, ...]) -> bool:
        if not all(abs(rad) <= p.LARGEST_NUMBER for rad in q_d):
            return False
        self._trajectory = Trajectory(self._limits, q_d)
        self._trajectory.aim(self._order.goal)
        self._ended_by_itself = False
        self._last_motion = self._sent = None
        self.phase = Phase.MOVING
        return True


class Reporter:
    """Select the states to report to the wire process.

    These are each ``stride``-th state, and each state in which the phase, robot mode or motion generator has
    changed.
    """

    def __init__(self, dialect: p.Dialect, stride: int) -> None:
        self._dialect = dialect
        self._stride = stride
        self._next_id = 0.0
        self._last_reported: tuple[Any, ...] = ()

    def is_due(self, state: bytes, phase: Phase) -> bool:
        get = self._dialect.get
        (message_id,) = get(state, "message_id")
        shown = (phase, get(state, "robot_mode"), get(state, "generator"))
        if shown == self._last_reported and self._next_id - self._stride <= message_id < self._next_id:
            return False
        self._last_reported, self._next_id = shown, message_id + self._stride
        return True


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the process that answers the controller. This is its entry point."""
    _end_with(args["parent"])
    run_first(WIRE_PRIORITY)
    gc.disable()  # This process makes no reference cycles, and a pause would be a missed command.
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
    """Answer states until the wire process is gone."""
    parent.setblocking(False)
    udp.setblocking(False)
    arrived = select.poll()
    arrived.register(udp, select.POLLIN)
    while True:
        state = newest(udp) if arrived.poll(SILENT_MS) else b""
        if turn(cycle, reporter, state, udp, wire, heartbeat, time.monotonic_ns()) and _has_ended(parent):
            return


def turn(
    cycle: Cycle, reporter: Reporter, state: bytes, udp: Ends, wire: Ends, heartbeat: Heartbeat, now_ns: int
) -> bool:
    """Answer a state and report it.

    Returns:
        True if the caller should now check whether the wire process still runs: the state was reported, or no new
        state had arrived.
    """
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
    """Return the newest state that has arrived at the socket, and discard the older ones; empty if no state has
    arrived."""
    state = b""
    with contextlib.suppress(OSError):  # No state is left, or an earlier command was sent to a closed port.
        for _ in range(MOST_STATES):
            state = udp.recv(LARGEST)
    return state


def _receive(wire: Ends) -> bytes | None:
    try:
        return wire.recv(_ORDER.size + 1)
    except OSError:  # There is no order, or the wire process has gone.
        return None


def _send(sock: Ends, data: bytes) -> None:
    """Send a datagram if the socket accepts it now. Otherwise drop it, because later it would be useless."""
    with contextlib.suppress(OSError):
        sock.send(data)


def _has_ended(parent: socket.socket) -> bool:
    try:
        return parent.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def _end_with(parent: int) -> None:
    """Let the system kill this process when the wire process ends.

    This also ends a process that was suspended by a signal, which could not notice the end by itself.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # 1 is PR_SET_PDEATHSIG: the signal at the parent's death.
        if os.getppid() != parent:
            os._exit(1)
