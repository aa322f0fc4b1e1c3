from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar


@dataclass(kw_only=True)
class RobotConfig:
    id: str | None = None
    calibration_dir: Path | None = None

    choices: ClassVar[dict[str, type[RobotConfig]]] = {}

    @classmethod
    def register_subclass(cls, name: str) -> Callable[[type[RobotConfig]], type[RobotConfig]]:
        def keep(choice: type[RobotConfig]) -> type[RobotConfig]:
            assert name not in RobotConfig.choices, name
            RobotConfig.choices[name] = choice
            return choice

        return keep


class Robot(abc.ABC):
    """Like LeRobot's class, it looks for the calibration when it is made, and disconnects when it is
    deleted."""

    config_class: type[RobotConfig]
    name: str

    def __init__(self, config: RobotConfig) -> None:
        self.robot_type = self.name
        self.id = config.id
        self.calibration_dir = config.calibration_dir or Path("no-such-folder") / self.name
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"

    def __del__(self) -> None:
        try:
            if self.is_connected:
                self.disconnect()
        except Exception:
            pass

    @property
    @abc.abstractmethod
    def observation_features(self) -> dict[str, Any]: ...
    @property
    @abc.abstractmethod
    def action_features(self) -> dict[str, Any]: ...
    @property
    @abc.abstractmethod
    def is_connected(self) -> bool: ...
    @property
    @abc.abstractmethod
    def is_calibrated(self) -> bool: ...
    @abc.abstractmethod
    def connect(self, calibrate: bool = True) -> None: ...
    @abc.abstractmethod
    def calibrate(self) -> None: ...
    @abc.abstractmethod
    def configure(self) -> None: ...
    @abc.abstractmethod
    def get_observation(self) -> dict[str, Any]: ...
    @abc.abstractmethod
    def send_action(self, action: dict[str, Any]) -> dict[str, Any]: ...
    @abc.abstractmethod
    def disconnect(self) -> None: ...
