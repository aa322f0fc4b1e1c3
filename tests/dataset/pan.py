"""A user's class of a robot. Its gripper takes commands and has no reading. It imports little, because a tree
imports it, too."""

from __future__ import annotations

from typing import Any, ClassVar


class Pan:
    tool_name, tool_type = "", "robot"
    tool_spec: ClassVar[dict[str, Any]] = {}
    action_features: ClassVar[dict[str, type]] = {"pan": float, "gripper": float}
    control_hz = 30

    def __init__(self, tool_name: str, port: str | None = None) -> None:
        self.at = {"pan": 0.0}

    def get_observation(self) -> dict[str, float]:
        return dict(self.at)

    def send_action(self, action: dict[str, float], robot_name: str | None = None) -> None:
        self.at |= {key: value for key, value in action.items() if key == "pan"}

    def stop(self) -> None: ...

    def cleanup(self) -> None: ...

    def not_called(self, *_: Any, **__: Any) -> Any:
        raise NotImplementedError

    run_policy = stop_task = get_task_status = get_status = stream = not_called
