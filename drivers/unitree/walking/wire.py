"""Connect the wire process (the only writer to the robot) to a robot that walks by its onboard controller.

``read`` only handles received data and never waits. A Go2 with software 1.1.6 or later keeps a velocity for a
second, and with older software it never stops by itself. So the driver sends zero when the lifetime of a velocity
ends.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, WireDown
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.drivers.unitree import refusals, rpc
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.link import FIND_S
from strands_actors.drivers.unitree.session import ASK_EVERY_NS, RobotSession
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from .dialect import Order, Posture
from .link import WalkingLink
from .robots import BASE
from .states import SportState
from .stop import bring_down, reports

SILENT_S = 1.0
"""If no LowState arrives for this time, the connection counts as lost."""
EXTRAS_S = 1.0
"""Longest wait in ``open`` for the mode and the battery's charge, which the robot may publish at a low rate."""
AGAIN_S = 0.5
"""Period of repeating a request for a posture that the robot has not begun."""
SETTLE_S = 0.5
STILL_RAD_S = 0.3
"""Joints that have been slower than this for ``SETTLE_S`` count as resting [assumed]."""
LOOK_S = 0.05
"""Period of checking the joints."""


class WalkingSession(RobotSession):
    """One connection to the robot, from ``open`` to ``close``, for walking."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        self.link = link = WalkingLink(config, clock)
        link.listen()
        link.follow()
        super().__init__(link, clock)
        self.next_reading = trio.Event()  # Set by the next ``read``.
        self.moves: list[Order] = []  # The request of the newest velocity, or empty. Only its refusal is reported.
        self._requested_ns = 0

    def poll(self, now_ns: int) -> None:
        """Handle received data, and request the onboard mode if that is due."""
        self.link.poll()
        if now_ns - self._requested_ns >= ASK_EVERY_NS:
            self._requested_ns = now_ns
            self.ask_mode()

    def sent(self, order: Order) -> None:
        """Store a velocity request that was sent, and discard the robot's answers to earlier velocity requests."""
        if self.moves != [order]:
            for earlier in self.moves:
                self.link.refused.pop(earlier, None)
                self.link.answered.pop(earlier, None)
            self.moves = [order]

    def observation(self) -> Observation:
        link = self.link
        state, gait = link.state, link.gait
        sensors = {} if state is None else self.sensors_of(state)
        faults: dict[str, str] = {}
        for order in self.moves:
            if order in link.refused:
                faults["move"] = link.refused[order]
        if self.mode is not None:
            sensors["sport_mode_released"] = (float(not self.mode[0]), self.mode[1])
        if gait is None:
            return Observation(link.state_ns, (0.0,) * len(BASE), (0,) * len(BASE), (), sensors, faults)
        sensors["sport_mode"] = float(gait.mode), link.gait_ns / NS
        if gait.has_pose:
            self._add_odometry(sensors, gait)
        stamps = (link.gait_ns,) * len(BASE)
        return Observation(link.state_ns, gait.velocity, stamps, gait.velocity, sensors, faults)

    @staticmethod
    def _add_odometry(sensors: dict[str, tuple[float, ...]], gait: SportState) -> None:
        sensors["odometry_xyz_m"] = gait.position
        sensors["odometry_heading_rad"] = (gait.heading_rad,)
        sensors["odometry_linear_m_s"] = (*gait.velocity[:2], 0.0)
        sensors["odometry_angular_rad_s"] = 0.0, 0.0, gait.velocity[2]
        if math.isfinite(gait.height_m):
            sensors["body_height_m"] = (gait.height_m,)


