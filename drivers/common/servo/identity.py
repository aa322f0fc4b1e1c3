"""The values that every servo reports when the connection is opened, in the form that other modules need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from .axes import Axis


class Identity(Protocol):
    """The model, firmware and limits of one servo, as it reports them when the connection is opened. Each servo
    family has a class with more values."""

    @property
    def model_name(self) -> str: ...
    @property
    def firmware(self) -> object: ...
    @property
    def travel(self) -> tuple[int, int]:
        """Lowest and highest goal position that the servo accepts, in counts."""

    @property
    def min_voltage_v(self) -> float: ...
    @property
    def max_voltage_v(self) -> float: ...
    @property
    def max_temperature_c(self) -> float: ...
    @property
    def torque(self) -> bool: ...
    @property
    def voltage_v(self) -> float: ...
    @property
    def temperature_c(self) -> float: ...


def limits_of(axes: Sequence[Axis], servos: Sequence[Identity]) -> dict[str, tuple[float, ...]]:
    """Return the limits of the servos as constant sensor rows, in axis order. The checks of commands use them.

    ``travel_low`` and ``travel_high`` are the limits of the joint or of its servo, whichever are narrower, in the
    joint's unit.
    """
    travel = [_travel(axis, servo) for axis, servo in zip(axes, servos, strict=True)]
    return {
        "travel_low": tuple(low for low, _ in travel),
        "travel_high": tuple(high for _, high in travel),
        "voltage_min_v": tuple(servo.min_voltage_v for servo in servos),
        "voltage_max_v": tuple(servo.max_voltage_v for servo in servos),
        "temperature_max_c": tuple(servo.max_temperature_c for servo in servos),
    }


def _travel(axis: Axis, servo: Identity) -> tuple[float, float]:
    low, high = servo.travel
    first, second = axis.value(max(low, axis.low)), axis.value(min(high, axis.high))
    return min(first, second), max(first, second)


def facts_of(servos: Mapping[str, Identity]) -> dict[str, dict[str, object]]:
    """Return the properties of the servos that ``status`` shows, by name. The value of each is a dict by axis key.

    Args:
        servos: The servos by axis key.
    """
    return {
        "model": {key: servo.model_name for key, servo in servos.items()},
        "firmware": {key: servo.firmware for key, servo in servos.items()},
        "voltage_v": {key: servo.voltage_v for key, servo in servos.items()},
        "temperature_c": {key: servo.temperature_c for key, servo in servos.items()},
        "energised": {key: servo.torque for key, servo in servos.items()},
    }
