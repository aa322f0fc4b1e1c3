"""The two ways to command a UR: ur-rtde, and a control script of ours. The wire knows them by one
interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.clock import Clock

from .config import URConfig, Way
from .script_control import ScriptControl
from .sdk import Sdk


class Control(Protocol):
    """Commands one controller. Calls never overlap.

    Calls raise ``ProcessSpent`` when only another process can command the robot, ``WireDown`` when the
    connection is gone.
    """

    WAY: ClassVar[Way]
    """Which of the two it is."""

    spent: str
    """Why this process can command the robot no more. Empty: it can."""

    async def connect(self) -> None:
        """Connect to the registers, the first time. Starts no program."""

    def take(self) -> None:
        """Take what the controller has answered. Called with each sample."""

    async def upload(self, check: Callable[[], None]) -> bool:
        """Send the control script. It starts some time later.

        Args:
            check: Called last before the script is sent. What it raises is raised here.

        Returns:
            Whether the controller took it.
        """
        ...

    def script_runs(self) -> bool:
        """Return whether the script that was uploaded last runs."""
        ...

    async def set_watchdog(self, min_hz: float) -> bool:
        """Arm the controller's watchdog. Return whether the script has done it."""
        ...

    async def kick(self) -> None:
        """Feed the watchdog."""

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """Send a target of each joint. Return False when the script does not run.

        Args:
            radians: In the order of ``JOINTS``.
            check: As in ``upload``.
        """
        ...

    async def halt(self, ends: bool) -> bool:
        """End servo motion. The order leaves before the first wait.

        Args:
            ends: Whether the script ends, too.

        Returns:
            Whether the script says that the arm stands.
        """
        ...

    def close(self) -> None:
        """Close what can be closed without waiting."""


def open_control(config: URConfig, clock: Clock) -> Control:
    """Return the way to command this robot, connected to nothing.

    Without the option ``control`` it is ur-rtde where that can be imported, else our script. Raise
    ``WireDown`` where ur-rtde is asked for and cannot be imported, ``ProcessSpent`` when this process
    has had one.
    """
    if config.control != "script":
        try:
            return Sdk(config.host, config.rtde_hz)
        except WireDown:
            if config.control is not None:
                raise
    return ScriptControl(config.host, config.samples_hz, clock)
