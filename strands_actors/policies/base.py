"""What a policy of one's own is made from, as the drivers page has it. Nobody has to: any object
with ``get_actions``, ``get_actions_sync`` or ``step`` is a policy, and so is a callable."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

Action = dict[str, Any]


class Policy(ABC):
    """``get_actions`` and ``provider_name`` are to be written; the rest has an answer."""

    supports_rtc = False
    """Whether each chunk is blended into the last one: then no more of it than
    ``execution_horizon`` is executed."""

    reads_instruction: bool = True
    robot_state_keys: Sequence[str] = ()

    @property
    @abstractmethod
    def provider_name(self) -> str:
        """Return the name it goes by."""

    @property
    def requires_images(self) -> bool:
        """Return whether it wants pictures beside positions. Only ``lerobot_local`` is given
        any."""
        return True

    @property
    def execution_horizon(self) -> int:
        """Return how many actions of a chunk are executed, where chunks are blended."""
        return 1

    @abstractmethod
    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return a chunk: actions by joint, one a control period."""

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """As ``get_actions``, from a thread without a loop."""
        import asyncio  # 8 ms, for policies that want it

        return asyncio.run(self.get_actions(observation_dict, instruction, **more))

    def set_robot_state_keys(self, robot_state_keys: Sequence[str]) -> None:
        """Be told the joints it drives, before each rollout."""
        self.robot_state_keys = list(robot_state_keys)

    def set_control_frequency(self, hz: float) -> None:  # noqa: B027  # most have no use for it
        """Be told the rate at which its actions are executed, before each rollout."""

    def reset(self, seed: int | None = None) -> None:  # noqa: B027  # most remember nothing
        """Begin anew, before each rollout."""

    @classmethod
    def preflight(cls, observation_keys: set[str], **config: Any) -> None:
        """Raise ``ValueError`` when it could not drive a robot with these observations."""
        return
