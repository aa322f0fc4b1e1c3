"""A fake of Unitree's ``unitree_sdk2py``. ``install()`` registers the modules that strands-robots imports.

The fake robot stands in mode 501 with a charged battery. The time and the stiffness of every LowCmd are stored in
memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

FRAMES: list[tuple[int, float]] = []
"""Nanoseconds of CLOCK_MONOTONIC, and the sum of all kp, which is 0 in a frame of zero torque."""
MOTORS = 35

MESSAGES = {
    "rt/lowstate": SimpleNamespace(mode_machine=5, imu_state=None, motor_state=None),
    "rt/lf/bmsstate": SimpleNamespace(soc=80, current=0, cycle=1),
}


class Motor:
    def __init__(self) -> None:
        self.mode = 0
        self.q = self.dq = self.tau = self.kp = self.kd = 0.0


class LowCmd:
    def __init__(self) -> None:
        self.mode_pr = self.mode_machine = self.crc = 0
        self.motor_cmd = [Motor() for _ in range(MOTORS)]


class Publisher:
    def __init__(self, topic: str, message_type: Any) -> None:
        pass

    # The names of this class' methods are those of the SDK.
    def Init(self) -> None:
        pass

    def Write(self, command: LowCmd) -> None:
        FRAMES.append((time.monotonic_ns(), sum(motor.kp for motor in command.motor_cmd)))

    def Close(self) -> None:
        pass


class Subscriber:
    def __init__(self, topic: str, message_type: Any) -> None:
        self._topic = topic

    def Init(self, handler: Callable[[Any], None], depth: int) -> None:
        if self._topic in MESSAGES:
            handler(MESSAGES[self._topic])

    def Close(self) -> None:
        pass


class Crc:
    def Crc(self, command: LowCmd) -> int:
        return 0


class MotionSwitcher:
    def Init(self) -> None:
        pass

    def SetTimeout(self, seconds: float) -> None:
        pass

    def CheckMode(self) -> tuple[int, dict[str, Any]]:
        return 0, {"name": "ai", "form": 501}


def _type(name: str) -> type:
    return type(name, (), {})


MODULES: dict[str, dict[str, Any]] = {
    "core.channel": {
        "ChannelFactory": _type("ChannelFactory"),
        "ChannelFactoryInitialize": lambda domain, interface=None: None,
        "ChannelPublisher": Publisher,
        "ChannelSubscriber": Subscriber,
    },
    "comm.motion_switcher.motion_switcher_client": {"MotionSwitcherClient": MotionSwitcher},
    "idl.default": {"unitree_hg_msg_dds__LowCmd_": LowCmd},
    "idl.unitree_hg.msg.dds_": {
        name: _type(name) for name in ("LowCmd_", "LowState_", "BmsState_", "MainBoardState_", "PressSensorState_")
    },
    "idl.unitree_go.msg.dds_": {"LidarState_": _type("LidarState_")},
    "idl.sensor_msgs.msg.dds_": {"PointCloud2_": _type("PointCloud2_")},
    "utils.crc": {"CRC": Crc},
}


def install() -> None:
    for path, names in MODULES.items():
        parts = ["unitree_sdk2py", *path.split(".")]
        for depth in range(1, len(parts) + 1):
            name = ".".join(parts[:depth])
            module = sys.modules.setdefault(name, ModuleType(name))
            module.__path__ = []  # makes the module a package
            if depth > 1:
                setattr(sys.modules[".".join(parts[: depth - 1])], parts[depth - 1], module)
        vars(sys.modules[".".join(parts)]).update(names)
