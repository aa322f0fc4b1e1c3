"""The base class ``Policy``, with the members that strands-robots' page on drivers requires.

The base class is optional. Any object with ``get_actions``, ``get_actions_sync`` or ``step`` is a policy, and so is
a callable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

Action = dict[str, Any]


class Policy(ABC):
    """Base class of a policy. A subclass must define ``get_actions`` and ``provider_name``.

    Before each run of the policy, its methods ``set_robot_state_keys``, ``set_control_frequency`` and ``reset`` are
    called. Then ``get_actions_sync`` is called for each chunk of actions.

    Example:
        class Hold(Policy):
            @property
            def provider_name(self):
                return "hold"

            async def get_actions(self, observation_dict, instruction, **more):
                return [{key: observation_dict[key] for key in self.robot_state_keys}]

        arm.run_policy(Hold(), duration=5.0)
    """

    supports_rtc = False
    """True if each chunk is blended into the previous one (real-time chunking). Then only
    ``execution_horizon`` actions of a chunk are executed."""

    reads_instruction: bool = True
    robot_state_keys: Sequence[str] = ()

    @property
    @abstractmethod
    def provider_name(self) -> str:
        """The name of the policy."""

    @property
    def requires_images(self) -> bool:
        """True if the policy needs pictures in addition to positions.

        Only the policy ``lerobot_local`` gets pictures.
        """
        return True

    @property
    def execution_horizon(self) -> int:
        """The number of executed actions of each chunk, if new chunks are blended into the previous ones."""
        return 1

    @abstractmethod
    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next chunk of actions.

        Args:
            observation_dict: Measured position by joint, in the driver's units.
            instruction: The text that the run was started with.
            more: Reserved.

        Returns:
            Actions in their order, one per control period. An action has a target by joint, in the
            driver's units, as ``send_action`` takes it.
        """

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next chunk of actions, for a thread without an event loop.

        The arguments are those of ``get_actions``.
        """
        # Imported here, since the import takes 8 ms and most policies do not need it.
        import asyncio

        return asyncio.run(self.get_actions(observation_dict, instruction, **more))

    def set_robot_state_keys(self, robot_state_keys: Sequence[str]) -> None:
        """Set the joints that the policy controls. This method is called before each run.

        Args:
            robot_state_keys: Names of the joints, in the robot's order.
        """
        self.robot_state_keys = list(robot_state_keys)

    def set_control_frequency(self, hz: float) -> None:  # noqa: B027  # most have no use for it
        """Set the rate at which the actions are executed. This method is called before each run.

        Args:
            hz: Actions per second.
        """

    def reset(self, seed: int | None = None) -> None:  # noqa: B027  # most remember nothing
        """Forget everything from an earlier run. This method is called before each run.

        Args:
            seed: Seed of random numbers; None for no seed.
        """

    @classmethod
    def preflight(cls, observation_keys: set[str], **config: Any) -> None:
        """Check that the policy can control a robot that gives the observations ``observation_keys``.

        Raises:
            ValueError: The policy cannot control this robot.
        """
        return
