"""A robot in memory: two axes, a wire that can be slow, silent or disconnected, and a record of all frames.

It replaces a driver in tests of the robot's processes, also in virtual time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import trio

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, StopChannel, Wire, WireDown
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

AXES = ("a", "b")
LIMIT = 100.0


class Written(NamedTuple):
    """One frame that was sent to the robot in memory.

    Attributes:
        t_ns: Time at which the frame was written.
        kind: ``setpoint``, ``safe``, ``enable``, or ``read`` (of a handshake).
        safe_state: The safe state, for a frame of the kind ``safe``.
        values: The values of a setpoint, or the positions when a safe frame came.
        path: The sender: ``wire`` or ``stop_channel``.
    """

    t_ns: int
    kind: str
    safe_state: str
    values: tuple[float, ...]
    path: str


@dataclass
class FakeHardware:
    """The fake robot behind the connection. A test changes its settings."""

    position: list[float] = field(default_factory=lambda: [0.0] * len(AXES))
    energised: list[bool] = field(default_factory=lambda: [False] * len(AXES))
    written: list[Written] = field(default_factory=list)
    plugged: bool = True
    answers: bool = True  # False: the robot receives frames and sends no replies
    confirm_s: float = 0.002  # time for reading the motors after a stop
    # False: the wire sees after ``confirm_s`` that the robot does not hold its position, and switches the torque
    # off.
    holds: bool = True
    open_s: float = 0.001  # duration of the handshake when the robot is connected
    silent: set[str] = field(default_factory=set)  # names of the axes that do not answer
    unreported: set[str] = field(default_factory=set)  # names of the axes whose positions are never reported
    read_s: float = 0.001
    write_s: float = 0.0  # time from a call of write until the bytes are sent
    read_hangs: bool = False
    opens: int = 0
    stamp_ns: list[int] = field(default_factory=lambda: [0] * len(AXES))

    def record(
        self, clock: Clock, kind: str, path: str, safe_state: str = "", values: Sequence[float] = ()
    ) -> None:
        """Add a frame to ``written``, with the present time of the clock.

        Args:
            clock: The clock of the robot's processes.
            kind: As in ``Written``.
            path: ``wire`` or ``stop_channel``.
            safe_state: The safe state, for a frame of the kind ``safe``.
            values: The values of a setpoint, or the positions when a safe frame came.
        """
        self.written.append(Written(clock.now_ns(), kind, safe_state, tuple(values), path))

    def of(self, kind: str, since_ns: int = 0) -> list[Written]:
        """Return the frames of one kind since a time (ns)."""
        return [entry for entry in self.written if entry.kind == kind and entry.t_ns >= since_ns]

    def after(self, kind: str, earlier: Written) -> list[Written]:
        """Return the frames of one kind that were written after the given frame, also those with the same time."""
        index = self.written.index(earlier)
        return [entry for entry in self.written[index + 1 :] if entry.kind == kind]

    def make_safe(self, clock: Clock, safe_state: str, path: str) -> tuple[MotorReport, ...]:
        """Bring each axis that answers to the safe state, and return a report for every axis.

        Args:
            clock: The clock of the robot's processes.
            safe_state: ``hold`` keeps an axis energised at its position. Any other state removes its torque.
            path: ``wire`` or ``stop_channel``.

        Returns:
            A report for each axis. An unplugged cable, or an axis without a reply, is not confirmed.
        """
        if not self.plugged:
            return tuple(
                MotorReport(axis, index, False, False, False, "no link") for index, axis in enumerate(AXES)
            )
        self.record(clock, "safe", path, safe_state, self.position)
        reports = []
        for index, axis in enumerate(AXES):
            answered = axis not in self.silent
            if answered:
                self.energised[index] = safe_state == SafeState.HOLD
            target = self.position[index] if answered and safe_state == SafeState.HOLD else None
            answered = answered and self.answers
            reports.append(MotorReport(axis, index, True, answered, answered, "" if answered else "silent", target))
        return tuple(reports)


HARDWARE: dict[str, FakeHardware] = {}
"""The hardware of each port that a ``FakeDriver`` can open."""


class FakeDriver(Driver):
    """A fake driver for a robot with two position axes.

    If the program that commands is late or has ended, the robot holds. For any other reason it goes limp.
    """

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("fake",)
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = ""
    OPTIONS: ClassVar[Mapping[str, str]] = {}

    unit = "units"
    timing = Timing(control_hz=50.0, keepalive_s=0.02, stream_ttl_s=0.1)
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP)
    firmware_watchdog = "The fake robot has no firmware"
    gates = ()

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        self.axes = AXES
        self.ids = tuple(range(len(AXES)))
        self.hardware = HARDWARE[port]

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Parse targets by axis. Refuse an unknown axis, and a target that is not a number within ``LIMIT``."""
        values, named = list(state.target), []
        for key, value in action.items():
            if key not in AXES:
                return Refused("unknown_joint", f"{key} is not an axis", f"use {', '.join(AXES)}")
            if not isinstance(value, int | float) or not math.isfinite(value) or abs(value) > LIMIT:
                return Refused("range", f"{key} is {value}", f"stay within {LIMIT}", str(value))
            values[AXES.index(key)] = float(value)
            named.append(AXES.index(key))
        return Candidate(tuple(values), tuple(named))

    def open_wire(self, clock: Clock) -> Wire:
        """Return a ``FakeWire`` to the hardware of the port."""
        return FakeWire(self.hardware, clock)

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        """Return a ``FakeStopChannel`` to the hardware of the port. It needs no descriptors."""
        return FakeStopChannel(self.hardware, clock)


