"""Connect the wire process (the only writer to the robot) to a legged robot, and command its joints.

``read`` only handles received data. Only ``open`` and the services wait for the robot, and each wait has a timeout.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, WireDown
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals, rpc
from .config import UnitreeConfig
from .gates import CONTROL_S, FSM_TTL_S, MODE_TTL_S, fsm_in_control, mode_in_control
from .link import FIND_S, Link, Service
from .refusals import MAY_LET_GO
from .rpc import ATTEMPTS, RELEASE_S
from .safing import bring_down, reports
from .session import ASK_EVERY_NS, RobotSession

BATTERY_S = 1.0
"""Longest wait for the battery, which is published slowly on a separate topic."""
REACH_S = 0.6
"""Longest time for a new participant to be discovered by a robot that has to be stopped."""
SILENT_S = 1.0
"""Longest time without a state. After it the link counts as lost."""
ENOUGH = 50
"""After so many unusable states without a usable one, no usable state is expected."""
STRANGER_S = 1.0
"""With ``simulator=True``, how long ``open`` waits for a service that only a real robot has. While connected, the
session keeps looking for it."""
REAL = (
    "simulator=True, but the service motion_switcher answers, so this is a real robot or its twin. Connect without "
    "simulator=, so that its mode and its battery are checked"
)


class UnitreeSession(RobotSession):
    """One connection to the robot, from ``open`` to ``close``, for joint commands."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        model = config.model
        self.link = link = Link(config, clock)
        link.listen()
        super().__init__(link, clock)
        self._simulator = config.simulator
        asks = model.handshake == "fsm" and not config.simulator
        self.fsm = Service(link.participant, model.service, clock) if asks else None
        self.fsm_id: tuple[float, float] | None = None
        self._requested_ns = 0
        self._observed_ns = 0
        self.discarded_before = 0
        """Number of states that were discarded before the newest state was accepted."""
        self._observation = Observation(0, (math.nan,) * len(model.joints), (0,) * len(model.joints))

    def poll(self, now_ns: int) -> None:
        """Handle received data, and request the onboard mode or FSM id if that is due."""
        self.link.poll()
        if self._simulator:
            if (
                self.modes.is_discovered
            ):  # It is a real robot. With simulator=True its mode and battery are not checked.
                raise WireDown(REAL)
        elif now_ns - self._requested_ns >= ASK_EVERY_NS:
            self._requested_ns = now_ns
            if self.fsm is not None:
                self.fsm.ask(rpc.GET_FSM_ID, self._on_fsm)
            else:
                self.ask_mode()

    def observation(self) -> Observation:
        """Return the newest observation. A new one is made only if a new LowState has arrived."""
        link = self.link
        if link.state is None or link.state_ns == self._observed_ns:
            return self._observation
        self._observed_ns = link.state_ns
        self.discarded_before = link.discarded.total()
        state = link.state
        sensors = self.sensors_of(state)
        faults: dict[str, str] = {}
        if self.fsm_id is not None:
            sensors["fsm"] = self.fsm_id
        if self.mode is not None and self.fsm is None:
            name, requested_s = self.mode
            sensors["sport_mode_released"] = (float(not name), requested_s)
            if name:
                faults["sport_mode"] = repr(name)
        self._observation = Observation(
            link.state_ns, state.q, (link.state_ns,) * len(state.q), state.dq, sensors, faults
        )
        return self._observation

    def held_by(self) -> str:
        """Return the onboard state or mode that controls the robot instead of our commands, from recent reports.

        Return an empty text if no such state or mode is known. Also return it while a request to release the robot
        has no answer, because the robot may still carry out this request.
        """
        if self.modes.unanswered:
            return ""
        now_s = self.clock.now_ns() / NS
        if self.fsm is not None:
            if self.fsm_id and now_s - self.fsm_id[1] <= FSM_TTL_S:
                return fsm_in_control(self.fsm_id[0])
        elif self.mode and self.mode[1] >= max(now_s - MODE_TTL_S, self.modes.settled_ns / NS):
            return mode_in_control(self.mode[0])
        return ""

    # -- answers

    def _on_fsm(self, response: rpc.Response) -> None:
        if not response.error:
            self.fsm_id = float(rpc.fsm_id(response)), response.id / NS


