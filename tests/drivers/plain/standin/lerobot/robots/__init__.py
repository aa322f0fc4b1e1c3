from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(kw_only=True)
class RobotConfig:
    id: str | None = None
    calibration_dir: str | None = None

    choices: ClassVar[dict[str, Any]] = {}
    makers: ClassVar[dict[str, Any]] = {}

    @classmethod
    def register_subclass(cls, name: str) -> Callable[[Any], Any]:
        def keep(choice: Any) -> Any:
            RobotConfig.choices[name] = choice
            return choice

        return keep

    @classmethod
    def get_choice_class(cls, name: str) -> Any:
        return RobotConfig.choices[name]


class Robot:
    """Base of LeRobot's robots, with the members that a loop calls."""


def make_robot_from_config(config: RobotConfig) -> Any:
    return RobotConfig.makers[type(config)](config)
