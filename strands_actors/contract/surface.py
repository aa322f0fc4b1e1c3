"""The members that the reference's drivers page requires of a driver class."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from .driver import Driver


@runtime_checkable
class HardwareDriver(Protocol):
    """The members of a driver, without inheritance. A robot that ``Robot`` returns has them, too."""

    @property
    def tool_name(self) -> str: ...
    @property
    def tool_type(self) -> str: ...
    @property
    def tool_spec(self) -> Any: ...
    def stream(self, tool_use: Any, invocation_state: Any) -> Any: ...
    def send_action(self, action: Any, robot_name: str | None = None) -> Any: ...
    def run_policy(
        self, policy: Any, instruction: str = "", duration: float = 30.0, n_steps: int | None = None
    ) -> Any: ...
    def get_task_status(self) -> Any: ...
    def stop_task(self) -> Any: ...
    def get_status(self) -> Any: ...
    def stop(self) -> Any: ...
    def cleanup(self) -> Any: ...


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
    """Return the required members that ``cls`` lacks, sorted; empty for a ``Driver``."""
    if isinstance(cls, type) and issubclass(cls, Driver):
        return []
    return [member for member in sorted(PARAMETERS) if not hasattr(cls, member)]


def drifted_driver_parameters(cls: type[Any]) -> dict[str, list[str]]:
    """Return the parameters that each member of ``cls`` lacks; empty if there are none."""
    if isinstance(cls, type) and issubclass(cls, Driver):
        return {}
    drifted = {}
    for member, wanted in {**PARAMETERS, **DEPRECATED}.items():
        function = getattr(cls, member, None)
        if wanted and callable(function):
            taken = inspect.signature(function).parameters
            if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in taken.values()):
                continue
            lacking = [name for name in wanted if name not in taken and OTHER_SPELLINGS.get(name) not in taken]
            if lacking:
                drifted[member] = lacking
    return drifted


def driver_name(cls: type[Any]) -> str:
    """Return the name of a driver class as the page prints it: ``FeetechDriver``."""
    name = cls.__name__
    ours = cls.__module__.startswith("strands_actors.drivers.") and not name.endswith("Driver")
    return f"{name}Driver" if ours else name
