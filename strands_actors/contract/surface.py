"""List the members that strands-robots' page on drivers requires of a driver class."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from .driver import Driver


@runtime_checkable
class HardwareDriver(Protocol):
    """The members that a driver class must have. It need not inherit from a class of this package.

    A robot that ``Robot`` returns has these members, too.

    For such a class this package calls only ``send_action``, ``stop`` and ``cleanup``. The other methods are
    implemented by this package.
    """

    @property
    def tool_name(self) -> str:
        """The name of the robot as a tool for agents."""
        ...

    @property
    def tool_type(self) -> str:
        """The type of the tool for strands-agents. It is ``robot`` for the robots of this package."""
        ...

    @property
    def tool_spec(self) -> Any:
        """The specification of the tool: its name, description and input schema."""
        ...

    def stream(self, tool_use: Any, invocation_state: Any) -> Any:
        """Run the verb that an agent requests, and yield the result of the tool.

        Args:
            tool_use: The request of the agent, with the input of the tool.
            invocation_state: The state of the agent's invocation.
        """
        ...

    def send_action(self, action: Any, robot_name: str | None = None) -> Any:
        """Send one setpoint to the robot.

        Args:
            action: Target by joint, in the driver's units.
            robot_name: The robot that the command is meant for; None for this one.
        """
        ...

    def run_policy(
        self, policy: Any, instruction: str = "", duration: float = 30.0, n_steps: int | None = None
    ) -> Any:
        """Run a policy object on the robot.

        Args:
            policy: The policy.
            instruction: The text for the policy.
            duration: Longest time of the run, in seconds.
            n_steps: Number of actions after which the run ends; None for no such end.
        """
        ...

    def get_task_status(self) -> Any:
        """Return the status of the policy that runs, or of the last one."""
        ...

    def stop_task(self) -> Any:
        """End the policy that runs."""
        ...

    def get_status(self) -> Any:
        """Return the status of the robot."""
        ...

    def stop(self) -> Any:
        """Stop the robot at once."""
        ...

    def cleanup(self) -> Any:
        """Make the robot safe, and release everything that the driver uses."""
        ...


PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "cleanup": (),
    "get_status": (),
    "get_task_status": (),
    "run_policy": ("policy", "instruction", "duration", "n_steps"),
    "send_action": ("action", "robot_name"),
    "stop": (),
    "stop_task": (),
    "stream": ("tool_use", "invocation_state"),
    "tool_name": (),
    "tool_spec": (),
    "tool_type": (),
}
"""The parameters of each member."""

DRIVER_SURFACE: tuple[str, ...] = tuple(PARAMETERS)
"""The required members. ``start_task`` of older drivers is not required."""

DEPRECATED: Mapping[str, tuple[str, ...]] = {
    "start_task": ("instruction", "policy_port", "policy_host", "policy_provider", "duration"),
}

OTHER_SPELLINGS = {"policy": "policy_object"}
"""Parameters with another accepted name."""


def missing_driver_members(cls: type[Any]) -> list[str]:
    """Return the required members that the class ``cls`` lacks, sorted. The result is empty for a ``Driver``."""
    if isinstance(cls, type) and issubclass(cls, Driver):
        return []
    return [member for member in sorted(PARAMETERS) if not hasattr(cls, member)]


def drifted_driver_parameters(cls: type[Any]) -> dict[str, list[str]]:
    """Return the required parameters that the methods of ``cls`` lack, by method; empty if all are there."""
    if isinstance(cls, type) and issubclass(cls, Driver):
        return {}
    drifted = {}
    for member, required in {**PARAMETERS, **DEPRECATED}.items():
        function = getattr(cls, member, None)
        if required and callable(function):
            parameters = inspect.signature(function).parameters
            if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
                continue
            lacking = [
                name for name in required if name not in parameters and OTHER_SPELLINGS.get(name) not in parameters
            ]
            if lacking:
                drifted[member] = lacking
    return drifted


def driver_name(cls: type[Any]) -> str:
    """Return the name of a driver class as strands-robots' page on drivers prints it: ``FeetechDriver``."""
    name = cls.__name__
    ours = cls.__module__.startswith("strands_actors.drivers.") and not name.endswith("Driver")
    return f"{name}Driver" if ours else name
