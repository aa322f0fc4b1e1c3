"""Connect the wire process to the base of a Gen3: read its feedback, and send speeds towards the target.

In the base, joint speeds never expire. So the wire process (the only writer to the robot) limits their lifetime.
While joints may be turning, a speed must be sent and new feedback must arrive at least every three control periods.
Otherwise ``read`` sends ``Stop``, and repeats it in every period until the base answers. After that the driver
sends no speed until the arm is armed again.

Feedback with the same frame number as before is not new. If speeds were corrected from such feedback, the arm
would never stop turning.
"""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar, Protocol

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.hand_gates import with_hand
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.tcp_port import ByteStream, open_tcp
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.health.heartbeat import new_page

from . import protocol as p
from .client import HANDSHAKE_S, SILENT_S, KortexClient, Page
from .config import KinovaConfig
from .gates import BASE, refuse_state
from .hand import KinovaHand, hand_report
from .protocol import ArmState, Call, Feedback, ServoingMode
from .speeds import Course, position_now
from .stop_channel import KinovaStopChannel
from .stopping import POLL_S, STANDING_DEG_S, stop_arm

READ_S = 0.01
"""Longest wait for feedback in one ``read``. A response that arrives later is used by the next ``read``."""

FORGET_S = 1.0
"""Feedback that arrives later than this after its request is discarded as too old."""


class SharedStream(ByteStream, Protocol):
    """A connection with a file descriptor, which can be passed to another process."""

    def fileno(self) -> int: ...


class KinovaSession:
    """One session with the base, from ``open`` to ``close``, with its newest feedback and commands."""

    def __init__(self, client: KortexClient, stream: SharedStream, page_fd: int) -> None:
        self.client = client
        self.stream = stream
        self.page_fd = page_fd
        self.requested_ns: dict[int, int] = {}  # Feedback requests without a response: request number -> time sent.
        self.feedback = Feedback(0, ())
        # Joint positions of the newest feedback in rad, without jumps at whole turns.
        self.position: tuple[float, ...] = (0.0,) * p.JOINTS
        self.stamp_ns = 0  # Time at which the newest feedback was requested.
        self.still_s = 0.0  # Time for which the base has only repeated its last measurement.
        self.course: Course | None = None
        self.sent_ns = 0
        self.turning = False  # True if joints may be turning because of speeds that this driver sent.
        self.stops: list[int] = []  # Request numbers of the stops that ``read`` has sent, without a response yet.
        self.hand: KinovaHand | None = None  # The gripper on the interface, if the driver commands one.
        self.lost = ""  # The reason why no speeds are sent until the arm is armed again.

    def take(self, number: int) -> None:
        """Store the feedback that answers request ``number``, if it has arrived and is newer than the last one."""
        answer = self.client.pop_response(number)
        if answer is None:
            return
        requested_ns = self.requested_ns.pop(number)
        if answer.error or requested_ns < self.stamp_ns:
            return
        try:
            feedback = Feedback.decode(answer.payload)
        except MalformedFrame:
            return  # Ignore malformed feedback and keep the last one. If that gets too old, the arm is stopped.
        if len(feedback.actuators) != p.JOINTS:
            return
        if self.feedback.actuators and feedback.frame == self.feedback.frame:
            self.still_s = (requested_ns - self.stamp_ns) / NS
            return
        self.position = feedback.unwrapped(self.position)
        self.feedback, self.stamp_ns, self.still_s = feedback, requested_ns, 0.0
        if self.hand is not None:
            self.hand.take(feedback, requested_ns)

    def forget_stops(self) -> None:
        """Discard the responses to earlier stops. They would not show that later speeds were stopped, too."""
        for number in self.stops:
            self.client.forget(number)
        self.stops.clear()

    @property
    def velocity(self) -> tuple[float, ...]:
        return tuple(math.radians(joint.velocity_deg_s) for joint in self.feedback.actuators)


