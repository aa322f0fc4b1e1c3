"""The CAN buses of one arm, and the newest feedback of each motor.

The wire process and the stop channel each have one. No call here waits.
"""

from __future__ import annotations

import contextlib
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.kernel.clock import Clock

from .can_port import CanPort, OpenPort
from .config import CanConfig
from .protocol import Command, Feedback, Frame, Parameter, State

NOTHING = Feedback(math.nan, math.nan, math.nan, math.nan, math.nan, State.DISABLED)
"""Stands for the feedback of a motor that was never heard."""

Addressed = tuple[int, Frame]
"""A frame with the index of its motor."""


class Link:
    """The open buses of an arm.

    Args:
        config: The arm.
        ports: Its buses, in their order.
        clock: The clock.
    """

    def __init__(self, config: CanConfig, ports: Sequence[CanPort], clock: Clock) -> None:
        self.clock = clock
        self.motors = config.arm.motors
        self.codecs = [motor.codec() for motor in self.motors]
        self.feedback = [NOTHING] * len(self.motors)
        self.stamp_ns = [0] * len(self.motors)
        self.parameters: dict[tuple[int, int], Parameter] = {}
        """The parameters that were received, by the index of the motor and the number of the parameter."""
        self.ports = tuple(ports)
        self._index = {
            (motor.bus, codec.feedback_id if motor.type.family == "damiao" else -codec.id): index
            for index, (motor, codec) in enumerate(zip(self.motors, self.codecs, strict=True))
        }

    @classmethod
    def open(cls, config: CanConfig, clock: Clock, open_port: OpenPort = open_serial) -> Link:
        """Open all buses. Raise ``WireDown`` if one cannot be opened. Then no bus stays open."""
        ports: list[CanPort] = []
        try:
            for name, adapter in zip(config.ports, config.adapters, strict=True):
                ports.append(CanPort.open(name, adapter, config.baud, open_port))
        except WireDown:
            for port in ports:
                port.close()
            raise
        return cls(config, ports, clock)

    def poll(self) -> None:
        """Take the frames that have arrived on all buses. Then raise ``WireDown`` if one is lost."""
        lost: WireDown | None = None
        now_ns = self.clock.now_ns()
        for bus, port in enumerate(self.ports):
            try:
                for frame in port.received():
                    index = self._index.get((bus, -(frame.id >> 8 & 0xFF) if frame.extended else frame.id))
                    if index is not None:
                        self._take(index, frame, now_ns)
            except WireDown as down:
                lost = down
        if lost is not None:
            raise lost

    def _take(self, index: int, frame: Frame, now_ns: int) -> None:
        decoded = self.codecs[index].decode(frame)
        if isinstance(decoded, Feedback):
            self.feedback[index], self.stamp_ns[index] = decoded, now_ns
        elif decoded is not None:
            self.parameters[index, decoded.number] = decoded

    def command(self, commands: Iterable[Command]) -> list[Addressed]:
        """Return the frames of one command for each motor."""
        return [
            (index, codec.command(command))
            for index, (codec, command) in enumerate(zip(self.codecs, commands, strict=True))
        ]

    def send(self, frames: Iterable[Addressed]) -> None:
        """Send frames at once, with one write for each bus. Raise ``WireDown`` if a bus is lost."""
        for bus, grouped in self._by_bus(frames).items():
            self.ports[bus].send(frame for _, frame in grouped)

    def send_stop(self, frames: Iterable[Addressed], resync: bool = False) -> dict[int, str]:
        """Send the frames of a stop at once, also on the other buses if one is lost. Never raises.

        Args:
            frames: The frames.
            resync: True to end an incomplete frame of an earlier writer first.

        Returns:
            For each motor why its frame was not sent; empty if it was.
        """
        failures: dict[int, str] = {}
        for bus, grouped in self._by_bus(frames).items():
            failure = ""
            if resync:
                # Even if this fails, the stop may be sent.
                with contextlib.suppress(WireDown):
                    self.ports[bus].resync()
            try:
                self.ports[bus].send(frame for _, frame in grouped)
            except WireDown as down:
                failure = str(down)
            failures |= {index: failure for index, _ in grouped}
        return failures

    def _by_bus(self, frames: Iterable[Addressed]) -> dict[int, list[Addressed]]:
        grouped: dict[int, list[Addressed]] = defaultdict(list)
        for index, frame in frames:
            grouped[self.motors[index].bus].append((index, frame))
        return grouped

    def silent(self, since_ns: int) -> list[int]:
        """Return the indices of the motors that were not heard since a time."""
        return [index for index, stamp_ns in enumerate(self.stamp_ns) if stamp_ns < since_ns]

    def names(self, indices: Iterable[int]) -> str:
        """Return keys and ids of motors, for messages."""
        return ", ".join(f"{self.motors[index].key} (id {self.motors[index].id})" for index in indices)

    def close(self) -> None:
        for port in self.ports:
            port.close()


def failed(config: CanConfig, reason: str, written: bool = False) -> tuple[MotorReport, ...]:
    """Return reports in which no motor is confirmed to be safe, with ``reason`` as the detail."""
    return tuple(MotorReport(motor.key, motor.id, written, False, False, reason) for motor in config.arm.motors)
