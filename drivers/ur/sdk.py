"""ur-rtde in the wire process: each call that can wait in a worker thread with a deadline.

What it does that nobody would expect, seen with 1.6.5:

* Constructors and destructors keep the interpreter's lock: 10 ms for one, always 500 ms for the other, for ever
  against a controller that is frozen. So nothing is ever destroyed here, and one process opens it once.
* A call that lost its connection reconnects by itself and then *sends its old command*. So a call that missed
  its deadline is the end of the process: nothing less keeps it from happening late.
* ``isConnected`` and return values say nothing of a frozen controller, getters return the last sample for ever:
  liveness is the controller's clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple

import msgspec
import trio

from strands_actors.runtime.contract import WireDown

from .gates import CONTROL_HZ, CONTROL_S, LOOKAHEAD_S

Args = TypeVarTuple("Args")
Result = TypeVar("Result")

OPEN_S = 3.0
CALL_S = 0.1
"""For calls that only send. They take 0.1 ms."""
STOP_S = 0.5
"""For servoStop, which waits until the arm stands: 0.3 s from top speed at its deceleration."""

GAIN = 300.0
"""Of servoJ, 100 to 2000: the SDK's own default."""
UNUSED = 0.5
"""servoJ takes a speed and an acceleration and uses neither."""
STOP_RAD_S2 = 10.0

VARIABLES = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_TCP_pose",
    "joint_temperatures",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "speed_scaling",
]

_kept: list[Any] = []
"""Every interface this process has opened: see above."""


class SdkSpent(Exception):
    """Only a new process can go on: this one's SDK hangs, or has lost its connection."""


class Sample(msgspec.Struct, frozen=True):
    """What the receive interface heard last."""

    time_s: float  # the controller's clock
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    pose: tuple[float, ...]
    temperature: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_scaling: float


class Sdk:
    """One connection. Calls never overlap."""

    def __init__(self, host: str) -> None:
        if _kept:
            raise SdkSpent("ur-rtde cannot be opened twice in one process")
        self._host = host
        self._receive: Any = None
        self._control: Any = None
        self.hangs = ""  # the call that does, once one does

    async def open_receive(self) -> None:
        """Raise ``WireDown``."""
        from rtde_receive import RTDEReceiveInterface

        self._receive = await self._open("receive", RTDEReceiveInterface, self._host, CONTROL_HZ, VARIABLES)

    async def open_control(self) -> None:
        """Connect to the registers; no program is started. Raise ``WireDown``."""
        from rtde_control import RTDEControlInterface as Control

        if self._control is None:
            # registers 0 to 23 belong to fieldbus and PLC; NO_WAIT: it would wait with the lock held
            flags = Control.FLAG_UPPER_RANGE_REGISTERS | Control.FLAG_NO_WAIT
            self._control = await self._open("control", Control, self._host, CONTROL_HZ, flags)

    async def _open(self, what: str, interface: Any, *args: Any) -> Any:
        try:
            opened = await self._call(what, OPEN_S, interface, *args)
        except (RuntimeError, ValueError, OSError) as error:
            raise WireDown(f"ur-rtde: no {what} interface ({error}). Check the controller") from None
        _kept.append(opened)
        return opened

    @property
    def has_control(self) -> bool:
        return self._control is not None

    def sample(self) -> Sample:
        """Never waits."""
        receive = self._receive
        return Sample(
            receive.getTimestamp(),
            tuple(receive.getActualQ()),
            tuple(receive.getActualQd()),
            tuple(receive.getActualCurrent()),
            tuple(receive.getActualTCPPose()),
            tuple(receive.getJointTemperatures()),
            receive.getRobotMode(),
            receive.getSafetyMode(),
            receive.getRuntimeState(),
            receive.getSpeedScaling(),
        )

    async def upload(self) -> bool:
        """Send the control script; it starts some time later."""
        return await self._call("reuploadScript", OPEN_S, self._control.reuploadScript)

    def script_runs(self) -> bool:
        return bool(self._control.isProgramRunning())

    async def set_watchdog(self, min_hz: float) -> bool:
        return await self._call("setWatchdog", STOP_S, self._control.setWatchdog, min_hz)

    async def kick(self) -> bool:
        return await self._call("kickWatchdog", CALL_S, self._control.kickWatchdog)

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """``check`` is called last, in the worker; what it raises is raised here."""
        servo_j, target = self._control.servoJ, list(radians)

        def send() -> bool:
            check()
            return bool(servo_j(target, UNUSED, UNUSED, CONTROL_S, LOOKAHEAD_S, GAIN))

        return await self._call("servoJ", CALL_S, send)

    async def servo_stop(self) -> bool:
        return await self._call("servoStop", STOP_S, self._control.servoStop, STOP_RAD_S2)

    async def stop_script(self) -> None:
        await self._call("stopScript", STOP_S, self._control.stopScript)

    async def _call(
        self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args
    ) -> Result:
        """Raise ``SdkSpent`` when it does not return in time: it may still do what it was told."""
        if self.hangs:
            raise SdkSpent(self.hangs)
        try:
            with trio.fail_after(deadline_s):
                return await trio.to_thread.run_sync(function, *args, abandon_on_cancel=True)
        except trio.TooSlowError:
            self.hangs = f"ur-rtde: {name} did not return within {deadline_s * 1e3:g} ms"
            raise SdkSpent(self.hangs) from None
        except trio.Cancelled:
            self.hangs = f"ur-rtde: {name} was given up"  # by whoever waited for it: it goes on all the same
            raise