class WalkingWire(PromptSessionWire[WalkingSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock

    # -- the link

    async def open(self) -> dict[str, Any]:
        """Find the robot, receive its state, and request its onboard mode.

        The battery's charge may be missing. Connecting then succeeds, but the gates refuse every command.
        """
        self.close()
        self.session_or_none = session = WalkingSession(self._config, self._clock)
        link, address = session.link, self._config.port
        if not await link.until(lambda: link.participant.peers > 0, FIND_S):
            raise WireDown(f"{address}: no robot answers. Check port=")
        await link.find(address)
        for order in link.dialect.opening_orders:
            link.send(order)
        if not await link.until(lambda: link.state_ns > 0, FIND_S):
            raise WireDown(f"{address}: {link.unusable}")
        await link.until(lambda: session.modes.matched, FIND_S)
        session.ask_mode()
        if not await link.until(lambda: session.mode is not None, FIND_S):
            raise WireDown(f"{address}: the robot does not report its mode. Check the robot and the network")
        await link.until(lambda: link.gait_ns > 0 and "battery_pct" in session.observation().sensors, EXTRAS_S)
        assert session.mode is not None
        facts = {"address": address, "network_interface": self._config.interface or None}
        return {**facts, "level": "sport", "onboard_mode": session.mode[0] or "released"}

    async def read(self) -> Observation:
        session, now_ns = self.session, self._clock.now_ns()
        session.poll(now_ns)
        silent_s = (now_ns - session.link.state_ns) / NS
        if silent_s > SILENT_S:
            raise WireDown(
                f"read: the robot has sent no LowState for {silent_s:.1f} s. Check the robot and the network"
            )
        session.next_reading.set()
        return session.observation()

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
            self.session_or_none = None

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Energise nothing, because the robot's own controller already controls its joints."""
        await trio.lowlevel.checkpoint()
        permit.check()
        return await self.read()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        order = session.link.dialect.move(*values)
        permit.check()
        if not session.link.send(order):
            raise WireDown("write: the robot's sport service is not connected. Check the robot and the network")
        session.sent(order)

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return reports(NOT_CONNECTED)
        session.moves = []
        return await bring_down(session.link, safe_state)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring the robot to a safe state although the connection may be lost.

        If a participant is open, use it: the robot finds it again by itself. Otherwise open a new participant.
        """
        session = self.session_or_none
        if session is not None:
            return await bring_down(session.link, safe_state)
        try:
            link = WalkingLink(self._config, self._clock)
        except WireDown as down:
            return reports(NOT_CONNECTED._replace(detail=str(down)))
        try:
            return await bring_down(link, safe_state)
        finally:
            link.close()

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        if service == "select_sport_mode":
            answer = await self._select(permit)
        else:
            answer = await self._take_posture(service, session.link.dialect.postures[service], permit)
        # Wait for the next ``read``. So the gates know the robot's new state before the caller gets the answer.
        session.next_reading = next_reading = trio.Event()
        await next_reading.wait()
        return answer

    async def _take_posture(self, service: str, posture: Posture, permit: Permit) -> dict[str, Any] | Refused:
        """Send the requests of a change of posture, one after the other.

        A request is repeated until the robot reports one of its modes. The service's answer is not enough: it only
        shows that the request was received.
        """
        link = self.session.link
        if link.gait is None:
            return refusals.unreported_mode(link.dialect.mode_source)
        mode = link.gait.mode
        name = link.dialect.name(mode)
        if mode in posture.done:
            return {"mode": name, "already": True}
        if mode not in posture.after:
            allowed = ", ".join(map(link.dialect.name, sorted(posture.after)))
            return refusals.impossible_posture(service, name, allowed)
        for order, modes in posture.steps:
            while not link.is_in(modes):
                permit.check()
                link.refused.pop(order, None)
                if not link.send(order):
                    raise WireDown("the robot's sport service is not connected. Check the robot and the network")
                await link.until(lambda: order in link.refused or link.is_in(modes), AGAIN_S)  # noqa: B023
                if order in link.refused:
                    return refusals.refused_request(link.refused[order])
            if modes & link.dialect.settles:
                await self._until_joints_rest(permit)
        return {"mode": link.dialect.name(link.gait.mode), "already": False}

    async def _until_joints_rest(self, permit: Permit) -> None:
        """Wait until no joint has moved for ``SETTLE_S``."""
        moved_ns = self._clock.now_ns()
        while self._clock.now_ns() - moved_ns < SETTLE_S * NS:
            await trio.sleep(LOOK_S)
            self.session.link.poll()
            permit.check()
            if self._joints_move:
                moved_ns = self._clock.now_ns()

    @property
    def _joints_move(self) -> bool:
        state = self.session.link.state
        return state is None or any(abs(speed) > STILL_RAD_S for speed in state.dq)

    async def _select(self, permit: Permit) -> dict[str, Any] | Refused:
        """Run ``select_sport_mode``: switch the onboard controller on again, after joints were commanded one by
        one."""
        session = self.session
        if session.mode is not None and session.mode[0]:
            return {"onboard_mode": session.mode[0], "already": True}
        name, answers = self._config.model.sport_mode, list[rpc.Response]()
        while True:
            permit.check()
            answers.clear()
            session.modes.ask(rpc.SELECT_MODE, answers.append, json.dumps({"name": name}))
            await session.link.until(lambda: bool(answers), AGAIN_S)
            session.ask_mode()
            await session.link.until(lambda: session.mode is not None and bool(session.mode[0]), AGAIN_S)
            if session.mode is not None and session.mode[0]:
                return {"onboard_mode": session.mode[0], "already": False}
            if answers and answers[0].error and answers[0].code != rpc.SELECTED_TOO_SOON:
                return refusals.refused_request(answers[0].error)
