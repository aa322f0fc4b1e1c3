"""A robot behind an SDK that energises it when it connects and releases it when it disconnects. It uses the
small arm's wire."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import serial

from . import Robot, RobotConfig


@RobotConfig.register_subclass("reachy2")
@dataclass(kw_only=True)
class Reachy2Config(RobotConfig):
    ip_address: str = "localhost"
    cameras: Any = None
    disable_torque_on_disconnect: bool = False


class Reachy2(Robot):
    action_features = {"pan.pos": float, "lift.pos": float}  # noqa: RUF012
    is_calibrated = True

    def __init__(self, config: Reachy2Config) -> None:
        self.config = config
        self._serial: serial.Serial | None = None

    @property
    def is_connected(self) -> bool:
        return self._serial is not None

    def connect(self, calibrate: bool = False) -> None:
        self._serial = serial.Serial(self.config.ip_address, timeout=0.2, exclusive=True)
        self._say("on")

    def get_observation(self) -> dict[str, float]:
        pan, lift = self._say("read").split()
        return {"pan.pos": float(pan), "lift.pos": float(lift)}

    def send_action(self, action: Mapping[str, float]) -> Mapping[str, float]:
        self._say("goal " + " ".join(f"{key}={value}" for key, value in action.items()))
        return action

    def disconnect(self) -> None:
        assert self.config.disable_torque_on_disconnect and self._serial is not None
        self._say("off")
        self._serial.close()
        self._serial = None

    def _say(self, text: str) -> str:
        assert self._serial is not None
        self._serial.write(text.encode() + b"\n")
        answer = self._serial.readline()
        if not answer:
            raise TimeoutError("the robot is silent")
        return answer.decode()


RobotConfig.makers[Reachy2Config] = Reachy2