class KinovaWire(SessionWire[KinovaSession]):
    interruptible: ClassVar[bool] = True

    def __init__(
        self,
        config: KinovaConfig,
        clock: Clock,
        open_stream: Callable[[str, int], Awaitable[SharedStream]] = open_tcp,
    ) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream

    async def open(self) -> dict[str, Any]:
        self.close()
        try:
            host, port = self._config.address()
        except ValueError as error:
            raise WireDown(f"open: {error}") from None
        stream = await self._open_stream(host, port)
        page_fd = new_page()
        page = Page(mmap.mmap(page_fd, 0))
        client = KortexClient(stream, f"{self._config.robot} at {host}:{port}", self._clock, page)
        self.session_or_none = session = KinovaSession(client, stream, page_fd)
        await client.log_in(*self._config.login)
        joints = await client.number(Call.GET_ACTUATOR_COUNT)
        if joints != p.JOINTS:
            raise WireDown(
                f"{self._config.robot}: the arm has {joints} joints, not {p.JOINTS}. Use a Gen3 with 7 joints"
            )
        await self._see_it_measure(session)
        if self._config.gripper:
            if session.feedback.fingers is None:
                raise WireDown(
                    f"{self._config.robot}: the base reports no gripper on the interface. Check its cable, "
                    "or leave gripper= out"
                )
            session.hand = KinovaHand(client)
            session.hand.take(session.feedback, session.stamp_ns)
        return {"address": f"{host}:{port}", "actuators": joints}

    async def arm(self, permit: Permit) -> Observation:
        session = self.session
        await self._see_it_measure(session)
        client = session.client
        mode = await client.number(Call.GET_SERVOING_MODE)
        # A base in low-level servoing has a state of its own, which ends with this mode.
        if mode != ServoingMode.LOW_LEVEL or session.feedback.arm_state != ArmState.LOW_LEVEL_SERVOING:
            _require_ready(session.feedback)
        for axis, joint in zip(self._config.axes, session.feedback.actuators, strict=True):
            if abs(joint.velocity_deg_s) >= STANDING_DEG_S:
                raise WireDown(
                    f"arming: {axis} turns, and not by a command of this program. Check which other program "
                    "commands the arm, then try again"
                )
        if mode != ServoingMode.SINGLE_LEVEL:
            permit.check()
            await client.call(Call.SET_SERVOING_MODE, p.encode_number(ServoingMode.SINGLE_LEVEL))
            await self._leave_low_level(session)
            _require_ready(session.feedback)
        permit.check()
        # Send the speed zero first: a base that accepts no speeds refuses it now, not during the motion.
        await client.call(Call.SEND_JOINT_SPEEDS, p.encode_speeds([0.0] * p.JOINTS))
        await self._refresh(session)
        session.forget_stops()
        client.refusal, session.course, session.lost = None, None, ""
        if session.hand is not None:
            session.hand.arm()
        return self._observation(session)

    async def read(self) -> Observation:
        session = self.session
        number = self._ask(session)
        await session.client.listen(number, READ_S)
        self._collect(session)
        if session.still_s > SILENT_S:
            raise WireDown(
                f"read: the base of {self._config.robot} has repeated the same measurement for "
                f"{session.still_s * 1e3:.0f} ms. Restart the base"
            )
        self._expire(session)
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session, config = self.session, self._config
        self._look_for_refusal(session)
        if session.lost:
            raise PermitDenied(session.lost)
        now_ns = self._clock.now_ns()
        age_s = (now_ns - session.stamp_ns) / NS
        if age_s > config.silent_s:
            raise PermitDenied(f"no new feedback for {age_s * 1e3:.0f} ms")
        position, now_s = position_now(session.position, session.velocity, age_s), now_ns / NS
        goal, course = values[: p.JOINTS], session.course
        if course is None or goal != course.goal:
            course = Course(course.position_at(now_s) if course else position, goal, now_s, config.period_s)
        speeds = course.speeds(now_s, position, config.fastest_rad_s)
        payload = p.encode_speeds([math.degrees(speed) for speed in speeds])
        permit.check()
        session.client.tell(Call.SEND_JOINT_SPEEDS, payload)
        session.course, session.sent_ns, session.turning = course, now_ns, any(speeds)
        if session.hand is not None:
            session.hand.follow(values[p.JOINTS], values[p.JOINTS + 1], now_ns, permit)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return NOT_CONNECTED.reports(self._config.all_axes)
        session.course = None
        reports, _, fingers = await stop_arm(self._config.axes, [session.client], last_positions=session.position)
        if all(report.acknowledged for report in reports):
            session.turning = False
        if session.hand is None:
            return reports
        return (*reports, hand_report(reports, fingers, session.hand.held_at))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm on a new session, and also on the lost connection if it still accepts bytes. If only the new
        session confirms the stop, the lost connection is reset and the arm is stopped again."""
        session = self.session_or_none
        wires = None if session is None else session.client
        channel = KinovaStopChannel(self._config, (), self._clock, self._open_stream, wires)
        try:
            return await channel.make_safe(safe_state)
        finally:
            channel.close()

    def handover(self) -> tuple[int, ...]:
        session = self.session_or_none
        return () if session is None else (session.stream.fileno(), session.page_fd)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.client.close()
            os.close(self.session_or_none.page_fd)
        self.session_or_none = None

    # -- parts

    def _ask(self, session: KinovaSession) -> int:
        now_ns = self._clock.now_ns()
        for number, requested_ns in list(session.requested_ns.items()):
            if now_ns - requested_ns > FORGET_S * NS:
                session.client.forget(number)
                del session.requested_ns[number]
        number = session.client.ask(Call.REFRESH_FEEDBACK)
        session.requested_ns[number] = now_ns
        return number

    def _collect(self, session: KinovaSession) -> None:
        for number in list(session.requested_ns):
            session.take(number)

    async def _see_it_measure(self, session: KinovaSession) -> None:
        """Check that the base still measures: wait for two new measurements. Raise ``WireDown`` without them.

        One measurement would not be enough, because a base that no longer measures repeats its last one.
        """
        for _ in range(2):
            await self._refresh(session)

    async def _refresh(self, session: KinovaSession) -> None:
        """Wait for a new measurement. Raise ``WireDown`` if it does not arrive in time."""
        before_ns, until_s = session.stamp_ns, trio.current_time() + HANDSHAKE_S
        while session.stamp_ns == before_ns:
            remaining_s = until_s - trio.current_time()
            if remaining_s <= 0.0:
                raise WireDown(
                    f"{self._config.robot}: the base sends no new feedback of {p.JOINTS} joints. Restart the base"
                )
            await session.client.listen(self._ask(session), remaining_s)
            self._collect(session)
            if session.stamp_ns == before_ns:
                await trio.sleep(POLL_S)  # The base has not measured again since the last reading. Wait for it.

    async def _leave_low_level(self, session: KinovaSession) -> None:
        """Wait for a measurement after the mode was set. Its state may follow the mode with a delay [assumed]."""
        until_s = trio.current_time() + HANDSHAKE_S
        await self._refresh(session)
        while session.feedback.arm_state == ArmState.LOW_LEVEL_SERVOING and trio.current_time() < until_s:
            await self._refresh(session)

    def _look_for_refusal(self, session: KinovaSession) -> None:
        if session.client.refusal is not None and not session.lost:
            session.lost = session.client.refusal.text

    def _expire(self, session: KinovaSession) -> None:
        """Send ``Stop`` if joints may be turning, but no new speeds are sent or no new feedback arrives."""
        self._look_for_refusal(session)
        answers = [answer for number in session.stops if (answer := session.client.pop_response(number))]
        for answer in answers[:1]:  # One response is enough: the others answer repetitions of the same stop.
            session.forget_stops()
            if answer.error:
                session.lost = f"the base refuses STOP: {p.sub_error_name(answer.sub_error)}"
            else:
                session.turning = False
        if not session.turning:
            return
        now_ns = self._clock.now_ns()
        for since_ns, missing in (
            (session.sent_ns, "no speed was sent"),
            (session.stamp_ns, "no new feedback arrived"),
        ):
            silent_s = (now_ns - since_ns) / NS
            if silent_s > self._config.silent_s and not session.lost:
                session.lost = f"stopped, because {missing} for {silent_s * 1e3:.0f} ms"
        if session.lost:
            session.stops.append(session.client.ask(Call.STOP))

    def _observation(self, session: KinovaSession) -> Observation:
        feedback = session.feedback
        faults = {
            axis: f"fault banks 0x{joint.faults[0]:x} 0x{joint.faults[1]:x}"
            for axis, joint in zip(self._config.axes, feedback.actuators, strict=True)
            if any(joint.faults)
        }
        if session.lost:
            faults[BASE] = session.lost
        observation = Observation(
            t_ns=session.stamp_ns,
            position=session.position,
            stamp_ns=(session.stamp_ns,) * p.JOINTS,
            velocity=session.velocity,
            sensors={
                "torque_nm": tuple(joint.torque_nm for joint in feedback.actuators),
                "current_a": tuple(joint.current_a for joint in feedback.actuators),
                "temperature_c": tuple(joint.motor_c for joint in feedback.actuators),
                "arm_voltage_v": (feedback.arm_v,),
                "tool_position_m": feedback.tool_m,
                "arm_state": (float(feedback.arm_state),),
                "fault_bank": (float(feedback.faults[0]),),
            },
            faults=faults,
        )
        return observation if session.hand is None else with_hand(observation, session.hand)


def _require_ready(feedback: Feedback) -> None:
    """Raise ``WireDown`` if the base is in a state in which it does not move the arm."""
    refusal = refuse_state(feedback.arm_state, feedback.faults[0])
    if refusal is not None:
        raise WireDown(refusal.text)