class UnitreeWire(PromptSessionWire[UnitreeSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._last: p.State | None = None  # The last state of the previous connection.
        # Ids of orders without an answer. They are kept when the connection ends, because the robot may still carry
        # them out.
        self._unanswered: set[int] = set()

    async def open(self) -> dict[str, Any]:
        """Find the robot, receive its state, and request its onboard mode."""
        self.close()
        self.session_or_none = session = UnitreeSession(self._config, self._clock)
        session.modes.unanswered = self._unanswered
        link, address = session.link, self._config.port
        await self._until(lambda: link.participant.peers > 0, FIND_S, f"{address}: no robot answers. Check port=")
        await self._until(lambda: link.matched, FIND_S, f"{address}: the robot does not receive {p.COMMAND_TOPIC}")
        await self._look(lambda: link.state_ns > 0 or link.discarded.total() >= ENOUGH, FIND_S)
        if link.state is None or not link.state_ns:
            raise WireDown(f"{address}: {link.unusable}")
        if self._config.simulator:
            # Wait: if this is a real robot, its services are found in this time, and ``poll`` raises.
            await self._look(lambda: False, STRANGER_S)
            return self._opened(link.state, "none: a simulator")
        services = [service for service in (session.modes, session.fsm) if service is not None]
        for service in services:
            await self._until_served(service)
        session.ask_mode()
        await self._until(
            lambda: session.mode is not None, FIND_S, f"{address}: the robot does not report its mode"
        )
        # Wait a short time for the charge and the FSM id. Without them connecting still succeeds, but the gates
        # refuse every command.
        await self._look(lambda: "battery_pct" in session.observation().sensors, BATTERY_S)
        await self._look(lambda: session.fsm is None or session.fsm_id is not None, BATTERY_S)
        assert link.state is not None and session.mode is not None
        return self._opened(link.state, session.mode[0] or "released")

    def _opened(self, state: p.State, mode: str) -> dict[str, Any]:
        return {
            "address": self._config.port,
            "network_interface": self._config.interface or None,
            "family": f"unitree_{self._config.model.family}",
            "mode_machine": state.machine,
            "onboard_mode": mode,
        }

    async def arm(self, permit: Permit) -> Observation:
        """Energise nothing. The robot's own controller holds it up until the first setpoint."""
        session = self.session
        await trio.lowlevel.checkpoint()
        permit.check()
        return await self._read(session)

    async def read(self) -> Observation:
        return await self._read(self.session)

    async def _read(self, session: UnitreeSession) -> Observation:
        now_ns = self._clock.now_ns()
        session.poll(now_ns)
        silent_s = (now_ns - session.link.state_ns) / NS
        if silent_s > SILENT_S:
            more = session.link.discarded.total() - session.discarded_before
            but = f", but {more} unusable ones" if more else ""
            raise WireDown(f"read: no usable LowState for {silent_s:.1f} s{but}. Check the robot and the network")
        return session.observation()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        link = session.link
        payload = link.encode(values)
        permit.check()
        if not link.send(payload):
            raise WireDown("write: the robot no longer receives commands. Check the robot and the network")

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return reports(self._config.model, False, "not connected")
        motors = await bring_down(session.link, safe_state, session.held_by)
        if not session.modes.unanswered:
            return motors
        return tuple(
            motor if motor.safe else msgspec.structs.replace(motor, detail=f"{motor.detail}; {MAY_LET_GO}")
            for motor in motors
        )

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring the robot to a safe state although the connection may be lost.

        If a participant is open, use it: the robot finds it again by itself. Otherwise open a new participant,
        which the robot must discover first.
        """
        session = self.session_or_none
        if session is not None:
            return await bring_down(session.link, safe_state)
        try:
            link = Link(self._config, self._clock)
        except WireDown as down:
            return reports(self._config.model, False, str(down))
        try:
            link.state = self._last
            link.listen()
            with trio.move_on_after(REACH_S):
                # A command needs the robot's mode_machine, or the robot ignores it. Only a state contains this
                # number.
                while not link.matched or link.state is None:
                    link.poll()
                    await trio.sleep(CONTROL_S)
            return await bring_down(link, safe_state)
        finally:
            link.close()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run ``release_sport_mode``: request the release until the robot reports that no onboard mode is active.

        The request is not repeated while an earlier one has no answer.
        """
        session = self.session
        if self._config.simulator:
            return refusals.simulator_without_mode()
        attempts = int(arguments.get("attempts", ATTEMPTS))
        for attempt in range(1, attempts + 1):
            name = await self._fresh_mode(session)
            if not name:
                return {"sport_mode_released": True, "attempts": attempt - 1}
            permit.check()
            await self._ask_for_release(session)
        name = await self._fresh_mode(session)
        if not name:
            return {"sport_mode_released": True, "attempts": attempts}
        if session.modes.unanswered:
            return refusals.unanswered_release(name)
        return refusals.failed_release(name, attempts)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
            self._last = self.session_or_none.link.state
            self._unanswered = self.session_or_none.modes.unanswered
            self.session_or_none = None

    # -- parts

    async def _ask_for_release(self, session: UnitreeSession) -> None:
        """Request the release, unless an earlier request has no answer yet. Then wait a while for the answer."""
        if not session.modes.unanswered:
            session.modes.request_action(rpc.RELEASE_MODE)
        await self._look(lambda: not session.modes.unanswered, RELEASE_S / 2)

    async def _fresh_mode(self, session: UnitreeSession) -> str:
        """Request the onboard mode and return it. ``read``, which runs at the same time, handles the response.

        Raises:
            WireDown: No response has arrived in time.
        """
        reported: list[str] = []

        def hear(response: rpc.Response) -> None:
            session.on_mode(response)
            if not response.error and session.mode is not None:
                reported.append(session.mode[0])

        with trio.move_on_after(RELEASE_S / 2):
            while not reported:
                session.modes.ask(rpc.CHECK_MODE, hear)
                await trio.sleep(ASK_EVERY_NS / NS)
        if not reported:
            detail = f"; {MAY_LET_GO}" if session.modes.unanswered else ""
            raise WireDown(f"the robot does not report which mode is active{detail}")
        return reported[-1]

    async def _until_served(self, service: Service) -> None:
        address = self._config.port
        await self._until(lambda: service.matched, FIND_S, f"{address}: there is no service {service.name}")

    async def _until(self, condition: Callable[[], bool], within_s: float, otherwise: str) -> None:
        if not await self._look(condition, within_s):
            raise WireDown(otherwise)

    async def _look(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Handle received data until the condition is true. Return False if it is not true within ``within_s``."""
        session = self.session
        with trio.move_on_after(within_s):
            while not condition():
                session.poll(self._clock.now_ns())
                await trio.sleep(CONTROL_S)
            return True
        return False