class FakeWire(Wire):
    """The connection to a ``FakeHardware``. The settings of the hardware determine its waits and failures."""

    interruptible: ClassVar[bool] = True

    def __init__(self, hardware: FakeHardware, clock: Clock) -> None:
        self._hardware = hardware
        self._clock = clock

    def _check(self) -> None:
        if not self._hardware.plugged:
            raise WireDown("the cable of the fake robot is unplugged")

    def _check_answer(self) -> None:
        self._check()
        if not self._hardware.answers:
            raise WireDown("an axis does not answer")

    async def open(self) -> dict[str, Any]:
        """Record the frame of a handshake, and wait ``open_s``.

        If the cable is out or no reply comes, raise ``WireDown``.
        """
        self._check()
        self._hardware.record(self._clock, "read", "wire")
        await trio.sleep(self._hardware.open_s)
        self._check_answer()
        self._hardware.opens += 1
        return {"fake": True}

    async def arm(self, permit: Permit) -> Observation:
        """Energise one axis after the other, after a check (``permit``) before each that no stop has come.

        If an axis does not answer, raise ``WireDown``. The axes that were energised before stay energised.
        """
        for index, axis in enumerate(AXES):
            await trio.sleep(0.001)
            self._check()
            permit.check()
            if axis in self._hardware.silent:
                raise WireDown(f"{axis} did not confirm that its torque is on")
            self._hardware.energised[index] = True
            self._hardware.record(self._clock, "enable", "wire")
        return self._observe()

    async def read(self) -> Observation:
        """Return the positions after ``read_s``. If ``read_hangs`` is true, wait until it is false."""
        while self._hardware.read_hangs:  # noqa: ASYNC110  # a hang is intended
            await trio.sleep(1.0)
        await trio.sleep(self._hardware.read_s)
        self._check_answer()
        return self._observe()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Record the setpoint after ``write_s``. Each energised axis reaches its target at once."""
        if self._hardware.write_s:
            await trio.sleep(self._hardware.write_s)
        self._check()
        permit.check()
        self._hardware.record(self._clock, "setpoint", "wire", values=values)
        for index, value in enumerate(values):
            if self._hardware.energised[index]:
                self._hardware.position[index] = value

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Write the safe state, and return a report on each axis after ``confirm_s``.

        If ``holds`` is false, a hold fails: ``hold_failed`` is set, and the axes lose their torque.
        """
        reports = self._hardware.make_safe(self._clock, safe_state, "wire")
        await trio.sleep(self._hardware.confirm_s)
        self.hold_failed = "it slips" if safe_state == SafeState.HOLD and not self._hardware.holds else ""
        return self._hardware.make_safe(self._clock, "limp", "wire") if self.hold_failed else reports

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """As ``make_safe``."""
        return await self.make_safe(safe_state)

    def close(self) -> None:
        """Do nothing, since nothing is open."""

    def _observe(self) -> Observation:
        now_ns = self._clock.now_ns()
        stamp_ns = self._hardware.stamp_ns
        for index, axis in enumerate(AXES):
            if axis not in self._hardware.silent and axis not in self._hardware.unreported:
                stamp_ns[index] = now_ns
        return Observation(now_ns, tuple(self._hardware.position), tuple(stamp_ns))


class FakeStopChannel(StopChannel):
    """The stop channel (second connection for a stop) to a ``FakeHardware``."""

    def __init__(self, hardware: FakeHardware, clock: Clock) -> None:
        self._hardware = hardware
        self._clock = clock

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Write the safe state, and return a report on each axis after 2 ms."""
        reports = self._hardware.make_safe(self._clock, safe_state, "stop_channel")
        await trio.sleep(0.002)
        return reports

    def close(self) -> None:
        """Do nothing, since nothing is open."""
