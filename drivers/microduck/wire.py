"""Drive a Microduck. This module runs in the wire process, the only process that sends it commands.

Intents, states and stops share one connection, which keeps their order. Services use another connection.

A twist is sent when it is accepted. It is repeated 20 times a second until its duration ends, and only while
the driver's own tasks still respond (``feed``). Then a zero follows. Nothing else is repeated. robotd's own
dead-man timer of 0.5 s therefore stops the duck if any of our processes fails.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import aclosing, suppress
from typing import Any, ClassVar, NamedTuple

import trio

from strands_actors.contract.refusals import robot_stopped
from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import MicroduckConfig
from .gates import HEADS, MOUTHS, MOVES, POSES, UNTIL
from .link import Connector, DuckLink
from .robots import HEAD_AT, OPEN, POSE_AT, TWIST
from .services import Services
from .stop import Stopping, stop_by
from .verbs import MOVING_POWER

LOOK_S = 0.5
"""Period of reading the values that the states lack: battery, drive mode, and whether the duck sits."""

LOOKED_S = 3.0
"""Age up to which those values count."""

TURNS_S = 2.0
"""Longest wait until robotd sends the head to the goal of its answer."""

NEAR_RAD = 0.02

QUIET_S = 0.2
"""Nothing is sent after so long without a state, since the robot would carry it out late."""

OLD_S = 0.3
"""How long a stop is tried on the connection that counts as lost, before it uses a new one."""

UNANSWERED = "robotd has not answered a request and may still carry it out. Check the robot"


class _Walk(NamedTuple):
    """A twist in force: its values and its end."""

    twist: tuple[float, ...]
    until_s: float


class MicroduckWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: MicroduckConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._connector = Connector(config)
        self._link = DuckLink(config, clock, self._connector)
        self._services: Services | None = None
        self._anew: DuckLink | None = None  # second connection, for a stop when the first is lost
        self._walk: _Walk | None = None
        self._is_armed = False
        # last commanded value of each axis; None if it was not commanded
        self._commanded: list[float | None] = [None] * len(config.axes)
        self._health = p.Health(True, "", math.nan, math.nan)
        self._mode = ""
        self._sitting: bool | None = None
        self._looked_ns = 0
        self._read = trio.Event()  # set by each reading, and then replaced by a new event

    async def open(self) -> dict[str, Any]:
        self.close()
        endpoint = self._config.endpoint()
        within_s = self._config.timeout_s
        reason = f"robotd did not shake hands within {within_s:g} s"
        with trio.move_on_after(within_s) as deadline:
            try:
                return await self._shake_hands(within_s)
            except MalformedFrame as malformed:
                reason = f"{malformed}. Check that robotd runs there"
            except WireDown as down:
                reason = str(down)
        if deadline.cancelled_caught and self._link.stamps.repeats(self._clock.now_ns()):
            reason = f"the time in its states has not changed for {within_s:g} s. Check its log"
        raise WireDown(f"{endpoint.name}: {reason}" if endpoint.name not in reason else reason)

    async def _shake_hands(self, within_s: float) -> dict[str, Any]:
        link = self._link
        await link.connect()
        hello = await link.greet(within_s)
        services = self._services = Services(self._config, self._connector, link, hello)
        services.skills = await link.subscribe(self._config.subscribe_hz, within_s) or self._config.skills
        await services.port.open()
        await self._look(services)
        await link.until_it_goes_on()
        facts: dict[str, Any] = {
            "robotd": self._config.endpoint().name,
            "api_version": hello.api_version,
            "daemon_version": hello.daemon_version,
            "mode": self._mode,
            "skills": list(services.skills),
            "watchdog_assumed_s": 0.5,
        }
        if hello.api_version != self._config.api_version:
            facts["warning"] = (
                f"robotd speaks API {hello.api_version}, not {self._config.api_version} as configured: "
                "services that it lacks are refused"
            )
        return facts

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        services = self._services
        if services is None:
            raise WireDown("serve: not connected. Connect first")
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._link.hear)
                nursery.start_soon(services.port.hear)
                nursery.start_soon(self._end_when_broken, services)
                task_status.started()
                async with aclosing(self._clock.ticks(LOOK_S)) as ticks:
                    async for _ in ticks:
                        await self._look(services)
        except* WireDown:
            if services.broken.is_set():
                # Several tasks end with the connection of the services. Report why it was reset.
                raise WireDown(UNANSWERED) from None
            raise

    async def arm(self, permit: Permit) -> Observation:
        """Accept commands from now on. A zero twist is sent, so that the duck stands. Torque and policy keep
        their state."""
        permit.check()
        self._link.port.notify(p.MOVE, p.REST)
        self._is_armed = True
        return await self.read()

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        link, now_ns = self._link, self._clock.now_ns()
        state = link.state
        if state is None or now_ns - link.stamps.new_ns > self._config.silent_s * NS:
            silent = f"for {self._config.silent_s:g} s"
            if link.stamps.repeats(now_ns):
                raise WireDown(f"read: the time in robotd's states has not changed {silent}. Check the robot")
            raise WireDown(f"read: no state from robotd {silent} ({link.problem}). Check the robot")
        read, self._read = self._read, trio.Event()
        read.set()
        targets = [0.0 if value is None else value for value in self._commanded]
        seen_rad = state.joints_rad[p.HEAD_JOINTS] if state.joints_rad else state.head_rad
        return Observation(
            t_ns=link.stamps.new_ns,
            position=(*state.applied, *seen_rad, *targets[POSE_AT], targets[OPEN]),
            stamp_ns=(link.stamps.new_ns,) * len(self._config.axes),
            sensors=self._sensors(state, now_ns),
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        port = self._link.port
        silent_s = (self._clock.now_ns() - self._link.stamps.new_ns) / NS
        if silent_s > QUIET_S:
            raise PermitDenied(
                f"the robot receives no commands now (its last state is {silent_s * 1e3:.0f} ms old)"
            )
        permit.check()
        if values[MOVES]:
            twist = values[: len(TWIST)]
            self._walk = _Walk(twist, values[UNTIL]) if any(twist) else None
            port.notify(p.MOVE, p.move(*twist))
        if values[HEADS]:
            port.notify(p.HEAD, p.head(values[HEAD_AT]))
        if values[POSES]:
            port.notify(p.POSE, p.pose(values[POSE_AT]))
        if values[MOUTHS]:
            port.notify(p.MOUTH, {"open": values[OPEN]})
        for flag, axes in ((HEADS, HEAD_AT), (POSES, POSE_AT), (MOUTHS, slice(OPEN, OPEN + 1))):
            if values[flag]:
                self._commanded[axes] = values[axes]

    async def feed(self) -> None:
        walk, now_ns = self._walk, self._clock.now_ns()
        if walk is None or now_ns - self._link.stamps.new_ns > QUIET_S * NS:
            return
        if now_ns >= walk.until_s * NS:
            self._walk = None
            self._link.port.notify(p.MOVE, p.REST)
        else:
            self._link.port.notify(p.MOVE, p.move(*walk.twist))

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self._disarm(safe_state)
        if not self._link.port.takes_stops:
            return self._reports(NOT_CONNECTED)
        return self._reports(await stop_by(self._link, safe_state, pending=self._pending))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the duck after its link was lost: first on the old connection, then on a new one. The old one
        may be dead without any sign.

        If only the new connection confirms the stop, intents may still wait on the old one. So the old one is
        reset, which drops them. Some of them may already be on their way, so the duck is then stopped once more.
        """
        self._disarm(safe_state)
        if self._link.is_open:
            outcome = await stop_by(self._link, safe_state, OLD_S)
            if not outcome.detail:
                return self._reports(outcome)
        else:
            # The connection counts as closed. It may still carry a stop if it was closed for an unreadable
            # answer.
            with suppress(WireDown):
                Stopping(self._link, safe_state).zero()
        self._anew = self._anew or DuckLink(self._config, self._clock, self._connector)
        outcome = await stop_by(self._anew, safe_state)
        if not outcome.detail and self._link.port.takes_stops:
            self._link.port.reset()
            outcome = await stop_by(self._anew, safe_state)
        return self._reports(outcome)

    def _disarm(self, safe_state: SafeState) -> None:
        self._walk = None
        self._is_armed = self._is_armed and safe_state == SafeState.ZERO

    def _pending(self) -> bool:
        return self._services is not None and self._services.unanswered > 0

    def _reports(self, outcome: Outcome) -> tuple[MotorReport, ...]:
        state, commanded = self._link.state, list(self._commanded)
        if commanded[HEAD_AT.start] is None and state is not None and state.targets_rad:
            # Report the goal of the head, because its measured position sags below the goal.
            commanded[HEAD_AT] = state.targets_rad[p.HEAD_JOINTS]
        targets = ((0.0,) * len(TWIST)) + tuple(commanded[len(TWIST) :])
        return outcome.reports(self._config.axes, self._config.ids, targets)

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        services = self._services
        if services is None:
            raise WireDown("not connected")
        begins = service in MOVING_POWER or (service == "theremin" and arguments.get("active", True))
        if begins and not self._is_armed:
            return robot_stopped()
        if service in MOVING_POWER and self._walk is not None:
            return refusals.walking()
        done = await services.perform(service, arguments, permit)
        if isinstance(done, Refused) or service not in ("enable", "look_at"):
            return done
        if service == "look_at":
            self._commanded[HEAD_AT] = row = tuple(done["head"].values())
            with trio.move_on_after(TURNS_S):
                await self._link.until_state(lambda state: _is_sent(state, row))
        # Wait for a reading from after the answer, so that the gate does not check an older one.
        await self._read.wait()
        return done

    def close(self) -> None:
        for link in (self._link, self._anew):
            if link is not None:
                link.close()
        if self._services is not None:
            self._services.close()
        self._services = self._anew = self._walk = None
        self._looked_ns = 0
        self._is_armed = False
        self._connector.close()

    # -- background tasks

    async def _look(self, services: Services) -> None:
        try:
            self._health, policies = await services.look()
        except MalformedFrame as malformed:
            self._link.problem = str(malformed)
            return
        except WireDown as down:
            if not services.port.is_open or not self._looked_ns:
                raise
            # Do not end the link here. The received states show whether the robot is there.
            self._link.problem = str(down)
            return
        self._mode, self._sitting = policies.mode, policies.sitting
        self._looked_ns = self._clock.now_ns()

    async def _end_when_broken(self, services: Services) -> None:
        await services.broken.wait()
        raise WireDown(UNANSWERED)

    def _sensors(self, state: p.State, now_ns: int) -> dict[str, tuple[float, ...]]:
        is_recent = now_ns - self._looked_ns <= LOOKED_S * NS
        modes = self._config.modes
        sensors: dict[str, tuple[float, ...]] = {
            "driven": (float(state.is_driven),),
            "fallen": (float(state.fallen),),
            "limp": (float(state.limp),),
            "picked_up": (float(state.picked_up),),
            "mode": (float(modes.index(self._mode)) if is_recent and self._mode in modes else -1.0,),
            "twist_requested": state.requested,
            "odometry_xy_m": state.position_m[:2],
            "odometry_yaw_rad": (state.yaw_rad,),
            "odometry_linear_m_s": state.applied[:2],
            "odometry_angular_rad_s": state.applied[2:],
            "healthy": (float(self._health.healthy),),
        }
        if self._sitting is not None:
            sensors["sitting"] = (float(self._sitting),)
        if state.targets_rad:
            sensors["head_target_rad"] = state.targets_rad[p.HEAD_JOINTS]
        if state.gyro_rad_s and state.quaternion_wxyz:
            sensors["gyro_rad_s"] = state.gyro_rad_s
            sensors["orientation_wxyz"] = state.quaternion_wxyz
            sensors["rpy_rad"] = roll_pitch_yaw(state.quaternion_wxyz)
        for name, value in (("battery_pct", self._health.battery_pct), ("battery_v", self._health.battery_v)):
            if not math.isnan(value):
                sensors[name] = (value,)
        return sensors


def _is_sent(state: p.State, head_rad: tuple[float, ...]) -> bool:
    """Return True if robotd's goal of the head is ``head_rad``, or if robotd does not report its goals."""
    sent = state.targets_rad[p.HEAD_JOINTS]
    return all(abs(target - goal) <= NEAR_RAD for target, goal in zip(sent, head_rad, strict=False))
