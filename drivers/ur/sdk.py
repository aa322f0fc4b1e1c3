"""Command a UR by ur-rtde, in the wire process. The controller's state is received without ur-rtde (``plain``).

Unexpected behaviour of ur-rtde, seen with version 1.6.5:

* Constructors and destructors hold the interpreter's lock: a constructor for 10 ms, a destructor for 500 ms. If the
  controller is frozen, they hold it for ever. So objects of ur-rtde are never destroyed here, and a process opens
  ur-rtde only once.
* If a call loses its connection, ur-rtde reconnects by itself and then *sends the old command*. So if a call misses
  its deadline, the whole process is ended. There is no other way to prevent the late command.
* ``isConnected`` and return values do not show that a controller is frozen. Only the controller's clock does.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, ClassVar

from strands_actors.contract.wire import ProcessSpent
from strands_actors.drivers.common.kit.sdk import SdkCalls, kept, load_sdk

from .config import ControlMethod
from .gates import CONTROL_S, LOOKAHEAD_S

OPEN_S = 3.0
CALL_S = 0.1
"""Deadline of calls that only send. They usually take 0.1 ms."""
STOP_S = 0.5
"""Deadline of servoStop, which waits until the arm stands still. From top speed this takes 0.3 s."""

REGISTERS_HZ = 500.0
"""Rate at which the controller sends its registers to ur-rtde. Before ur-rtde sends a command, it waits until the
registers show that the script has received the last command. At 125 Hz a stop right after a setpoint was sent 3 to
11 ms late, at 500 Hz 1 to 3 ms late."""

GAIN = 300.0
"""Gain of servoJ, 100 to 2000. This is the SDK's own default."""
UNUSED = 0.5
"""Value for the speed and the acceleration of servoJ, which ignores both."""
STOP_RAD_S2 = 10.0

_ERRORS = (RuntimeError, ValueError, IndexError, TypeError)
"""The SDK's exceptions in Python. TypeError comes from a version with other arguments."""

_NEWEST = (3, 12)
"""Newest Python for which the package index has wheels of ur-rtde 1.6.5. They are for x86-64 only."""


def install_line(machine: str = "", python: tuple[int, int] = sys.version_info[:2]) -> str:
    """Return the command that installs ur-rtde on this computer.

    If there is no package for it, return a text that explains how to use the robot without ur-rtde.
    """
    machine = machine or os.uname().machine
    if python <= _NEWEST and machine == "x86_64":
        return "pip install 'strands-actors[ur]'"
    return (
        f"ur-rtde has no wheel for {machine} with Python {python[0]}.{python[1]}. Leave control= out: the robot "
        "then runs without ur-rtde, by our own control script"
    )


class Sdk(SdkCalls):
    """Command one controller by ur-rtde. The methods are described in ``control.Control``."""

    METHOD: ClassVar[ControlMethod] = "ur-rtde"

    def __init__(self, host: str, registers_hz: float | None = None) -> None:
        """Load ur-rtde, without connecting.

        Raises:
            WireDown: ur-rtde is not installed.
            ProcessSpent: This process has already opened ur-rtde once.
        """
        if kept():
            raise ProcessSpent("the connection was lost, and ur-rtde can be opened only once in a process")
        super().__init__("ur-rtde", _ERRORS)
        self._interface = load_sdk("rtde_control", install_line()).RTDEControlInterface
        self._host = host
        self._registers_hz = registers_hz or REGISTERS_HZ
        self._control: Any = None

    async def connect(self) -> None:
        """Connect to the controller's registers, unless already connected. This starts no program."""
        if self._control is None:
            # UPPER_RANGE: the lower registers (0 to 23) are reserved for a fieldbus or a PLC. NO_WAIT: otherwise
            # the constructor waits for the script while it holds the interpreter's lock.
            flags = self._interface.FLAG_UPPER_RANGE_REGISTERS | self._interface.FLAG_NO_WAIT
            self._control = await self.construct(
                "control", OPEN_S, self._interface, self._host, self._registers_hz, flags
            )

    def take(self) -> None:
        """Do nothing, because threads of ur-rtde receive the answers."""

    def close(self) -> None:
        """Do nothing: to close ur-rtde would block this process for half a second, or for ever.

        The connection ends with this process.
        """

    async def upload(self, check: Callable[[], None]) -> bool:
        """Upload the control script of ur-rtde. ``check`` is called in a worker thread, right before the upload."""
        reupload = self._control.reuploadScript

        def send() -> bool:
            check()
            return bool(reupload())

        return await self.call("reuploadScript", OPEN_S, send)

    def script_runs(self) -> bool:
        return bool(self._control.isProgramRunning())

    async def set_watchdog(self, min_hz: float) -> bool:
        return bool(await self.call("setWatchdog", STOP_S, self._control.setWatchdog, min_hz))

    async def kick(self) -> None:
        await self.call("kickWatchdog", CALL_S, self._control.kickWatchdog)

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """Send a target. ``check`` is called in a worker thread, right before sending. If it raises, nothing is
        sent."""
        servo_j, target = self._control.servoJ, list(radians)

        def send() -> bool:
            check()
            return bool(servo_j(target, UNUSED, UNUSED, CONTROL_S, LOOKAHEAD_S, GAIN))

        return await self.call("servoJ", CALL_S, send)

    async def halt(self, ends: bool) -> bool:
        stopped = bool(await self.call("servoStop", STOP_S, self._control.servoStop, STOP_RAD_S2))
        if ends:
            await self.call("stopScript", STOP_S, self._control.stopScript)
        return stopped
