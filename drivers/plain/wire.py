"""The wire of a driver class of the user's own: its calls, one at a time, in a thread, each with a
deadline.

A process connects to a robot once. An object that was not given up in order, because a call of it
hangs or its readings end, keeps whatever port it has: the process is spent then, and the next one
connects anew.
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
from strands_actors.drivers.common.outcome import Outcome
from strands_actors.drivers.common.sdk import SdkCalls
from strands_actors.kernel.clock import NS, Clock

from .config import PlainConfig
from .gates import REFUSED
from .instance import Instance
from .members import number

LOST_S = 1.0
"""Without a reading for so long the object has lost its robot."""

CALLS = SdkCalls("the driver", ())
"""Of this process, which has one robot: one call that hangs spends it, whichever wire made it."""


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
        self._ended = ""  # what went wrong when the object was given up

    async def open(self) -> dict[str, Any]:
        if self._calls.spent:
            raise ProcessSpent(self._calls.spent)
        try:
            failure = await self._calls.open("connect", self._within.connect_s, self._instance.connect)
        except ProcessSpent as spent:
            raise WireDown(str(spent)) from None  # so that its caller is told; the next attempt finds it spent
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
        """Energise nothing: what connecting did not, the class does with its first action."""
        permit.check()
        if failure := await self._call("connect", self._within.connect_s, self._instance.reconnect):
            raise WireDown(failure)
        self._refused = {}
        if trouble := await self._observe():
            raise WireDown(trouble)
        permit.check()
        return self._observation()

    async def read(self) -> Observation:
        if self._instance.made is None:  # it was given up: this wire ends
            return self._observation()
        trouble = await self._observe()
        silent_s = (self._clock.now_ns() - self._read_ns) / NS
        if trouble and silent_s > LOST_S:
            self._calls.spent = f"{self._config.name}: no reading for {silent_s:.1f} s ({trouble})"
            raise ProcessSpent(self._calls.spent)
        return self._observation(trouble)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        keys, axes = self._config.declared.keys, self._config.axes
        named = [at for at in range(len(axes)) if values[len(axes) + at]]
        action = {keys[at]: values[at] for at in named}

        def send() -> str:
            permit.check()  # in the thread: it may have waited for a processor
            return self._instance.send(action)

        if self._instance.made is None:
            raise PermitDenied("the driver was given up")
        if failure := await self._call("send_action", self._within.call_s, send):
            self._refused = {axes[at]: REFUSED + failure.removeprefix(REFUSED) for at in named}

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self._instance.made is None:
            return reports(self._config, self._ended)  # it was stopped before it was given up
        try:
            failure = await self._call("stop", self._within.stop_s, self._instance.stop)
            if safe_state == SafeState.OFF and not failure:
                failure = self._ended = await self._call("cleanup", self._within.cleanup_s, self._instance.cleanup)
        except ProcessSpent as spent:
            return reports(self._config, str(spent), written=False)
        return reports(self._config, failure)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Connect, stop, and give up again, so that the next wire may connect."""
        if self._calls.spent:
            return reports(self._config, self._calls.spent, written=False)
        instance = self._instance if self._instance.made is not None else Instance(self._config)
        try:
            failure = await self._call(
                "stop", self._within.connect_s + self._within.stop_s + self._within.cleanup_s, stop_anew, instance
            )
        except ProcessSpent as spent:
            return reports(self._config, str(spent), written=False)
        return reports(self._config, failure, written=not failure)

    def handover(self) -> Sequence[int]:
        """Hand the root one end of a pipe: at its end of file this process is gone, and has let go
        of the robot."""
        return () if self._alive is None else self._alive[:1]

    def close(self) -> None:
        if self._alive is not None:
            for fd in self._alive:
                os.close(fd)
            self._alive = None
        if self._instance.made is not None and not self._calls.spent:
            self._calls.spent = f"{self._config.name}: its object was connected, and was not given up in order"

    async def _call(self, name: str, deadline_s: float, function: Any, *args: Any) -> str:
        told: str = await self._calls.call(name, deadline_s, function, *args)
        return told

    async def _observe(self) -> str:
        """Take one reading; return why there is none."""
        asked_ns = self._clock.now_ns()
        answer = await self._calls.call("get_observation", self._within.call_s, self._instance.observe)
        if isinstance(answer, str):
            return answer
        self._read_ns = asked_ns
        self._take(answer, asked_ns)
        self._sensed = self._instance.sensed
        return ""

    def _take(self, observed: Mapping[str, Any], asked_ns: int) -> None:
        for at, (key, axis) in enumerate(zip(self._config.declared.keys, self._config.axes, strict=True)):
            value = number(observed[key] if key in observed else observed.get(axis, observed.get(f"{axis}.pos")))
            if value is not None:
                self._position[at], self._stamp_ns[at] = value, asked_ns

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
    """Stop the robot by an object made for it, and give it up; return what went wrong. Waits.

    A class whose ``stop_channel(port)`` there is needs no object."""
    if instance.has_channel and instance.made is None:
        return instance.stop_by_channel()
    failure = instance.connect() or instance.stop()
    ended = instance.cleanup()
    return failure or ended


def channel_of(config: PlainConfig) -> str:
    """Return, for status, what stops the robot when its wire process is gone."""
    return "stop_channel(port) of the class" if config.has_channel else "none: a fresh process calls stop()"


def reports(config: PlainConfig, failure: str, written: bool = True) -> tuple[MotorReport, ...]:
    """Return all axes alike: the class answers for its robot."""
    return Outcome(written, not failure, failure).reports(config.axes, range(len(config.axes)))
