"""LeRobot's own robots and leaders on a bus that is shaped as the one of LeRobot 0.7 is.

LeRobot 0.7 has replaced the vendors' libraries by rustypot. It could not be installed when this was written, so the
buses of the installed LeRobot are replaced by buses on rustypot when this module is imported. LeRobot's command
line imports it by ``--teleop.discover_packages_path=tests.lerobot.on_rustypot``; the wire process imports it with
the classes ``So101`` and ``Koch``, and the process of a teleoperation with ``make``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from lerobot.motors import dynamixel, feetech
from lerobot.motors.motors_bus import SerialMotorsBus

from strands_actors.drivers.plain.lerobot.follower import Follower, class_of
from strands_actors.teleoperation.lerobot import make

from ..rustypot_registers import Registers


class OnRustypot(SerialMotorsBus):
    """A bus of LeRobot without ``port_handler`` and ``packet_handler``. It goes before LeRobot's own bus, from
    which it has calibration, units and configuration."""

    def __init__(self, port: str, motors: Mapping[str, Any], calibration: Any = None) -> None:
        SerialMotorsBus.__init__(self, port, motors, calibration)
        self._registers = Registers(port, {name: (motor.id, motor.model) for name, motor in motors.items()})

    @property
    def is_connected(self) -> bool:
        return self._registers.is_open

    def connect(self, handshake: bool = True) -> None:
        found = self._registers.open()
        expected = {motor.id: self.model_number_table[motor.model] for motor in self.motors.values()}
        if handshake and found != expected:
            self._registers.close()
            raise ConnectionError(f"{self.port}: found the models {found} by id, and expected {expected}")

    def disconnect(self, disable_torque: bool = True) -> None:
        if disable_torque:
            self.disable_torque(num_retry=5)
        self._registers.close()

    def read(self, data_name: str, motor: str, *, normalize: bool = True, num_retry: int = 0) -> Any:
        return self._out(data_name, {motor: self._registers.read(data_name, motor, num_retry)}, normalize)[motor]

    def write(self, data_name: str, motor: str, value: Any, *, normalize: bool = True, num_retry: int = 0) -> None:
        raw = self._into(data_name, {motor: value}, normalize)[motor]
        self._registers.write(data_name, motor, raw, num_retry)

    def sync_read(
        self, data_name: str, motors: Any = None, *, normalize: bool = True, num_retry: int = 0
    ) -> dict[str, Any]:
        names: Sequence[str] = self._get_motors_list(motors)
        return self._out(data_name, self._registers.sync_read(data_name, names, num_retry), normalize)

    def sync_write(
        self, data_name: str, values: Mapping[str, Any], *, normalize: bool = True, num_retry: int = 0
    ) -> None:
        self._registers.sync_write(data_name, self._into(data_name, values, normalize), num_retry)

    def _out(self, register: str, values: Mapping[str, int], normalize: bool) -> dict[str, Any]:
        if not normalize or register not in self.normalized_data:
            return dict(values)
        by_id = self._normalize({self.motors[name].id: value for name, value in values.items()})
        return {name: by_id[self.motors[name].id] for name in values}

    def _into(self, register: str, values: Mapping[str, Any], normalize: bool) -> dict[str, int]:
        if not normalize or register not in self.normalized_data:
            return {name: int(value) for name, value in values.items()}
        by_id = self._unnormalize({self.motors[name].id: value for name, value in values.items()})
        return {name: by_id[self.motors[name].id] for name in values}


class FeetechOnRustypot(OnRustypot, feetech.FeetechMotorsBus):
    protocol_version = 0  # LeRobot's own code of this class asks for it


class DynamixelOnRustypot(OnRustypot, dynamixel.DynamixelMotorsBus):
    pass


def _replace(old: type[Any], new: type[Any]) -> None:
    """Replace a class of LeRobot in all modules that have imported it."""
    for module in [module for name, module in sys.modules.items() if name.startswith("lerobot")]:
        if vars(module).get(old.__name__) is old:
            setattr(module, old.__name__, new)


_replace(feetech.FeetechMotorsBus, FeetechOnRustypot)
_replace(dynamixel.DynamixelMotorsBus, DynamixelOnRustypot)


def _on_rustypot(robot: str, name: str) -> type[Follower]:
    """Return the class of a robot, which the wire process finds in this module."""
    return type(name, (class_of(robot),), {"__module__": __name__})


So101 = _on_rustypot("so101", "So101")
Koch = _on_rustypot("koch", "Koch")
CLASSES = {"so101": So101, "koch": Koch}

__all__ = ["CLASSES", "Koch", "So101", "make"]
