"""Connect the wire process to a robot by the user's driver class. The methods of the object are called in a thread,
one at a time, each with a timeout.

A process connects to the robot only once. If a method hangs, or the readings stop coming, the object may still keep
its port open. Then the process must end, and a new process connects.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import (
    MotorReport,
    Observation,
    Permit,
    PermitDenied,
    ProcessSpent,
    Wire,
    WireDown,
)
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.sdk import SdkCalls
from strands_actors.kernel.clock import NS, Clock

from .config import PlainConfig
from .gates import REFUSED
from .instance import Instance
from .members import number

LOST_S = 1.0
"""Longest time without a reading, in seconds. After that the robot counts as lost."""

CALLS = SdkCalls("the driver", ())
"""The calls of all wire objects of this process, which has one robot. After one call that hangs, no further call is
made, and the process must be replaced."""


class PlainWire(Wire):
    def __init__(self, config: PlainConfig, clock: Clock, calls: SdkCalls = CALLS) -> None:
        self._config = config
        self._within = config.deadlines
        self._clock = clock
        self._calls = calls
        self._instance = Instance(config)
        self._alive: tuple[int, int] | None = None
        self._position = [math.nan] * len(config.axes)
        self._stamp_ns = [0] * len(config.axes)
        self._sensed: dict[str, tuple[float, ...]] = {}
        self._read_ns = 0
        self._refused: dict[str, str] = {}
        self._ended = ""  # error text of the object's cleanup; empty if it succeeded

    async def open(self) -> dict[str, Any]:
        if self._calls.spent:
            raise ProcessSpent(self._calls.spent)
        try:
            failure = await self._calls.open("connect", self._within.connect_s, self._instance.connect)
        except ProcessSpent as error:
            # Raise ``WireDown`` first, so that the user gets the error text. The next attempt to connect raises
            # ``ProcessSpent``, which replaces this process.
            raise WireDown(str(error)) from None
        trouble = failure or await self._observe()
        if trouble:
            await self._call("cleanup", self._within.cleanup_s, self._instance.cleanup)
            raise WireDown(trouble)
        self._alive = os.pipe()
        return {
            "driver_class": f"{self._config.location.module}.{self._config.name}",
            "axes_from": self._config.declared.source,
            "stop_channel": channel_of(self._config),
        }

    async def arm(self, permit: Permit) -> Observation:
        """Check the connection and read the robot. This switches no motor on. The class does that when it connects,
        or with its first action."""
        permit.check()
        if failure := await self._call("connect", self._within.connect_s, self._instance.reconnect):
            raise WireDown(failure)
        self._refused = {}
        if trouble := await self._observe():
            raise WireDown(trouble)
        permit.check()
        return self._observation()

    async def read(self) -> Observation:
        # After the cleanup there is no object to read, and this process ends.
        if self._instance.made is None:
            return self._observation()
        trouble = await self._observe()
        silent_s = (self._clock.now_ns() - self._read_ns) / NS
        if trouble and silent_s > LOST_S:
            self._calls.spent = f"{self._config.name}: no reading for {silent_s:.1f} s ({trouble})"
            raise ProcessSpent(self._calls.spent)
        return self._observation(trouble)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        keys, axes = self._config.declared.keys, self._config.axes
        named = [index for index in range(len(axes)) if values[len(axes) + index]]
        action = {keys[index]: values[index] for index in named}

        def send() -> str:
            # Check the permit in the thread itself, since the thread may have waited for a processor.
            permit.check()
            return self._instance.send(action)

        if self._instance.made is None:
            raise PermitDenied("the driver object was already disconnected")
        if failure := await self._call("send_action", self._within.call_s, send):
            self._refused = {axes[index]: REFUSED + failure.removeprefix(REFUSED) for index in named}

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self._instance.made is None:
            return reports(self._config, self._ended)  # the object was stopped before its cleanup
        try:
            failure = await self._call("stop", self._within.stop_s, self._instance.stop)
            if safe_state == SafeState.OFF and not failure:
                failure = self._ended = await self._call("cleanup", self._within.cleanup_s, self._instance.cleanup)
        except ProcessSpent as error:
            return reports(self._config, str(error), written=False)
        return reports(self._config, failure)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop a robot with a lost link: connect, stop, and disconnect, so that the next object can connect."""
        if self._calls.spent:
            return reports(self._config, self._calls.spent, written=False)
        instance = self._instance if self._instance.made is not None else Instance(self._config)
        try:
            failure = await self._call(
                "stop", self._within.connect_s + self._within.stop_s + self._within.cleanup_s, stop_anew, instance
            )
        except ProcessSpent as error:
            return reports(self._config, str(error), written=False)
        return reports(self._config, failure, written=not failure)

    def handover(self) -> Sequence[int]:
        """Return one end of a pipe. When the other end is closed, this process has ended and no longer uses the
        robot's port."""
        return () if self._alive is None else self._alive[:1]

    def close(self) -> None:
        if self._alive is not None:
            for fd in self._alive:
                os.close(fd)
            self._alive = None
        if self._instance.made is not None and not self._calls.spent:
            self._calls.spent = f"{self._config.name}: its object was connected, and was not disconnected properly"

    async def _call(self, name: str, deadline_s: float, function: Any, *args: Any) -> str:
        failure: str = await self._calls.call(name, deadline_s, function, *args)
        return failure

    async def _observe(self) -> str:
        """Take one reading. Return an error text if the class gave no reading."""
        requested_ns = self._clock.now_ns()
        answer = await self._calls.call("get_observation", self._within.call_s, self._instance.observe)
        if isinstance(answer, str):
            return answer
        self._read_ns = requested_ns
        self._take(answer, requested_ns)
        self._sensed = self._instance.sensed
        return ""

    def _take(self, observed: Mapping[str, Any], requested_ns: int) -> None:
        for index, (key, axis) in enumerate(zip(self._config.declared.keys, self._config.axes, strict=True)):
            value = number(observed[key] if key in observed else observed.get(axis, observed.get(f"{axis}.pos")))
            if value is not None:
                self._position[index], self._stamp_ns[index] = value, requested_ns

    def _observation(self, trouble: str = "") -> Observation:
        silent = dict.fromkeys(self._config.axes, f"silent ({trouble})") if trouble else {}
        return Observation(
            self._read_ns,
            tuple(self._position),
            tuple(self._stamp_ns),
            sensors=self._sensed,
            faults={**silent, **self._refused},
        )


def stop_anew(instance: Instance) -> str:
    """Stop the robot with a new object, disconnect it, and return the error text. This call blocks. If the class
    has ``stop_channel(port)``, that function is called instead."""
    if instance.has_channel and instance.made is None:
        return instance.stop_by_channel()
    failure = instance.connect() or instance.stop()
    ended = instance.cleanup()
    return failure or ended


def channel_of(config: PlainConfig) -> str:
    """Return a text for ``status``: how the robot is stopped after its wire process has ended."""
    return "stop_channel(port) of the class" if config.has_channel else "none: a fresh process calls stop()"


def reports(config: PlainConfig, failure: str, written: bool = True) -> tuple[MotorReport, ...]:
    """Return the same result of a stop for every axis, since the class answers for the whole robot."""
    return Outcome(written, not failure, failure).reports(config.axes, range(len(config.axes)))
