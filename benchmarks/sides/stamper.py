"""A robot without hardware, which appends the time and the value of every frame to a file.

It serves to measure this package: all processes, checks and heartbeats are those of any other robot.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, StopChannel, Wire
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

ROBOT = "stamper"
AXES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LIMIT = 6.28
RECORD = struct.Struct("<qd?7x")
"""Nanoseconds of CLOCK_MONOTONIC, the elbow's value, and whether the frame is a safe one."""


class Stamper(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = (ROBOT,)
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = ""
    OPTIONS: ClassVar[Mapping[str, str]] = {"hz": "control rate"}

    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP)
    firmware_watchdog = "none"
    gates = ()
    bound_s = 0.05

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot, self.axes, self.ids, self._port = robot, AXES, tuple(range(len(AXES))), port
        hz = float(options.get("hz", 100.0))
        quick = hz > 100.0
        self.timing = Timing(
            control_hz=hz,
            # As in the driver of a robot with legs: while setpoints are on time, the last one is not sent again.
            keepalive_s=0.9 / hz if quick else 0.05,
            tick_s=0.002 if quick else 0.01,
        )

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        values, named = list(state.target), []
        for key, value in action.items():
            if key not in AXES:
                return Refused("unknown_joint", f"{key} is not an axis", f"use {', '.join(AXES)}")
            if not -LIMIT <= value <= LIMIT:
                return Refused("range", f"{key} is {value}", f"give {-LIMIT} to {LIMIT} radians", str(value))
            values[AXES.index(key)] = float(value)
            named.append(AXES.index(key))
        return Candidate(tuple(values), tuple(named))

    def open_wire(self, clock: Clock) -> Wire:
        return _Wire(self._port, clock)

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        return _StopChannel(self._port, clock)


class _FrameFile:
    def __init__(self, path: str, clock: Clock) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self._clock = clock

    def put(self, value: float, safe: bool = False) -> None:
        os.write(self._fd, RECORD.pack(self._clock.now_ns(), value, safe))

    def make_safe(self) -> tuple[MotorReport, ...]:
        self.put(0.0, safe=True)
        return tuple(MotorReport(axis, index, True, True, True) for index, axis in enumerate(AXES))

    def close(self) -> None:
        os.close(self._fd)


class _Wire(Wire):
    def __init__(self, path: str, clock: Clock) -> None:
        self._frames = _FrameFile(path, clock)
        self._clock = clock
        self._position = (0.0,) * len(AXES)

    async def open(self) -> dict[str, Any]:
        return {}

    async def arm(self, permit: Permit) -> Observation:
        permit.check()
        return await self.read()

    async def read(self) -> Observation:
        now_ns = self._clock.now_ns()
        return Observation(now_ns, self._position, (now_ns,) * len(AXES))

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        permit.check()
        self._frames.put(values[2])
        self._position = values

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return self._frames.make_safe()

    def close(self) -> None:
        self._frames.close()


class _StopChannel(StopChannel):
    def __init__(self, path: str, clock: Clock) -> None:
        self._frames = _FrameFile(path, clock)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return self._frames.make_safe()

    def close(self) -> None:
        self._frames.close()
