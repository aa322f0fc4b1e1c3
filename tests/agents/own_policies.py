"""A user's policy in a module."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.policies import Policy


class Creep(Policy):
    """A policy that moves every joint a little further with each chunk."""

    def __init__(self, step: float = 0.1) -> None:
        self.step = step

    @property
    def provider_name(self) -> str:
        return "creep"

    async def get_actions(
        self, observation_dict: Mapping[str, Any], instruction: str, **more: Any
    ) -> list[dict[str, Any]]:
        key = self.robot_state_keys[0]
        return [{key: observation_dict[key] + self.step * count} for count in range(1, 5)]
