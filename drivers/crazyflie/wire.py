"""Fly a Crazyflie. This module runs in the wire process, the only process that sends setpoints.

A setpoint is sent when it is accepted, and repeated while it is in force. A hover is repeated only while the
driver's own tasks still respond (``feed``). Nothing else is repeated. The firmware's watchdog (0.5 s and 2 s)
therefore acts if any of our processes fails. Takeoff is a service: neither opening nor arming starts a motor.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import trio

from strands_actors.contract.refusals import robot_stopped
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, ProcessSpent, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import LAND_S, LANDING_M_S, TAKEOFF_M, TAKEOFF_S, CrazyflieConfig
from .gates import sensors_of, takeoff_refusal
from .hovering import Hover
from .links import Link, open_link
from .protocol import Bit
from .robots import AXES, VX, VY, VZ, WZ, Z
from .session import AGAIN_S, CrazyflieSession, handshake
from .stopping import LOOK_S, STOP_S, bring_down, first_frames

ARM_S = 1.0
CHECKS_S = 0.5
"""Longest time for which the supervisor checks a drone that was just disarmed, before it may be armed again."""
SPIN_UP_S = 2.5
"""Longest time that motors need to spin up after arming. The firmware disarms the drone after two seconds."""
HOPELESS = Bit.LOCKED | Bit.TUMBLED | Bit.CRASHED
"""Flags of a drone that cannot be armed. It is not worth waiting then."""
RISE_S = 3.0
"""How much longer than requested a takeoff may take."""
NEAR_M = 0.05
"""Distance to its height at which a takeoff is complete."""
LANDED_S = 4.0
"""How much longer than its trajectory a landing may take: two seconds for which the drone may count as flying, and
lost packets."""


class CrazyflieWire(SessionWire[CrazyflieSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: CrazyflieConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._hover: Hover | None = None
        self._is_armed = False

    # -- the link

    async def open(self) -> dict[str, Any]:
        self.close()
        link = await self._open_link()
        try:
            session = CrazyflieSession(link, self._clock)
            facts = await handshake(session, 1 / self._config.setpoint_hz)
        except BaseException:
            link.close()
            raise
        self.session_or_none = session
        return facts

    async def _open_link(self) -> Link:
        endpoint = self._config.endpoint()
        if not endpoint.is_usb:
            return await open_link(endpoint)
        # Import pyusb only for the links that need it.
        from .usb_links import open_usb_link

        return await open_usb_link(endpoint)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await self.session.serve()

    @property
    def prompt(self) -> bool:
        session = self.session_or_none
        return session is not None and session.link.prompt

    async def read(self) -> Observation:
        session = self.session
        session.take_waiting()
        silent_s = session.age_s()
        if silent_s > self._config.silent_s:
            problem = " repeats one report" if session.repeats() else " is silent"
            raise WireDown(f"read: {session.link.name}{problem} for {silent_s:.1f} s. Check radio and power")
        return self._observation(session)

    def handover(self) -> Sequence[int]:
        return () if self.session_or_none is None else self.session_or_none.link.handover()

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
        self.session_or_none = self._hover = None
        self._is_armed = False

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Check that the drone may be commanded. No motor starts."""
        session = self.session
        bits = await session.supervisor(ARM_S)
        permit.check()
        if bits is None:
            raise WireDown("arming: the drone's supervisor does not answer. Check radio and power")
        if Bit.LOCKED in bits:
            raise WireDown("arming: the drone is locked after an emergency stop. Switch it off and on")
        if bits.airborne:
            raise WireDown("arming: the drone is in the air. Wait until it stands on the floor")
        self._is_armed = True
        return await self.read()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not self._is_armed:
            raise PermitDenied("the drone was stopped in the meantime")
        vx, vy, vz, wz = values[VX], values[VY], values[VZ], values[WZ]
        by_height = bool(values[Z + 1])
        packet = p.hover(vx, vy, wz, values[Z]) if by_height else p.velocity(vx, vy, vz, wz)
        await session.link.write(packet, permit)
        self._hover = None

    async def feed(self) -> None:
        session, hover = self.session, self._hover
        if hover is None:
            return
        now_ns = self._clock.now_ns()
        flight = session.flight
        if flight is not None and not flight.bits.airborne and session.robot_s > hover.risen_s:
            # The drone lies on the floor. A hover would start its motors.
            self._hover = None
            return
        await session.link.write(hover.packet(now_ns))

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session, self._hover = self.session_or_none, None
        if session is None:
            self._is_armed = False
            return NOT_CONNECTED.reports(AXES)
        if safe_state == SafeState.HOLD:
            # Ignore a lost link here. The next write reports it.
            with contextlib.suppress(WireDown):
                session.take_waiting()
            flight = self._fresh_flight(session)
            if flight is not None and flight.bits.airborne:
                return await self._hover_at(session, flight.z_m)
            # Send no hover on the floor, because it would start the motors.
            if flight is None:
                self.hold_failed = "no report of the drone arrives"
        # On the floor the drone stays ready for commands, with its motors off.
        self._is_armed = safe_state == SafeState.HOLD and not self.hold_failed
        end_state = SafeState.LAND if safe_state == SafeState.HOLD else safe_state
        return (await bring_down(session, end_state)).reports(AXES)

    async def _hover_at(self, session: CrazyflieSession, height_m: float) -> tuple[MotorReport, ...]:
        """Hover at the present place. ``height_m`` is limited to the permitted heights."""
        low, high = self._config.z_m
        height_m = max(low, min(high, height_m))
        hover = Hover(self._clock.now_ns(), height_m)
        try:
            await session.link.write(hover.packet(hover.began_ns))
        except (WireDown, ProcessSpent) as failure:
            return Outcome(False, False, str(failure)).reports(AXES)
        self._hover = hover
        return Outcome(True, True, "").reports(AXES, targets=(0.0, 0.0, 0.0, 0.0, height_m))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the drone after its link was lost. A UDP socket stays in use. Any other link gets the first packets
        of the stop once and is closed, because it may be dead and would block a new one. Then a new link is
        opened."""
        end_state = SafeState.LAND if safe_state == SafeState.HOLD else safe_state
        session, self._hover, self._is_armed = self.session_or_none, None, False
        if session is not None and session.link.outlives_a_loss:
            return (await bring_down(session, end_state)).reports(AXES)
        if session is not None:
            with contextlib.suppress(WireDown, ProcessSpent):
                await session.send(*first_frames(end_state))
            self.close()
        try:
            link = await self._open_link()
        except (WireDown, ProcessSpent) as failure:
            return Outcome(False, False, str(failure)).reports(AXES)
        try:
            return (await bring_down(CrazyflieSession(link, self._clock), end_state)).reports(AXES)
        finally:
            link.close()

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        if not self._is_armed:
            return robot_stopped()
        if service == "takeoff":
            height_m = float(arguments.get("height", TAKEOFF_M))
            return await self._take_off(height_m, float(arguments.get("duration", TAKEOFF_S)), permit)
        if service == "land":
            return await self._land(float(arguments.get("duration", LAND_S)), permit)
        return refusals.stop_as_service()

    async def _take_off(self, height_m: float, duration_s: float, permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        requested_ns = self._clock.now_ns()
        bits = await _await_bit(session, Bit.ARMED | Bit.CAN_BE_ARMED, CHECKS_S)
        refusal = takeoff_refusal(bits, self._observation(session).sensors, self._config.battery_v)
        if refusal is not None:
            return refusal
        flight = self._fresh_flight(session)
        if flight is None:
            return refusals.unknown_height(session.age_s(), self._config.fresh_s)
        permit.check()
        if bits is None or not bits.airborne:
            answer = await session.ask(p.ARM_QUESTION, ARM_S, permit)
            if answer is None or not _says_armed(answer):
                await session.send(p.STOP, p.YIELD, p.DISARM)
                return refusals.arming_not_confirmed()
            permit.check()
            # The firmware ignores setpoints while motors spin up. A rise that began now would begin with a jump.
            bits = await _await_bit(session, Bit.CAN_FLY, SPIN_UP_S)
            permit.check()
            if bits is None or Bit.CAN_FLY not in bits:
                await session.send(p.STOP, p.YIELD, p.DISARM)
                return refusals.not_spun_up()
        # Rise no faster than a command may request.
        duration_s = max(duration_s, abs(height_m - flight.z_m) / self._config.climb_m_s)
        # Allow for two delays on the link: the newest report is older than its arrival suggests, and the first
        # hover arrives later than it is sent. Both delays together are at most the time between a request and its
        # answer.
        began_ns = self._clock.now_ns()
        late_s = session.age_s() + (began_ns - requested_ns) / NS
        self._hover = Hover(began_ns, height_m, flight.z_m, duration_s, session.robot_s + late_s + duration_s)
        with trio.move_on_after(duration_s + RISE_S):
            while not self._is_up(session, height_m):
                await session.news(AGAIN_S)
                permit.check()
            return {"height": round(self._height_m(session), 3), "duration": round(duration_s, 2)}
        does_not_fly, self._hover = self._hover is None, None
        outcome = await bring_down(session, SafeState.LAND)
        return refusals.incomplete_takeoff(height_m, does_not_fly, outcome.detail)

    async def _land(self, duration_s: float, permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        permit.check()
        self._hover = None
        flight = self._fresh_flight(session)
        # Without a fresh report, land all the same, because the drone knows its height.
        if flight is None:
            outcome = await bring_down(session, SafeState.LAND)
            took = {"velocity": LANDING_M_S}
        else:
            land_s = max(duration_s, flight.z_m / LANDING_M_S)
            outcome = await bring_down(session, SafeState.LAND, max(STOP_S, land_s + LANDED_S), land_s)
            took = {"duration": round(land_s, 2)}
        if outcome.detail:
            return refusals.not_landed(outcome.detail)
        return {"landed": True, **took}

    def _is_up(self, session: CrazyflieSession, height_m: float) -> bool:
        hover, flight = self._hover, session.flight
        if hover is None or flight is None or hover.rises(self._clock.now_ns()):
            return False
        return flight.bits.airborne and abs(flight.z_m - height_m) <= NEAR_M

    def _fresh_flight(self, session: CrazyflieSession) -> p.Flight | None:
        return session.flight if session.age_s() <= self._config.fresh_s else None

    def _height_m(self, session: CrazyflieSession) -> float:
        return session.flight.z_m if session.flight else 0.0

    # -- parts

    def _observation(self, session: CrazyflieSession) -> Observation:
        flight, position = session.flight, session.position
        if flight is None or position is None:
            raise WireDown("read: no report of the drone has arrived yet. Check radio and power")
        hover = self._hover
        hover_s = 0.0 if hover is None else hover.still_s(self._clock.now_ns())
        axes = (*flight.velocity_m_s, flight.wz_rad_s, flight.z_m)
        faults = [bit.name or "" for bit in (Bit.TUMBLED, Bit.LOCKED, Bit.CRASHED) if bit in flight.bits]
        return Observation(
            t_ns=session.flight_ns,
            position=axes,
            stamp_ns=(session.flight_ns,) * len(axes),
            sensors=sensors_of(flight, position, (self._clock.now_ns() - session.position_ns) / NS, hover_s),
            faults={"drone": ", ".join(faults).lower()} if faults else {},
        )


async def _await_bit(session: CrazyflieSession, flags: Bit, within_s: float) -> Bit | None:
    """Read the supervisor's flags until one of ``flags`` is set, at most for ``within_s``. Return the last flags;
    None if it does not answer."""
    ends_s = trio.current_time() + within_s
    while True:
        bits = await session.supervisor(ARM_S)
        if bits is None or bits & (flags | HOPELESS) or trio.current_time() > ends_s:
            return bits
        await trio.sleep(LOOK_S)


def _says_armed(answer: bytes) -> bool:
    try:
        return p.is_armed(answer)
    except MalformedFrame:
        return False
