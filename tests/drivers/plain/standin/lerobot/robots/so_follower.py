"""An arm of Feetech servos, by the vendor's client as in LeRobot 0.4 to 0.6, or by rustypot as in LeRobot 0.7. As
with LeRobot, connecting configures the motors without torque. Then it restores the torque, with any goals."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import scservo_sdk as scs

from tests.lerobot.rustypot_registers import Registers

from . import Robot, RobotConfig

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
REGISTERS = {"Torque_Enable": (40, 1), "Goal_Position": (42, 2), "Present_Position": (56, 2)}
COUNTS_PER_DEGREE = 4095 / 360


@RobotConfig.register_subclass("so101_follower")
@dataclass(kw_only=True)
class SO101FollowerConfig(RobotConfig):
    port: str
    cameras: Any = None
    use_degrees: bool = False
    disable_torque_on_disconnect: bool = True
    bus: str = "vendor"


class Bus:
    """The bus with the vendor's client."""

    def __init__(self, port: str) -> None:
        self.port_handler = scs.PortHandler(port)
        self._packets = scs.PacketHandler(0)
        self.motors = dict.fromkeys(MOTORS)
        self.is_connected = False

    def connect(self) -> None:
        assert self.port_handler.openPort() and self.port_handler.setBaudRate(1_000_000)
        self.is_connected = True

    def disconnect(self, disable_torque: bool) -> None:
        if disable_torque:
            self.disable_torque(num_retry=5)
        self.is_connected = False
        self.port_handler.closePort()

    def sync_read(
        self, name: str, motors: Any = None, *, num_retry: int = 0, normalize: bool = True
    ) -> dict[str, float]:
        address, size = REGISTERS[name]
        read = self._packets.read2ByteTxRx if size == 2 else self._packets.read1ByteTxRx
        found: dict[str, float] = {}
        for at, motor in enumerate(MOTORS, start=1):
            value, failed, _ = read(self.port_handler, at, address)
            if failed:
                raise ConnectionError(f"Failed to sync read {name!r} on {motor}")
            found[motor] = _degrees(motor, value) if normalize else value
        return found

    def sync_write(self, name: str, values: Mapping[str, float], *, normalize: bool = True) -> None:
        address, size = REGISTERS[name]
        writer = scs.GroupSyncWrite(self.port_handler, self._packets, address, size)
        for motor, value in values.items():
            count = _counts(motor, value) if normalize else int(value)
            writer.addParam(MOTORS.index(motor) + 1, list(count.to_bytes(size, "little")))
        assert writer.txPacket() == scs.COMM_SUCCESS

    def enable_torque(self, motors: Any = None, num_retry: int = 0) -> None:
        self._torque(1)

    def disable_torque(self, motors: Any = None, num_retry: int = 0) -> None:
        self._torque(0)

    @contextlib.contextmanager
    def torque_disabled(self) -> Iterator[None]:
        self.disable_torque()
        try:
            yield
        finally:
            self.enable_torque()

    def _torque(self, value: int) -> None:
        for at, motor in enumerate(MOTORS, start=1):
            failed, _ = self._packets.write1ByteTxRx(self.port_handler, at, 40, value)
            if failed:
                raise ConnectionError(f"Failed to write torque on {motor}")


class RustypotBus(Bus):
    """The bus without any object of a vendor's: it has no ``port_handler``."""

    def __init__(self, port: str) -> None:
        self.motors = dict.fromkeys(MOTORS)
        self._bus = Registers(port, {motor: (at, "sts3215") for at, motor in enumerate(MOTORS, start=1)})

    @property
    def is_connected(self) -> bool:  # type: ignore[override]
        return self._bus.is_open

    def connect(self) -> None:
        self._bus.open()

    def disconnect(self, disable_torque: bool) -> None:
        if disable_torque:
            self.disable_torque(num_retry=5)
        self._bus.close()

    def sync_read(
        self, name: str, motors: Any = None, *, num_retry: int = 0, normalize: bool = True
    ) -> dict[str, float]:
        raw = self._bus.sync_read(name, motors or MOTORS, num_retry)
        return {motor: _degrees(motor, value) if normalize else value for motor, value in raw.items()}

    def sync_write(self, name: str, values: Mapping[str, float], *, normalize: bool = True) -> None:
        raw = {motor: _counts(motor, value) if normalize else int(value) for motor, value in values.items()}
        self._bus.sync_write(name, raw)

    def _torque(self, value: int) -> None:
        for motor in MOTORS:
            self._bus.write("Torque_Enable", motor, value)


BUSES = {"vendor": Bus, "rustypot": RustypotBus}


class SO101Follower(Robot):
    def __init__(self, config: SO101FollowerConfig) -> None:
        self.config = config
        self.bus = BUSES[config.bus](config.port)
        file = Path(config.calibration_dir or "") / f"{config.id}.json"
        self.is_calibrated = file.is_file() and set(json.loads(file.read_text())) == set(MOTORS)

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys((f"{motor}.pos" for motor in MOTORS), float)

    @property
    def is_connected(self) -> bool:
        return self.bus.is_connected

    def connect(self, calibrate: bool = True) -> None:
        assert not calibrate, "a calibration would wait for a person"
        self.bus.connect()
        with self.bus.torque_disabled():
            pass

    def get_observation(self) -> dict[str, float]:
        return {f"{motor}.pos": value for motor, value in self.bus.sync_read("Present_Position").items()}

    def send_action(self, action: Mapping[str, float]) -> Mapping[str, float]:
        self.bus.sync_write("Goal_Position", {key.removesuffix(".pos"): value for key, value in action.items()})
        return action

    def disconnect(self) -> None:
        self.bus.disconnect(self.config.disable_torque_on_disconnect)


RobotConfig.makers[SO101FollowerConfig] = SO101Follower


def _degrees(motor: str, count: float) -> float:
    return count / 40.95 if motor == "gripper" else (count - 2048) / COUNTS_PER_DEGREE


def _counts(motor: str, value: float) -> int:
    return round(value * 40.95 if motor == "gripper" else 2048 + value * COUNTS_PER_DEGREE)
