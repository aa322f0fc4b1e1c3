"""ur-rtde in the wire process.

What it does that nobody would expect, seen with 1.6.5:

* Constructors and destructors keep the interpreter's lock: 10 ms for one, always 500 ms for the
  other, for ever against a controller that is frozen. So nothing is ever destroyed here, and one
  process opens it once.
* A call that lost its connection reconnects by itself and then *sends its old command*. So a call
  that missed its deadline is the end of the process: nothing less keeps it from happening late.
* ``isConnected`` and return values say nothing of a frozen controller, getters return the last
  sample for ever: liveness is the controller's clock.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import trio

from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.drivers.common.sdk import SdkCalls, kept, load_sdk

from .gates import CONTROL_HZ, CONTROL_S, LOOKAHEAD_S

OPEN_S = 3.0
FIRST_S = 0.5
CALL_S = 0.1
"""For calls that only send. They take 0.1 ms."""
STOP_S = 0.5
"""For servoStop, which waits until the arm stands: 0.3 s from top speed at its deceleration."""

REGISTERS_HZ = 500.0
"""How often the controller tells the control interface its registers. Before each command that one
waits until the script has said there that it took the last: at 125 Hz a stop behind a setpoint left
3 to 11 ms late, at 500 Hz 1 to 3."""

GAIN = 300.0
"""Of servoJ, 100 to 2000: the SDK's own default."""
UNUSED = 0.5
"""servoJ takes a speed and an acceleration and uses neither."""
STOP_RAD_S2 = 10.0

_GETTERS = {
    "timestamp": "getTimestamp",
    "actual_q": "getActualQ",
    "actual_qd": "getActualQd",
    "actual_current": "getActualCurrent",
    "actual_TCP_pose": "getActualTCPPose",
    "actual_TCP_speed": "getActualTCPSpeed",
    "actual_TCP_force": "getActualTCPForce",
    "joint_temperatures": "getJointTemperatures",
    "robot_mode": "getRobotMode",
    "safety_mode": "getSafetyMode",
    "runtime_state": "getRuntimeState",
    "speed_scaling": "getSpeedScaling",
    "target_speed_fraction": "getTargetSpeedFraction",
}
"""What is asked of the controller, and how it is read, in the order of ``Sample``."""

_ERRORS = (RuntimeError, ValueError, IndexError, TypeError)
"""What exceptions of the SDK become in Python; TypeError: one of another version takes no such
arguments."""

_NEWEST = (3, 12)
"""Of Python, and x86-64 of the processors: the wheels of ur-rtde 1.6.5 on the package index."""


def install_line(machine: str = "", python: tuple[int, int] = sys.version_info[:2]) -> str:
    """Return what installs ur-rtde on this machine, or where it can be had."""
    machine = machine or os.uname().machine
    if python <= _NEWEST and machine == "x86_64":
        return "pip install 'strands-actors[ur]'"
    return (
        f"ur-rtde has no wheel for {machine} with Python {python[0]}.{python[1]}. pip install ur-rtde compiles it "
        "(needs CMake and Boost); or run the robot on x86-64 with Python 3.11 or 3.12"
    )


class Sample(NamedTuple):
    """What the receive interface heard last."""

    time_s: float  # the controller's clock
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    pose: tuple[float, ...]
    tcp_speed: tuple[float, ...]
    wrench: tuple[float, ...]  # N and Nm at the tool's centre, in the base's axes
    temperature: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_scaling: float  # by the controller itself: it knows nothing of the slider
    speed_slider: float  # 0 to 1


class Sdk(SdkCalls):
    """One connection. Calls never overlap."""

    def __init__(self, host: str, rtde_hz: float | None = None) -> None:
        """``rtde_hz``: see ``URConfig``. Raise ``ProcessSpent`` when this process has had one."""
        if kept():
            raise ProcessSpent("the link was lost, and ur-rtde is opened once in a process")
        super().__init__("ur-rtde", _ERRORS)
        self._host = host
        self._sample_hz = rtde_hz or CONTROL_HZ
        self._register_hz = rtde_hz or REGISTERS_HZ
        self._receive: Any = None
        self._control: Any = None

    async def open_receive(self) -> None:
        """Raise ``WireDown`` where it is not installed, and when no sample comes."""
        interface = load_sdk("rtde_receive", install_line()).RTDEReceiveInterface
        self._receive = await self.construct(
            "receive", OPEN_S, interface, self._host, self._sample_hz, list(_GETTERS)
        )
        with trio.move_on_after(FIRST_S):
            while not self.sample().time_s:  # noqa: ASYNC110  # until then everything is zero
                await trio.sleep(CONTROL_S)
            return
        raise WireDown(f"ur-rtde: no sample within {FIRST_S:g} s. Check the controller")

    async def open_control(self) -> None:
        """Connect to the registers; no program is started."""
        if self._control is None:
            interface = load_sdk("rtde_control", install_line()).RTDEControlInterface
            # registers 0 to 23 belong to fieldbus and PLC; NO_WAIT: it would wait with the lock
            # held
            flags = interface.FLAG_UPPER_RANGE_REGISTERS | interface.FLAG_NO_WAIT
            self._control = await self.construct("control", OPEN_S, interface, self._host, self._register_hz, flags)

    def sample(self) -> Sample:
        """Never waits."""
        read = (getattr(self._receive, getter)() for getter in _GETTERS.values())
        return Sample._make(tuple(value) if isinstance(value, list) else value for value in read)

    async def upload(self) -> bool:
        """Send the control script; it starts some time later."""
        return bool(await self.call("reuploadScript", OPEN_S, self._control.reuploadScript))

    def script_runs(self) -> bool:
        return bool(self._control.isProgramRunning())

    async def set_watchdog(self, min_hz: float) -> bool:
        return bool(await self.call("setWatchdog", STOP_S, self._control.setWatchdog, min_hz))

    async def kick(self) -> None:
        await self.call("kickWatchdog", CALL_S, self._control.kickWatchdog)

    async def servo(self, radians: tuple[float, ...], check: Callable[[], None]) -> bool:
        """``check`` is called last, in the worker; what it raises is raised here."""
        servo_j, target = self._control.servoJ, list(radians)

        def send() -> bool:
            check()
            return bool(servo_j(target, UNUSED, UNUSED, CONTROL_S, LOOKAHEAD_S, GAIN))

        return await self.call("servoJ", CALL_S, send)

    async def servo_stop(self) -> bool:
        return bool(await self.call("servoStop", STOP_S, self._control.servoStop, STOP_RAD_S2))

    async def stop_script(self) -> None:
        await self.call("stopScript", STOP_S, self._control.stopScript)
