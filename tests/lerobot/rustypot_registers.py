"""The servos of a bus by rustypot, as in the hardware layer of LeRobot 0.7: registers by name, one bus object.

rustypot has LeRobot's names of the registers in small letters. Its bus shows no descriptor, and it locks its port:
an ordinary user cannot open the port a second time. This module imports nothing of LeRobot.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import rustypot

DEFINITIONS = {
    "sts3215": rustypot.Sts3215PyController,
    "scs0009": rustypot.Scs0009PyController,
    "xl430-w250": rustypot.Xl430PyController,
    "xl330-m288": rustypot.Xl330PyController,
    "xl330-m077": rustypot.Xl330PyController,
}
BAUD, TIMEOUT_S, TRIES = 1_000_000, 1.0, 3
"""LeRobot's timeout of an answer is also a second."""


class Registers:
    """The registers of the servos of one port.

    Args:
        port: The serial device.
        models: Id and model of each servo, by the name of its motor.
    """

    def __init__(self, port: str, models: Mapping[str, tuple[int, str]]) -> None:
        self._port = port
        self._ids = {name: servo for name, (servo, _) in models.items()}
        self._definitions = {servo: DEFINITIONS[model].definition() for servo, model in models.values()}
        self._bus: rustypot.Bus | None = None

    @property
    def is_open(self) -> bool:
        return self._bus is not None

    def open(self) -> dict[int, int]:
        """Open the port. Return the model number of each servo, by id. Raise ``RuntimeError`` if one does not
        answer."""
        self._bus = bus = rustypot.Bus(self._port, BAUD, TIMEOUT_S, self._definitions)
        try:
            # Not ``scan``: it waits for milliseconds only, and takes a later answer for that of the next id.
            return {servo: bus.read_register(servo, "model_number", TRIES) for servo in self._definitions}
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        bus, self._bus = self._open(), None
        bus.close()

    def read(self, register: str, motor: str, tries: int = 0) -> int:
        """Return the raw value of a register. Raise ``ConnectionError`` if the servo does not answer."""
        try:
            return self._open().read_register(self._ids[motor], register.lower(), tries)
        except RuntimeError as error:
            raise ConnectionError(f"Failed to read {register!r} on {motor}: {error}") from error

    def write(self, register: str, motor: str, value: int, tries: int = 0) -> None:
        """Write the raw value of a register. Raise ``ConnectionError`` if the servo does not acknowledge."""
        try:
            self._open().write_register(self._ids[motor], register.lower(), value, tries)
        except RuntimeError as error:
            raise ConnectionError(f"Failed to write {register!r} on {motor}: {error}") from error

    def sync_read(self, register: str, motors: Sequence[str], tries: int = 0) -> dict[str, int]:
        """Return the raw value of a register of several servos. Raise ``ConnectionError`` if one does not answer,
        and ``NotImplementedError`` for servos that have no such request."""
        if not all(self._definitions[self._ids[motor]].supports_sync_read for motor in motors):
            raise NotImplementedError(f"{', '.join(motors)}: 'Sync Read' is not available. Use 'Read' sequentially")
        try:
            values = self._open().sync_read_register(self._of(motors), register.lower(), tries)
        except RuntimeError as error:
            raise ConnectionError(f"Failed to sync read {register!r}: {error}") from error
        return dict(zip(motors, values, strict=True))

    def sync_write(self, register: str, values: Mapping[str, int], tries: int = 0) -> None:
        """Write a register of several servos in one frame, which no servo acknowledges."""
        try:
            self._open().sync_write_register(self._of(values), register.lower(), list(values.values()), tries)
        except RuntimeError as error:
            raise ConnectionError(f"Failed to sync write {register!r}: {error}") from error

    def _of(self, motors: Iterable[str]) -> list[int]:
        return [self._ids[motor] for motor in motors]

    def _open(self) -> rustypot.Bus:
        if self._bus is None:
            raise ConnectionError(f"{self._port} is not open")
        return self._bus
