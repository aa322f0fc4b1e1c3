"""An xArm's controller in the wire process, and the root's stop channel to it.

Two connections: requests and replies on one, a hundred reports a second on the other. Reading is taking in what has
arrived; only ``open``, ``arm`` and ``make_safe`` wait, each wait with a deadline.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import trio

from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.tcp_port import open_tcp
from strands_actors.runtime.clock import NS, Clock
from strands_actors.runtime.contract import (
    MotorReport,
    Observation,
    Permit,
    PermitDenied,
    SecondPath,
    Wire,
    WireDown,
)

from . import protocol as p
from .arms import ArmType
from .control import Control, OpenStream, Outcome, Stream, open_control, stop, stop_anew
from .protocol import Mode, Register, State

if TYPE_CHECKING:
    from .driver import XArm

HANDSHAKE_S = 0.6
"""More than a controller may be silent: one that opens and does not speak is told as such."""

LIMIT_S = 0.5
"""For the first rich report; they come five times a second."""

ENABLE_S = 5.0
"""The vendor's SDK waits so long for motors to be enabled."""
SETTING_S = 1.0
READY_S = 2.0

ERRORS_EVERY_S = 0.05

QUIET_S = 0.05
"""No setpoint is written to a controller that has been silent for so long: it would be taken up late."""

HOLD_S, HELD_RAD = 0.4, 0.01
"""An arm that is told to hold comes within ``HELD_RAD`` of the target within ``HOLD_S``, or it is stopped."""

_MOVABLE = (State.MOVING, State.READY)


class _Session:
    """What exists between ``open`` and ``close``."""

    def __init__(self, control: Control, kind: ArmType, limit_rad_s: float, reports: Stream, name: str) -> None:
        self.control = control
        self.kind = kind
        self.limit_rad_s = limit_rad_s
        self.target: tuple[float, ...] = ()  # the last that was written, since it was armed
        self.report: p.Report
        self.stamp_ns = 0  # when the report came
        self.asked_ns = 0  # when the errors were asked for
        self._reports = reports
        self._name = name
        self._decoder = p.ReportDecoder()

    def take_waiting(self, now_ns: int) -> None:
        """Take in what has arrived on both connections. Raise ``WireDown``."""
        self.control.take_waiting()
        while (data := self._reports.read_waiting()) is not None:
            self._take(data, now_ns)

    async def next_report(self, clock: Clock, within_s: float) -> bool:
        """Wait for one that has not come yet; False: none came in time. Raise ``WireDown``."""
        before_ns = self.stamp_ns
        with trio.move_on_after(within_s):
            while self.stamp_ns == before_ns:
                self._take(await self._reports.read(), clock.now_ns())
        return self.stamp_ns != before_ns

    def close(self) -> None:
        self.control.close()
        self._reports.close()

    @property
    def movable(self) -> bool:
        return self.report.mode == Mode.SERVO and self.report.state in _MOVABLE

    def held_at(self, target: tuple[float, ...]) -> bool:
        pairs = zip(self.report.position_rad, target, strict=True)
        return all(abs(rad - wanted) <= HELD_RAD for rad, wanted in pairs)

    def _take(self, data: bytes, now_ns: int) -> None:
        try:
            for report in self._decoder.feed(data):
                self.report, self.stamp_ns = p.parse_report(report), now_ns
        except MalformedFrame as malformed:
            raise WireDown(f"{self._name}: its reports cannot be understood ({malformed}). Reconnect") from None


