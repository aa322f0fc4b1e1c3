"""What any servo says of itself when its wire is opened, as gates and status take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol


class Identity(Protocol):
    """Each wire's own has more."""

    @property
    def model_name(self) -> str: ...
    @property
    def firmware(self) -> object: ...
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


def limits_of(servos: Sequence[Identity]) -> dict[str, tuple[float, ...]]:
    """For the gates, as sensors that do not change: in the order of the axes."""
    return {
        "voltage_min_v": tuple(servo.min_voltage_v for servo in servos),
        "voltage_max_v": tuple(servo.max_voltage_v for servo in servos),
        "temperature_max_c": tuple(servo.max_temperature_c for servo in servos),
    }


def facts_of(servos: Mapping[str, Identity]) -> dict[str, dict[str, object]]:
    """For ``status``. ``servos`` and what is returned: by axis key."""
    return {
        "model": {key: servo.model_name for key, servo in servos.items()},
        "firmware": {key: servo.firmware for key, servo in servos.items()},
        "voltage_v": {key: servo.voltage_v for key, servo in servos.items()},
        "temperature_c": {key: servo.temperature_c for key, servo in servos.items()},
        "energised": {key: servo.torque for key, servo in servos.items()},
    }
