"""ur-rtde in the wire process. It only commands; the state of the controller is received without it
(``plain``).

Unexpected behaviour of ur-rtde, seen with 1.6.5:

* Constructors and destructors keep the interpreter's lock: a constructor for 10 ms, a destructor always for
  500 ms, and for ever if the controller is frozen. So no object is ever destroyed here, and one process
  opens it once.
* A call that lost its connection reconnects by itself and then *sends its old command*. So a call that
  missed its deadline ends the process: only that keeps the command from being sent late.
* ``isConnected`` and return values do not show that a controller is frozen. Only the controller's clock
  does.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, ClassVar

from strands_actors.contract.wire import ProcessSpent
from strands_actors.drivers.common.kit.sdk import SdkCalls, kept, load_sdk

from .config import Way
from .gates import CONTROL_S, LOOKAHEAD_S

OPEN_S = 3.0
CALL_S = 0.1
"""Deadline of calls that only send. They take 0.1 ms."""
STOP_S = 0.5
"""Deadline of servoStop, which waits until the arm stands: 0.3 s from top speed at its deceleration."""

REGISTERS_HZ = 500.0
"""Rate at which the controller sends its registers to the control interface. Before each command, that
interface waits until the script has acknowledged the last one there. At 125 Hz a stop behind a setpoint left
3 to 11 ms late, at 500 Hz 1 to 3."""

GAIN = 300.0
"""Gain of servoJ, 100 to 2000. This is the SDK's own default."""
UNUSED = 0.5
"""servoJ takes a speed and an acceleration, and uses neither."""
STOP_RAD_S2 = 10.0

_ERRORS = (RuntimeError, ValueError, IndexError, TypeError)
"""The SDK's exceptions in Python. TypeError comes from a version with other arguments."""

_NEWEST = (3, 12)
"""Newest Python for which the package index has wheels of ur-rtde 1.6.5. They are for x86-64 only."""


def install_line(machine: str = "", python: tuple[int, int] = sys.version_info[:2]) -> str:
    """Return the command that installs ur-rtde on this machine, or a text that says how to go on without."""
    machine = machine or os.uname().machine
    if python <= _NEWEST and machine == "x86_64":
        return "pip install 'strands-actors[ur]'"
    return (
        f"ur-rtde has no wheel for {machine} with Python {python[0]}.{python[1]}. Leave control= out: the robot "
        "then runs without ur-rtde, by our own control script"
    )


class Sdk(SdkCalls):
    """One connection of ur-rtde. Calls never overlap. See ``control.Control``."""

    WAY: ClassVar[Way] = "ur-rtde"

    def __init__(self, host: str, registers_hz: float | None = None) -> None:
        """Load ur-rtde, without connecting.

        Raises:
            WireDown: It is not installed.
            ProcessSpent: This process has had one.
        """
        if kept():
            raise ProcessSpent("the link was lost, and ur-rtde is opened once in a process")
        super().__init__("ur-rtde", _ERRORS)
        self._interface = load_sdk("rtde_control", install_line()).RTDEControlInterface
        self._host = host
        self._registers_hz = registers_hz or REGISTERS_HZ
        self._control: Any = None

    async def connect(self) -> None:
        """Connect to the registers, once. This starts no program."""
        if self._control is None:
            # Registers 0 to 23 belong to fieldbus and PLC. NO_WAIT: it would otherwise wait with the lock
            # held.
            flags = self._interface.FLAG_UPPER_RANGE_REGISTERS | self._interface.FLAG_NO_WAIT
            self._control = await self.construct(
                "control", OPEN_S, self._interface, self._host, self._registers_hz, flags
            )

    def take(self) -> None:
        """Do nothing: its own threads read."""

    def close(self) -> None:
        """Close nothing: that takes half a second with the lock held, or for ever. The connection ends with
        this process, which cannot open another one."""

    async def upload(self, check: Callable[[], None]) -> bool:
        """Upload the script. ``check`` as in ``servo``."""
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
        """Send a target. ``check`` is called last, in the worker thread; its exceptions are raised here."""
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
