"""The common interface of the two ways to command a UR: the package ur-rtde, and our own control script."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.clock import Clock

from .config import ControlMethod, URConfig
from .script_control import ScriptControl
from .sdk import Sdk


class Control(Protocol):
    """Send commands to one controller. Only one call runs at a time.

    Calls raise ``WireDown`` if the connection is lost. They raise ``ProcessSpent`` if this process cannot command
    the robot any more, so that a new process is needed.
    """

    METHOD: ClassVar[ControlMethod]
    """The name of this way to command the robot."""

    spent: str
    """The reason why this process cannot command the robot any more. Empty if it can."""

    async def connect(self) -> None:
        """Connect to the controller's registers, unless already connected. This starts no program."""

    def take(self) -> None:
        """Process the controller's answers that have arrived. It is called whenever a sample arrives."""

    async def upload(self, check: Callable[[], None]) -> bool:
        """Send the control script. It starts some time later.

        Args:
            check: Called immediately before the script is sent. If it raises, nothing is sent.

        Returns:
            True if the controller accepted the script.
        """
        ...

    def script_runs(self) -> bool:
        """Return True if the control script from the last upload is running on the controller."""
        ...

    async def set_watchdog(self, min_hz: float) -> bool:
        """Arm the controller's watchdog, which ends the script if it is fed at a lower rate than ``min_hz``.
        Return True if it is armed."""
        ...

    async def kick(self) -> None:
        """Feed the controller's watchdog."""

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """Send the target position of each joint. Return False if the control script is not running.

        Args:
            radians: Target positions in rad, in the order of ``JOINTS``.
            check: Called immediately before the target is sent. If it raises, nothing is sent.
        """
        ...

    async def halt(self, ends: bool) -> bool:
        """Stop the arm's servo motion. The order is sent without waiting.

        Args:
            ends: True to end the control script as well.

        Returns:
            True if the script reports that the arm stands still.
        """
        ...

    def close(self) -> None:
        """Close the connections, as far as this is possible without waiting."""


def open_control(config: URConfig, clock: Clock) -> Control:
    """Return an object that can command this robot. It is not connected yet.

    Without the option ``control`` it uses ur-rtde if this can be imported, and otherwise our own script.

    Raises:
        WireDown: ``control`` is ``ur-rtde``, but ur-rtde cannot be imported.
        ProcessSpent: This process has already opened ur-rtde once.
    """
    if config.control != "script":
        try:
            return Sdk(config.host, config.rtde_hz)
        except WireDown:
            if config.control is not None:
                raise
    return ScriptControl(config.host, config.samples_hz, clock)
