"""The common interface of the two ways to command a UR: ur-rtde, and our own control script."""

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

    Calls raise ``ProcessSpent`` if only another process can command the robot, and ``WireDown`` if the
    connection is lost.
    """

    WAY: ClassVar[Way]
    """The name of this way."""

    spent: str
    """Why this process cannot command the robot any more; empty if it can."""

    async def connect(self) -> None:
        """Connect to the registers, once. This starts no program."""

    def take(self) -> None:
        """Handle the controller's answers. Called with each sample."""

    async def upload(self, check: Callable[[], None]) -> bool:
        """Send the control script. It starts some time later.

        Args:
            check: Called immediately before the script is sent. Its exceptions are raised here.

        Returns:
            True if the controller accepted the script.
        """
        ...

    def script_runs(self) -> bool:
        """Return True if the script that was uploaded last runs."""
        ...

    async def set_watchdog(self, min_hz: float) -> bool:
        """Arm the controller's watchdog. Return True if the script has done it."""
        ...

    async def kick(self) -> None:
        """Feed the watchdog."""

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """Send a target of each joint. Return False if the script does not run.

        Args:
            radians: In the order of ``JOINTS``.
            check: As in ``upload``.
        """
        ...

    async def halt(self, ends: bool) -> bool:
        """End servo motion. The order leaves before the first wait.

        Args:
            ends: True to end the script as well.

        Returns:
            True if the script reports that the arm stands.
        """
        ...

    def close(self) -> None:
        """Close everything that can be closed without waiting."""


def open_control(config: URConfig, clock: Clock) -> Control:
    """Return the way to command this robot, not connected yet.

    Without the option ``control`` it is ur-rtde if that can be imported, else our script.

    Raises:
        WireDown: ``control`` is ur-rtde, which cannot be imported.
        ProcessSpent: This process has had one.
    """
    if config.control != "script":
        try:
            return Sdk(config.host, config.rtde_hz)
        except WireDown:
            if config.control is not None:
                raise
    return ScriptControl(config.host, config.samples_hz, clock)
