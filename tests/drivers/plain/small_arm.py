"""A driver class as the drivers page describes one: plain members, a serial port, nothing of this package.

Its robot is ``SmallArm`` of ``rig``. Before each call it reads a file that names a fault to simulate.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import serial


class SmallArmDriver:
    PORT_KIND = "serial"
    tool_name = ""
    tool_type = "robot"
    tool_spec: dict[str, Any] = {}  # noqa: RUF012

    ANSWER_S = 0.2

    def __init__(
        self,
        tool_name: str,
        port: str = "",
        cameras: Any = None,
        data_config: Any = None,
        wrong: str = "",
        **more: Any,
    ) -> None:
        self.tool_name, self.data_config, self.more = tool_name, data_config, more
        self._port, self._wrong = port, Path(wrong) if wrong else None
        self._serial: serial.Serial | None = None

    @property
    def is_connected(self) -> bool:
        return self._serial is not None

    def connect_eagerly(self) -> str | None:
        self._misbehave("connect")
        if self._serial is None:
            try:
                self._serial = serial.Serial(self._port, timeout=self.ANSWER_S, exclusive=True)
            except OSError as error:
                return f"{self._port} cannot be opened ({error})"
        return None

    def get_observation(self) -> dict[str, Any]:
        self._misbehave("read")
        words = self._ask("read").split()
        return {
            "pan.pos": float(words[0]),
            "lift.pos": float(words[1]),
            "pan.vel": 0.0,
            "on": True,
            "name": self.tool_name,
        }

    def send_action(self, action: dict[str, Any], robot_name: str | None = None) -> dict[str, Any]:
        self._misbehave("send")
        if action.get("lift.pos", 0.0) > 80.0:
            return {"status": "error", "content": [{"text": "lift does not go that far"}]}
        self._ask("goal " + " ".join(f"{key}={value}" for key, value in sorted(action.items())))
        return {"status": "success", "content": [{"json": {"sent": action}}]}

    async def stop(self) -> dict[str, Any]:
        if self._wrong_now() == "stop is not done":
            return {"status": "error", "content": [{"json": {"stopped": False, "reason": "a thread hangs"}}]}
        self._misbehave("stop")
        self._ask("stop")
        return {"status": "success", "content": [{"json": {"stopped": True}}]}

    async def get_status(self) -> dict[str, Any]:
        return {}

    def cleanup(self) -> None:
        if self._serial is not None:
            self._ask("bye")
            self._serial.close()
            self._serial = None

    def get_task_status(self) -> dict[str, Any]:
        return {}

    def run_policy(
        self, policy: Any, instruction: str = "", duration: float = 30.0, n_steps: int | None = None
    ) -> Any:
        return {}

    def stop_task(self) -> dict[str, Any]:
        return {}

    async def stream(self, tool_use: Any, invocation_state: Any, **more: Any) -> Any:
        yield {}

    def _ask(self, line: str) -> str:
        assert self._serial is not None, "not connected"
        self._serial.write(line.encode() + b"\n")
        answer = self._serial.readline().decode()
        if not answer:
            raise TimeoutError("the arm does not answer")
        return answer

    def _wrong_now(self) -> str:
        return self._wrong.read_text() if self._wrong is not None and self._wrong.exists() else ""

    def _misbehave(self, call: str) -> None:
        what = self._wrong_now()
        if what == f"{call} hangs":
            time.sleep(60.0)
        elif what == f"{call} raises":
            raise RuntimeError("the bus is upset")
        elif what == f"{call} dies":
            os.kill(os.getpid(), signal.SIGKILL)


class PatientArmDriver(SmallArmDriver):
    """Waits for an answer as long as a test needs to give one."""

    ANSWER_S = 30.0


class SensingArmDriver(SmallArmDriver):
    """Has sensors as members, as the drivers page names them. One of them fails."""

    def get_observation(self) -> dict[str, Any]:
        observation = super().get_observation()
        self._imu = {"rpy": (0.1, 0.2, 0.3), "accel": [0.0, 0.0, 9.8], "label": "left", "when": None}
        self._battery = 73
        return observation

    @property
    def _pose(self) -> dict[str, Any]:
        raise OSError("the camera is gone")

    @property
    def _odom(self) -> dict[str, float]:
        return {"x": 1.0, "y": 2.0, "theta": 0.5}


class DeclaredArmDriver(SmallArmDriver):
    """Declares its axes and their limits."""

    action_features = {"pan.pos": float, "lift.pos": float, "top": (480, 640, 3)}  # noqa: RUF012
    action_limits = {"pan": (-90.0, 90.0)}  # noqa: RUF012
    action_speeds = {"pan.pos": 60.0}  # noqa: RUF012
    action_units = "degrees"

    @staticmethod
    def stop_channel(port: str) -> None:
        with serial.Serial(port, timeout=0.2) as line:
            line.write(b"halt\n")
            line.readline()


class SilentArmDriver(SmallArmDriver):
    """Declares nothing about its axes."""

    def get_observation(self) -> dict[str, Any]:
        return {"on": True}
