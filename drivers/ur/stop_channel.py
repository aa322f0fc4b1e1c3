"""Stop a UR without its SDK. The wire process does so if ur-rtde hangs, and the root if the wire process has
ended."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .arms import IDS, JOINTS
from .config import URConfig
from .gates import CONTROL_HZ
from .plain import connected, open_samples, receive, refuse_long

STOP_S = 1.2
"""Longest time of a stop. From top speed a joint needs 0.8 s at the deceleration of ``stopj``."""

DASHBOARD_S = 0.25
"""Longest time for the dashboard. It is a separate program on the controller, and may hang while the arm
moves on."""

SCRIPT_S = 0.2
"""Time after which a sent program has replaced the one before [assumed]."""

STANDING_RAD_S = 0.02

WATCHED = ("timestamp", "actual_qd", "runtime_state")


class _Stop:
    """The progress of a stop."""

    def __init__(self, host: str) -> None:
        self._host = host
        self.written = False
        self.acknowledged = False  # by the dashboard; a script port answers nothing
        self.ordered = False  # the order had the time to take effect
        self.playing = True
        self.moving = set(range(len(JOINTS)))  # joints that move, or may move
        self.trouble: list[str] = []

    def reports(self) -> tuple[MotorReport, ...]:
        trouble = ", ".join(dict.fromkeys(self.trouble))
        reports = []
        for at, joint in enumerate(JOINTS):
            moves = at in self.moving
            safe = self.written and not self.playing and not moves
            detail = "" if safe else trouble or ("moves" if moves else "its program runs")
            reports.append(MotorReport(joint, at, self.written, self.acknowledged, safe, detail))
        return tuple(reports)

    async def order(self) -> None:
        """End the running program by the dashboard or, if that does not answer, by a script that replaces
        it."""
        try:
            with trio.fail_after(DASHBOARD_S):
                await self._by_dashboard()
        except (WireDown, trio.TooSlowError) as failure:
            self.trouble.append(str(failure) or f"{self._host}:{p.DASHBOARD_PORT}: does not answer")
            try:
                await self._by_script()
            except WireDown as down:
                self.trouble.append(str(down))

    async def _by_dashboard(self) -> None:
        async with connected(self._host, p.DASHBOARD_PORT) as stream:
            stream.write(f"{p.DASHBOARD_STOP}\n".encode())  # without waiting for the banner, which may never come
            self.written = True
            received = b""
            while p.DASHBOARD_STOPPED.encode() not in received:
                received += await receive(stream)
                refuse_long(stream, received)
            self.acknowledged = self.ordered = True

    async def _by_script(self) -> None:
        async with connected(self._host, p.SECONDARY_PORT) as stream:
            stream.write(p.STOP_SCRIPT)
            self.written = True
            # Keep the connection open and read from it. If it were closed at once, the text might be dropped
            # unread. If it were closed with unread data, it would be reset.
            with trio.move_on_after(SCRIPT_S):
                while True:
                    await stream.read()
            self.ordered = True

    async def watch(self) -> None:
        """Wait for a sample that is newer than the order and shows the stop. A sample that repeats the
        controller's time does not count."""
        time_s = -1.0
        try:
            with contextlib.closing(await open_samples(self._host, WATCHED, CONTROL_HZ)) as samples:
                while self.playing or self.moving or not self.ordered:
                    sample = await samples.next()
                    time_s, before_s = sample["timestamp"], time_s
                    if not 0.0 <= before_s < time_s:
                        continue
                    self.playing = sample["runtime_state"] != p.RuntimeState.STOPPED
                    self.moving = {
                        at for at, rad_s in enumerate(sample["actual_qd"]) if not abs(rad_s) < STANDING_RAD_S
                    }
        except WireDown as down:
            self.trouble.append(str(down))


async def stop(config: URConfig) -> tuple[MotorReport, ...]:
    """End any running program, then wait until the arm stands. Never raises."""
    try:
        state = _Stop(config.host)
    except ValueError as error:
        return Outcome(False, False, str(error)).reports(JOINTS, IDS)
    with trio.move_on_after(STOP_S):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(state.order)
            await state.watch()
            if state.ordered:
                nursery.cancel_scope.cancel()
    return state.reports()


class URStopChannel(StopChannel):
    """The root's stop channel. It opens its sockets when they are needed."""

    def __init__(self, config: URConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config

    @property
    def hosts(self) -> Sequence[str]:
        return (self._config.host,)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await stop(self._config)

    def close(self) -> None:
        """Do nothing: no socket stays open."""