class XArmWire(Wire):
    def __init__(self, driver: XArm, clock: Clock, open_stream: OpenStream = open_tcp) -> None:
        self._driver = driver
        self._clock = clock
        self._open_stream = open_stream
        self._session_or_none: _Session | None = None

    async def open(self) -> dict[str, Any]:
        self.close()
        driver = self._driver
        control = await open_control(driver, self._clock, self._open_stream)
        try:
            version = await self._version(control)
            kind = driver.kind_of(version)
            if await control.ask(Register.ERRORS, within_s=HANDSHAKE_S) is None:
                raise WireDown(f"{driver.robot} at {driver.port}: does not say its errors. Restart the controller")
            limit = await self._speed_limit()
            session = await self._listen(control, kind, limit or driver.arm.speed_rad_s)
        except BaseException:
            control.close()
            raise
        self._session_or_none = session
        return {
            "address": driver.port,
            "firmware": version.text,
            "arm_type": version.arm_type,
            "serial": version.serial,
            "speed_limit_rad_s": round(session.limit_rad_s, 4),
            "speed_limit": "the controller's" if limit else "not told by the controller: assumed",
        }

    async def arm(self, permit: Permit) -> Observation:
        session = self._session()
        await self._ask(session, Register.ERRORS, b"", SETTING_S, permit)
        self._refuse_error(session)
        settings = (
            (Register.MOTION_ENABLE, bytes((p.ALL_JOINTS, 1)), ENABLE_S),
            (Register.SET_MODE, bytes((Mode.SERVO,)), SETTING_S),
            (Register.SET_STATE, bytes((State.GO,)), SETTING_S),
        )
        for register, data, within_s in settings:
            permit.check()
            await self._ask(session, register, data, within_s, permit)
            if session.control.error_pending:
                await self._ask(session, Register.ERRORS, b"", SETTING_S, permit)
                self._refuse_error(session)
        await self._until_movable(session, permit)
        here = session.report.position_rad
        permit.check()
        reply = await self._ask(session, Register.SERVO_JOINT, p.servo_data(here, hold=True), SETTING_S, permit)
        if reply.state & (p.ERROR | p.NOT_READY | p.INVALID):
            raise WireDown(f"enable: the arm does not take its position as target (status 0x{reply.state:02x})")
        session.target = here
        return self._observation(session)

    @property
    def prompt(self) -> bool:
        return True

    async def read(self) -> Observation:
        session = self._session()
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        self._check_alive(session, now_ns)
        control = session.control
        since_s = (now_ns - session.asked_ns) / NS
        news = control.error_pending != bool(control.errors[0])
        # rather alone: who answers one request a reading is asked one at a time. But a reply may never come
        if since_s >= (ERRORS_EVERY_S if control.idle else 2 * ERRORS_EVERY_S) or (news and control.idle):
            control.send(Register.ERRORS)
            session.asked_ns = now_ns
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self._session()
        now_ns = self._clock.now_ns()
        session.take_waiting(now_ns)
        silent_s = max((now_ns - session.stamp_ns) / NS, session.control.silent_s(now_ns))
        if silent_s > QUIET_S:
            raise PermitDenied(f"the controller is silent for {silent_s * 1e3:.0f} ms")
        permit.check()
        session.control.send(Register.SERVO_JOINT, p.servo_data(values))
        session.target = values

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        session = self._session_or_none
        if session is None:
            return Outcome(False, False, "not connected").reports()
        if rung == "hold" and session.target:
            outcome = await self._hold(session)
            if not outcome.detail:
                return outcome.reports()
        session.target = ()
        outcome = await stop(session.control)
        if not outcome.written:  # its connection is gone: the arm need not be
            outcome = await stop_anew(self._driver, self._clock, self._open_stream)
        return outcome.reports()

    async def reach(self, rung: str) -> tuple[MotorReport, ...]:
        return (await stop_anew(self._driver, self._clock, self._open_stream)).reports()

    def close(self) -> None:
        if self._session_or_none is not None:
            self._session_or_none.close()
        self._session_or_none = None

    # -- opening

    async def _version(self, control: Control) -> p.Version:
        name = f"{self._driver.robot} at {self._driver.port}"
        reply = await control.ask(Register.VERSION, within_s=HANDSHAKE_S)
        if reply is None:
            raise WireDown(f"{name}: connected, but no answer. Is it an xArm's controller? Restart it")
        try:
            return p.parse_version(reply.data)
        except MalformedFrame as malformed:
            raise WireDown(f"{name}: {malformed}. Update its firmware") from None

    async def _speed_limit(self) -> float | None:
        """The controller's own, from its rich report; None when it does not tell."""
        decoder = p.ReportDecoder()
        with trio.move_on_after(LIMIT_S):
            try:
                stream = await self._open_reports(p.RICH_PORT)
                try:
                    while True:
                        for report in decoder.feed(await stream.read()):
                            return p.speed_limit_of(report)
                finally:
                    stream.close()
            except (WireDown, MalformedFrame):
                pass  # then the table's limit counts: see facts
        return None

    async def _listen(self, control: Control, kind: ArmType, limit_rad_s: float) -> _Session:
        stream = await self._open_reports(p.REAL_PORT)
        name = f"{self._driver.robot} at {self._driver.host}:{p.REAL_PORT}"
        session = _Session(control, kind, limit_rad_s, stream, name)
        try:
            if not await session.next_report(self._clock, HANDSHAKE_S):
                raise WireDown(f"{name}: connected, but no report. Restart the controller")
        except BaseException:
            stream.close()
            raise
        return session

    async def _open_reports(self, port: int) -> Stream:
        return await self._open_stream(self._driver.host, port)

    # -- arming

    async def _ask(
        self, session: _Session, register: Register, data: bytes, within_s: float, permit: Permit
    ) -> p.Reply:
        reply = await session.control.ask(register, data, within_s=within_s, permit=permit)
        if reply is None:
            raise WireDown(f"enable: no answer to {register.name} within {within_s:g} s. Check the controller")
        return reply

    def _refuse_error(self, session: _Session) -> None:
        error = session.control.errors[0]
        if error:
            raise WireDown(
                f"enable: controller holds error {p.error_words(error)}. Clear it at the arm, then resume()"
            )

    async def _until_movable(self, session: _Session, permit: Permit) -> None:
        """Until a report shows servo mode and a state that moves."""
        session.take_waiting(self._clock.now_ns())
        with trio.move_on_after(READY_S):
            while await session.next_report(self._clock, READY_S):
                permit.check()
                if session.movable:
                    return
        report = session.report
        raise WireDown(
            f"enable: the arm is in state {report.state}, mode {report.mode} after {READY_S:g} s, not ready in "
            "servo mode. Look at it in the vendor's software"
        )

    # -- holding

    async def _hold(self, session: _Session) -> Outcome:
        """Tell it its last target once more, and see it there. Never raises."""
        acknowledged = False
        try:
            data = p.servo_data(session.target, hold=True)
            reply = await session.control.ask(Register.SERVO_JOINT, data, within_s=HOLD_S)
            acknowledged = reply is not None
            if reply is None or reply.state & (p.ERROR | p.NOT_READY | p.INVALID):
                return Outcome(True, acknowledged, "not held")
            session.take_waiting(self._clock.now_ns())
            with trio.move_on_after(HOLD_S):
                while await session.next_report(self._clock, HOLD_S):
                    if session.movable and session.held_at(session.target):
                        return Outcome(True, True, "")
        except WireDown as down:
            return Outcome(True, acknowledged, str(down))
        return Outcome(True, acknowledged, "not where it is to hold")

    # -- parts

    def _check_alive(self, session: _Session, now_ns: int) -> None:
        silent_s = max((now_ns - session.stamp_ns) / NS, session.control.silent_s(now_ns))
        if silent_s > self._driver.silent_s:
            raise WireDown(
                f"read: {self._driver.robot} is silent for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )

    def _observation(self, session: _Session) -> Observation:
        report, (error, warning) = session.report, session.control.errors
        low, high = zip(*session.kind.range_rad, strict=True)
        return Observation(
            t_ns=session.stamp_ns,
            position=report.position_rad,
            stamp_ns=(session.stamp_ns,) * p.JOINTS,
            sensors={
                "torque_nm": report.torque_nm,
                "tcp_pose_mm_rad": report.pose_mm_rad,
                "state": (float(report.state),),
                "mode": (float(report.mode),),
                "error": (float(error),),
                "warning": (float(warning),),
                "speed_limit_rad_s": (session.limit_rad_s,),
                "range_low_rad": low,
                "range_high_rad": high,
            },
            faults={"controller": f"error {p.error_words(error)}"} if error else {},
        )

    def _session(self) -> _Session:
        if self._session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self._session_or_none


class XArmStopChannel(SecondPath):
    """The root's way to the controller: a connection of its own, made when it is needed. By then the wire's is
    gone with its process, so a controller that takes one client takes this one. A name for an address has to be
    looked up then, too: a number is quicker."""

    def __init__(self, driver: XArm, clock: Clock, open_stream: OpenStream = open_tcp) -> None:
        self._driver = driver
        self._clock = clock
        self._open_stream = open_stream

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        return (await stop_anew(self._driver, self._clock, self._open_stream)).reports()

    def close(self) -> None:
        """Nothing is kept open."""
