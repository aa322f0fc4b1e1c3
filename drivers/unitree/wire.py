"""The wire of a legged robot with commanded joints, in the wire process.

``read`` only handles received data. Only ``open`` and the services wait for the robot, each wait with
a deadline.
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
from strands_actors.drivers.unitree.refusals import UnitreeCode
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import rpc
from .config import UnitreeConfig
from .gates import CONTROL_S, FSM_TTL_S, HANDSHAKE_FSM, MODE_TTL_S
from .link import FIND_S, Link, Service
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
"""Time in which the services of a robot that was called a simulator are found. The session looks for them
as long as the link is up."""
MAY_LET_GO = "asked and not answered: it may still let go"
REAL = (
    "simulator=True, but a motion_switcher answers there: that is a robot, or its twin. Connect without "
    "simulator=, so that its mode and its battery are looked at"
)


class UnitreeSession(RobotSession):
    """The state of the wire between ``open`` and ``close``."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        model = config.model
        self.link = link = Link(config, clock)
        link.listen()
        super().__init__(link, clock)
        self._simulator = config.simulator
        asks = model.handshake == "fsm" and not config.simulator
        self.fsm = Service(link.participant, model.service, clock) if asks else None
        self.fsm_id: tuple[float, float] | None = None
        self._asked_ns = 0
        self._seen_ns = 0
        self.discarded_before = 0
        """How many states had been discarded when the newest state was accepted."""
        self._observation = Observation(0, (math.nan,) * len(model.joints), (0,) * len(model.joints))

    def poll(self, now_ns: int) -> None:
        """Handle received data, and send the requests that are due."""
        self.link.poll()
        if self._simulator:
            if self.modes.found:  # it is a robot, and its gates are not in force
                raise WireDown(REAL)
        elif now_ns - self._asked_ns >= ASK_EVERY_NS:
            self._asked_ns = now_ns
            if self.fsm is not None:
                self.fsm.ask(rpc.GET_FSM_ID, self._on_fsm)
            else:
                self.ask_mode()

    def observation(self) -> Observation:
        """Return the newest observation. It is built only after a new state."""
        link = self.link
        if link.state is None or link.state_ns == self._seen_ns:
            return self._observation
        self._seen_ns = link.state_ns
        self.discarded_before = link.discarded.total()
        state = link.state
        sensors = self.sensors_of(state)
        faults: dict[str, str] = {}
        if self.fsm_id is not None:
            sensors["fsm"] = self.fsm_id
        if self.mode is not None and self.fsm is None:
            name, asked_s = self.mode
            sensors["sport_mode_released"] = (float(not name), asked_s)
            if name:
                faults["sport_mode"] = repr(name)
        self._observation = Observation(
            link.state_ns, state.q, (link.state_ns,) * len(state.q), state.dq, sensors, faults
        )
        return self._observation

    def held_by(self) -> str:
        """Return what controls the robot instead of us, from its recent reports. Empty for nothing, and
        while a request to release the robot has no answer, since it may still be carried out."""
        if self.modes.owed:
            return ""
        now_s = self.clock.now_ns() / NS
        if self.fsm is not None:
            if self.fsm_id and now_s - self.fsm_id[1] <= FSM_TTL_S and self.fsm_id[0] not in HANDSHAKE_FSM:
                return f"FSM {self.fsm_id[0]:g}"
        elif self.mode and self.mode[0] and self.mode[1] >= max(now_s - MODE_TTL_S, self.modes.settled_ns / NS):
            return f"sport mode {self.mode[0]!r}"
        return ""

    # -- answers

    def _on_fsm(self, response: rpc.Response) -> None:
        if not response.why:
            self.fsm_id = float(rpc.fsm_id(response)), response.id / NS


