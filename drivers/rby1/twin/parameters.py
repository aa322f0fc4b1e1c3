"""The parameters of the simulated robot.

Names, defaults and ranges are from the vendor's list for model A, in the documentation of rby1-sdk. A parameter has
a value in use and a stored one. The robot reads the stored values when it starts.
"""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Iterator
from typing import NamedTuple

Value = int | float | str | list[float]


class Type(enum.IntEnum):
    """Types in the list of parameters."""

    INT = 0
    DOUBLE = 1
    TEXT = 2
    THREE = 3
    SIX = 4
    SEVEN = 5


class Invalid(Exception):
    """The robot refuses a request. The exception's text is the message in the header of its answer."""


class Parameter(NamedTuple):
    default: Value
    low: float = -math.inf
    high: float = math.inf

    @property
    def type(self) -> Type:
        match self.default:
            case int():
                return Type.INT
            case float():
                return Type.DOUBLE
            case str():
                return Type.TEXT
            case row:
                return Type.THREE if len(row) == 3 else Type.SEVEN


_TIME_S = Parameter(0.1, 1e-3, 1.0)
_CUTOFF_HZ = Parameter(15.0, 1e-3, 100.0)
_SCALE = Parameter(1.0, 0.01, 1.5)

PARAMETERS: dict[str, Parameter] = {
    # These have an effect in the simulated robot.
    "model_name": Parameter(""),
    "default.velocity_limit_scaling": _SCALE,
    "default.acceleration_limit_scaling": _SCALE,
    "default.linear_acceleration_limit": Parameter(20.0, 0.01, 60.0),
    "default.angular_acceleration_limit": Parameter(10.0, 0.01, 30.0),
    "default.cartesian_command.stop_position_tracking_error": Parameter(0.005, 1e-4, 1.0),
    "default.cartesian_command.stop_orientation_tracking_error": Parameter(0.02, 1e-3, 0.1),
    "default.cartesian_command.stop_joint_position_tracking_error": Parameter(0.01, 1e-3, 0.1),
    "default.cartesian_impedance_control_command.stop_position_tracking_error": Parameter(0.005, 1e-4, 1.0),
    "default.cartesian_impedance_control_command.stop_orientation_tracking_error": Parameter(0.02, 1e-3, 0.1),
    "default.cartesian_impedance_control_command.stop_joint_position_tracking_error": Parameter(0.01, 1e-3, 0.1),
    "default.optimal_control_command.stop_cost": Parameter(1e-3, 1e-6, 1e9),
    "default.se2_velocity_command.acceleration_limit": Parameter([1.0, 5.0, 99.0]),
    "jog_command.one_step_size": Parameter(0.087266463, 0.017453293, 0.17453293),
    "manipulability_threshold": Parameter(1e4, 1e2, 1e10),
    # Type (1: a fixed level), voltages of the empty and the full battery, and factors of the voltage's powers.
    "battery_config": Parameter([0.0, 44.7, 58.6, 1123.0, -61.587, 1.0168, -0.0045]),
    # The simulated robot only stores these: it switches at once, it does not filter, and it halts without delay.
    "robot_model_name": Parameter("rby1a"),
    "default.torque_limit_scaling": _SCALE,
    "soft_stop_enabled": Parameter(0, 0, 1),
    "major_fault_power_off_target": Parameter(".*"),
    "gravity": Parameter([0.0, 0.0, -9.8]),
    "power_command.timeout": Parameter(1.0, 0.0, 10.0),
    "servo_on_command.timeout": Parameter(15.0, 0.0, 30.0),
    "servo_on_command.new_data_timeout": Parameter(3.0, 0.0, 10.0),
    "preset_position_command.timeout": Parameter(5.0, 0.0, 30.0),
    "preset_position_command.new_data_timeout": Parameter(3.0, 0.0, 10.0),
    "real_time_control.max_timeout_count": Parameter(10, 1, 500),
    "joint_position_command.cutoff_frequency": _CUTOFF_HZ,
    "joint_group_position_command.cutoff_frequency": _CUTOFF_HZ,
    "cartesian_command.cutoff_frequency": _CUTOFF_HZ,
    "optimal_control_command.cutoff_frequency": _CUTOFF_HZ,
    "jog_command.canceling_time": Parameter(0.1, 1e-3, 10.0),
    **{
        f"{command}.canceling_time": _TIME_S
        for command in (
            "joint_position_command",
            "joint_group_position_command",
            "joint_impedance_control_command",
            "cartesian_command",
            "cartesian_impedance_control_command",
            "stop_command",
            "joint_velocity_command",
            "se2_velocity_command",
        )
    },
}


