"""Stop a UR without ur-rtde.

The wire process uses this code if ur-rtde hangs. The supervising process (root) uses it after the wire process has
ended.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import trio

from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.rest_watch import RestWatch
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .arms import GRIPPER_ID, IDS, JOINTS, URCAP
from .config import URConfig
from .gates import CONTROL_HZ
from .plain import connected, open_samples, receive, refuse_long

STOP_S = 1.2
"""Longest time of a stop. From top speed a joint needs 0.8 s at the deceleration of ``stopj``."""

DASHBOARD_S = 0.25
"""Longest wait for the dashboard. It is a separate program on the controller, and may hang while the arm moves."""

SCRIPT_S = 0.2
"""Time after which a program that was sent to a script port has replaced the running program [assumed]."""

STANDING_RAD_S = 0.02

WATCHED = ("timestamp", "actual_qd", "runtime_state")


class _Stop:
    """One stop of the arm. It has the methods that order the stop and observe the joints, and the result so
    far."""

    def __init__(self, host: str) -> None:
        self._host = host
        self.written = False
        self.acknowledged = False  # True if the dashboard has confirmed the stop. A script port confirms nothing.
        self.ordered = False  # True once the stop was confirmed, or had the time to take effect.
        self.playing = True
        self._watch = RestWatch(len(JOINTS))
        self.trouble: list[str] = []

    def reports(self) -> tuple[MotorReport, ...]:
        trouble = ", ".join(dict.fromkeys(self.trouble))
        reports = []
        for index, joint in enumerate(JOINTS):
            moves = index in self._watch.unsteady
            safe = self.written and not self.playing and not moves
            detail = "" if safe else trouble or ("the joint moves" if moves else "a program still runs")
            reports.append(MotorReport(joint, index, self.written, self.acknowledged, safe, detail))
        return tuple(reports)

    async def order(self) -> None:
        """End the running program by the dashboard. If it does not answer, send a script that replaces the
        program."""
        try:
            with trio.fail_after(DASHBOARD_S):
                await self._by_dashboard()
        except (WireDown, trio.TooSlowError) as failure:
            self.trouble.append(str(failure) or f"{self._host}:{p.DASHBOARD_PORT}: the dashboard does not answer")
            try:
                await self._by_script()
            except WireDown as down:
                self.trouble.append(str(down))

    async def _by_dashboard(self) -> None:
        async with connected(self._host, p.DASHBOARD_PORT) as stream:
            # Send the stop at once. Do not wait for the dashboard's greeting, which may never arrive.
            stream.write(f"{p.DASHBOARD_STOP}\n".encode())
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
            # Keep the connection open for a while, and read the data that the controller sends. If the connection
            # were closed at once, or with unread data, the script might be lost.
            with trio.move_on_after(SCRIPT_S):
                while True:
                    await stream.read()
            self.ordered = True

    async def watch(self) -> None:
        """Wait until samples show that the arm stands still and no program runs."""
        try:
            with contextlib.closing(await open_samples(self._host, WATCHED, CONTROL_HZ)) as samples:
                while self.playing or self._watch.unsteady or not self.ordered:
                    sample = await samples.next()
                    moving = [i for i, rad_s in enumerate(sample["actual_qd"]) if not abs(rad_s) < STANDING_RAD_S]
                    if self._watch.report(sample["timestamp"], moving):
                        self.playing = sample["runtime_state"] != p.RuntimeState.STOPPED
        except WireDown as down:
            self.trouble.append(str(down))


async def stop_all(config: URConfig, clock: Clock) -> tuple[MotorReport, ...]:
    """Stop the arm, and its gripper if it has one, over new connections. Never raises."""
    if not config.drives_gripper:
        return await stop(config)
    gripper: list[MotorReport] = []

    async def stop_gripper() -> None:
        gripper.append(await load(f"{URCAP}:stop_gripper")(config.host, GRIPPER_ID, clock))

    try:
        _ = config.host
    except ValueError as error:
        return Outcome(False, False, str(error)).reports(config.axes, config.ids)
    async with trio.open_nursery() as nursery:
        nursery.start_soon(stop_gripper)
        arm = await stop(config)
    return (*arm, *gripper)


async def stop(config: URConfig) -> tuple[MotorReport, ...]:
    """End any running program, then wait until the arm stands still. Return a report per joint. Never raises."""
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
    """The stop channel of the supervising process (root). It connects only when it must stop the arm."""

    def __init__(self, config: URConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock

    @property
    def hosts(self) -> Sequence[str]:
        return (self._config.host,)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await stop_all(self._config, self._clock)

    def close(self) -> None:
        """Do nothing, because no connection stays open after a stop."""