class UnitreeWire(PromptSessionWire[UnitreeSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._last: p.State | None = None  # the last state of a session that was closed
        self._owed: set[int] = set()  # its open orders, which the robot has whether we are connected or not

    async def open(self) -> dict[str, Any]:
        """Find the robot, receive its state, and ask what controls it."""
        self.close()
        self.session_or_none = session = UnitreeSession(self._config, self._clock)
        session.modes.owed = self._owed
        link, where = session.link, self._config.port
        await self._until(lambda: link.participant.peers > 0, FIND_S, f"{where}: nobody answers. Check port=")
        await self._until(lambda: link.heard, FIND_S, f"{where}: nobody there takes {p.COMMAND_TOPIC}")
        await self._look(lambda: link.state_ns > 0 or link.discarded.total() >= ENOUGH, FIND_S)
        if link.state is None or not link.state_ns:
            raise WireDown(f"{where}: {link.unusable}")
        if self._config.simulator:
            await self._look(lambda: False, STRANGER_S)  # time in which a robot's services would be found
            return self._opened(link.state, "none: a simulator")
        services = [service for service in (session.modes, session.fsm) if service is not None]
        for service in services:
            await self._until_served(service)
        session.ask_mode()
        await self._until(lambda: session.mode is not None, FIND_S, f"{where}: its mode cannot be read")
        # The gates need these answers. A robot that does not give them can still be connected to; the
        # gates then refuse to move it.
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
        """Energise nothing: the robot stands by its own controller until the first setpoint."""
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
            but = f", but {more} that could not be used" if more else ""
            raise WireDown(f"read: no LowState for {silent_s:.1f} s{but}. Check the robot and the network")
        return session.observation()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        link = session.link
        payload = link.encode(values)
        permit.check()
        if not link.send(payload):
            raise WireDown("write: the robot no longer takes commands. Check the robot and the network")

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return reports(self._config.model, False, "not connected")
        motors = await bring_down(session.link, safe_state, session.held_by)
        if not session.modes.owed:
            return motors
        return tuple(
            motor
            if motor.safe
            else msgspec.structs.replace(motor, detail=f"{motor.detail}; release_sport_mode {MAY_LET_GO}")
            for motor in motors
        )

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Use the open participant, which the robot rediscovers by itself, or else a new one that has to be
        discovered first."""
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
                # The robot ignores a frame without its mode_machine, which only a state contains.
                while not link.heard or link.state is None:
                    link.poll()
                    await trio.sleep(CONTROL_S)
            return await bring_down(link, safe_state)
        finally:
            link.close()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run ``release_sport_mode``: order the release until the robot reports no active onboard mode. No
        second order is sent while one has no answer."""
        session = self.session
        if self._config.simulator:
            return Refused(UnitreeCode.SPORT_MODE, "a simulator has no onboard mode", "command its joints", "", "")
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
        if session.modes.owed:
            why = f"{name!r} is still active; {MAY_LET_GO}"
            return Refused(UnitreeCode.SPORT_MODE, why, "bring it to lie by its remote, and wait", name, "released")
        return Refused(
            UnitreeCode.SPORT_MODE,
            f"{name!r} is still active after {attempts} attempts",
            "bring the robot to lie or to damp by its remote, then try again",
            name,
            "released",
        )

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
            self._last = self.session_or_none.link.state
            self._owed = self.session_or_none.modes.owed
            self.session_or_none = None

    # -- parts

    async def _ask_for_release(self, session: UnitreeSession) -> None:
        """Order the release, unless an order has no answer yet, and wait a while for the answer."""
        if not session.modes.owed:
            session.modes.order(rpc.RELEASE_MODE)
        await self._look(lambda: not session.modes.owed, RELEASE_S / 2)

    async def _fresh_mode(self, session: UnitreeSession) -> str:
        """Ask for the onboard mode now and return it. ``read`` handles the answers meanwhile.

        Raises:
            WireDown: No answer came.
        """
        reported: list[str] = []

        def hear(response: rpc.Response) -> None:
            session.on_mode(response)
            if not response.why and session.mode is not None:
                reported.append(session.mode[0])

        with trio.move_on_after(RELEASE_S / 2):
            while not reported:
                session.modes.ask(rpc.CHECK_MODE, hear)
                await trio.sleep(ASK_EVERY_NS / NS)
        if not reported:
            owed = f"; {MAY_LET_GO}" if session.modes.owed else ""
            raise WireDown(f"the robot does not say which mode is active{owed}")
        return reported[-1]

    async def _until_served(self, service: Service) -> None:
        where = self._config.port
        await self._until(lambda: service.matched, FIND_S, f"{where}: there is no service {service.name}")

    async def _until(self, condition: Callable[[], bool], within_s: float, otherwise: str) -> None:
        if not await self._look(condition, within_s):
            raise WireDown(otherwise)

    async def _look(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Handle what arrives until the condition is true. Return False after ``within_s``."""
        session = self.session
        with trio.move_on_after(within_s):
            while not condition():
                session.poll(self._clock.now_ns())
                await trio.sleep(CONTROL_S)
            return True
        return False