class Parameters:
    """The values of all parameters: those in use, and the stored ones."""

    def __init__(self) -> None:
        self._stored: dict[str, Value] = {name: row.default for name, row in PARAMETERS.items()}
        self._used = dict(self._stored)

    def number(self, name: str) -> float:
        """Return a number in use."""
        value = self._used[name]
        assert isinstance(value, int | float)
        return float(value)

    def row(self, name: str) -> list[float]:
        """Return a list in use."""
        value = self._used[name]
        assert isinstance(value, list)
        return value

    def text(self, name: str) -> str:
        return str(self._used[name])

    def listed(self) -> Iterator[tuple[str, Type]]:
        for name, parameter in PARAMETERS.items():
            yield name, parameter.type

    def encoded(self, name: str) -> str:
        """Return a value as the robot sends it. Raise ``Invalid`` for an unknown name."""
        self._find(name)
        return json.dumps({"value": self._used[name]})

    def set(self, name: str, encoded: str) -> None:
        """Set a parameter from a client's text. Raise ``Invalid`` for an unknown name or another kind of value."""
        parameter = self._find(name)
        try:
            content = json.loads(encoded)
            value, stores = content["value"], bool(content.get("write_db", True))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise Invalid(f"{name}: no value in {encoded[:64]!r}") from None
        self._used[name] = _checked(name, parameter, value)
        if stores:
            self._stored[name] = self._used[name]

    def put(self, name: str, value: Value) -> None:
        """Set and store a parameter. Raise ``Invalid`` for another kind of value."""
        self._used[name] = self._stored[name] = _checked(name, self._find(name), value)

    def reset(self, name: str = "") -> None:
        """Set a parameter, or all, to the stored value. Raise ``Invalid`` for an unknown name."""
        for each in [name] if name else PARAMETERS:
            self._find(each)
            self._used[each] = self._stored[each]

    def restore(self, name: str = "") -> None:
        """Set a parameter, or all, to the default. Raise ``Invalid`` for an unknown name."""
        for each in [name] if name else PARAMETERS:
            self._stored[each] = self._used[each] = self._find(each).default

    def _find(self, name: str) -> Parameter:
        if name not in PARAMETERS:
            raise Invalid(f"no parameter {name[:64]!r}")
        return PARAMETERS[name]


def _checked(name: str, parameter: Parameter, value: object) -> Value:
    """Return the value of a parameter. Raise ``Invalid`` if it has another type, or is out of range."""
    match parameter.type:
        case Type.TEXT if isinstance(value, str):
            return value
        case Type.INT if isinstance(value, int) and not isinstance(value, bool):
            numbers: list[float] = [value]
        case Type.DOUBLE if isinstance(value, int | float) and not isinstance(value, bool):
            numbers = [float(value)]
        case Type.THREE | Type.SEVEN if isinstance(value, list) and all(
            isinstance(each, int | float) and not isinstance(each, bool) for each in value
        ):
            numbers = [float(each) for each in value]
            assert isinstance(parameter.default, list)
            if len(numbers) != len(parameter.default):
                raise Invalid(f"{name}: {len(numbers)} numbers instead of {len(parameter.default)}")
        case _:
            raise Invalid(f"{name}: {str(value)[:64]!r} is not of the type {parameter.type.name}")
    if not all(math.isfinite(each) and parameter.low <= each <= parameter.high for each in numbers):
        raise Invalid(f"{name}: {str(value)[:64]} is not within {parameter.low:g} and {parameter.high:g}")
    return numbers if parameter.type in (Type.THREE, Type.SEVEN) else numbers[0]


__all__ = ["PARAMETERS", "Invalid", "Parameter", "Parameters", "Type", "Value"]
