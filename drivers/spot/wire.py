"""Drive a Spot. This module runs in the wire process, the only process that commands the robot.

No command is repeated. A twist ends by the robot's clock. Our e-stop endpoint checks in only while
the driver's own tasks still respond (``feed``). Each command uses a newer number of the lease than
the previous one. The robot therefore refuses a command that arrives late, after a stop.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import msgspec
import trio

from strands_actors.contract.refusals import robot_stopped
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome, names_of
from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import SAFE_S, SpotConfig
from .control import (
    BodyLease,
    EstopEndpoint,
    LeaseLost,
    RobotTime,
    is_standing,
    power_status,
    read_state,
    see_it_report,
)
from .gates import COMMAND, ESTOP, LEASE
from .messages import Message
from .readings import Targets, held_at, observe, reason_moving
from .robots import ARM, BASE, CLAW, DRIVES, KEYS, MOVES_ARM, MOVES_CLAW
from .session import ANSWER_S, NoAnswer, OpenStream, SentRequest, SpotSession
from .stopping import LOOK_S, confirm, confirm_off, stop_by_estop

RENEW_LOOK_S = 1.0
"""Period of the check whether the token or the robot's clock has to be renewed."""
RETAIN_S = 1.0
"""Period of ``RetainLease``, which shows that the lease is in use."""
RELEASED_S = 1.5
"""Longest time until the robot reports that its e-stop is released."""
POWER_ON_S, STAND_UP_S = 20.0, 10.0
SIT_S = 5.0
"""Longest time to sit and switch motors off. After that the e-stop is asserted."""
HOLD_S = 2.0
"""Longest time until the robot is seen to stand still."""
MARGIN_S = 0.7
"""Part of ``Timing.safe_s`` that is reserved for the steps after a stop."""
SERVICES = ("robot-command", "robot-state", "estop", "lease", "power", "time-sync")


class SpotWire(SessionWire[SpotSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: SpotConfig, clock: Clock, open_stream: OpenStream | None = None) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream
        self._is_armed = False
        self._reading: p.Reading | None = None
        self._read_ns = 0
        self._faults: dict[str, str] = {}
        # Why a service failed, if the robot may still carry out its command; empty otherwise.
        self._link_error = ""

    # -- the link

    async def open(self) -> dict[str, Any]:
        self.close()
        session = SpotSession(self._config, self._clock, self._open_stream)
        opened = False
        try:
            identity = (await session.call("GetRobotId", {})).get("robot_id", {})
            await session.open(SERVICES)
            self._time = RobotTime(session)
            await self._time.sync()
            await see_it_report(session, self._config.silent_s)
            opened = True
        finally:
            if not opened:
                session.close()
        self._lease = BodyLease(session)
        self._estop = EstopEndpoint(session, self._config.estop_timeout_s)
        self._checked_in_ns = self._retained_ns = self._command_id = 0
        self._faults, self._link_error = {}, ""
        self.session_or_none = session
        version = identity.get("software_release", {}).get("version", {})
        return {
            "serial": identity.get("serial_number", ""),
            "nickname": identity.get("nickname", ""),
            "software": ".".join(
                str(version.get(part, 0)) for part in ("major_version", "minor_version", "patch_level")
            ),
            "clock_skew_s": round(self._time.skew_s, 3),
        }

    async def read(self) -> Observation:
        """Read the robot's state. Its age counts from the last change of the robot's time stamp,
        because a state that repeats the stamp is not new."""
        session, before = self.session, self._reading
        if self._link_error:
            raise WireDown(self._link_error)
        try:
            self._reading = await read_state(session)
            if before is None or self._reading.stamp_ns != before.stamp_ns:
                self._read_ns = self._clock.now_ns()
        except NoAnswer:
            if before is None or self._silent_s() > self._config.silent_s:
                raise
        if self._silent_s() > self._config.silent_s:
            raise WireDown(
                f"robot state: the robot has reported nothing new for {self._silent_s():.1f} s. Check the robot"
            )
        assert self._reading is not None
        return observe(self._reading, self._read_ns, self._faults)

    def _silent_s(self) -> float:
        return (self._clock.now_ns() - self._read_ns) / NS

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Renew the token and the estimate of the robot's clock in the background. Either may take
        longer than a call, and the old values stay valid for a while."""
        session = self.session
        task_status.started()
        while True:
            await session.renew()
            await self._time.renew()
            await trio.sleep(RENEW_LOOK_S)

    async def feed(self) -> None:
        """Check in with the e-stop before a third of its timeout has passed, or in each call if the
        calls are rarer. Tell the robot that the lease is in use."""
        # This raises ``WireDown`` if there is no session.
        _ = self.session
        now_ns = self._clock.now_ns()
        # Ignore one missing answer. ``read`` judges how long the robot may be silent.
        with contextlib.suppress(NoAnswer):
            if self._estop.level is p.StopLevel.NONE and now_ns - self._checked_in_ns >= self._check_in_ns:
                await self._check_in(now_ns)
            if self._lease.is_held and now_ns - self._retained_ns >= RETAIN_S * NS:
                self._retained_ns = now_ns
                try:
                    await self._lease.retain()
                except LeaseLost as lost:
                    self._store_owner(lost)

    async def _check_in(self, now_ns: int) -> None:
        """Check in with the e-stop, unless its timeout has passed. The robot has asserted its
        e-stop by then, and a late check-in would lift it."""
        late_s = (now_ns - self._checked_in_ns) / NS
        if late_s >= self._config.estop_timeout_s:
            self._estop.level = p.StopLevel.SETTLE_THEN_CUT
            self._faults[ESTOP] = f"a check-in of our e-stop endpoint was {late_s:.1f} s late"
            return
        if await self._estop.check_in(p.StopLevel.NONE):
            self._checked_in_ns = now_ns
        else:
            self._faults[ESTOP] = "another client has set up the robot's e-stop"

    @property
    def _check_in_ns(self) -> int:
        """Time after the last check-in, in ns, from which ``feed`` checks in again. If ``feed`` waited for
        its next call, more than a third of the timeout would pass."""
        return round((self._config.estop_timeout_s / 3 - self._config.feed_s) * NS)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.close()
        self.session_or_none = self._reading = None
        self._is_armed = False

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Take the lease, and set up an e-stop endpoint that permits power. The motors are not
        switched on or off."""
        if not self._lease.is_held:
            await self._lease.acquire()
            self._faults.pop(LEASE, None)
        if not self._estop.is_known:
            await self._set_up_estop()
        permit.check()
        if not await self._estop.check_in(p.StopLevel.NONE, permit):
            raise WireDown("arming: the robot does not know our e-stop endpoint any more. Call resume() again")
        self._faults.pop(ESTOP, None)
        self._checked_in_ns = self._clock.now_ns()
        await self._until_released()
        permit.check()
        self._is_armed = True
        self._faults.pop(COMMAND, None)
        return await self.read()

    async def _set_up_estop(self) -> None:
        """Make our endpoint the robot's only e-stop endpoint.

        Raises:
            WireDown: The robot refuses. Another client then drives it, and our lease is returned for that client.
        """
        try:
            await self._estop.set_up()
        except WireDown:
            with contextlib.suppress(WireDown):
                await self._lease.give_back()
            raise

    async def _until_released(self) -> None:
        """Wait until our endpoint is in force and no e-stop is asserted. Raise ``WireDown``."""
        reason = "the robot has not reported it"
        with trio.move_on_after(RELEASED_S):
            while True:
                pressed = (await read_state(self.session)).pressed
                reason = ", ".join(pressed) or await self._estop.read_back()
                if not reason:
                    return
                await trio.sleep(LOOK_S)
        raise WireDown(f"arming: the robot is E-stopped ({reason}). Release it first")

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        if not self._is_armed:
            raise PermitDenied("the robot was stopped in the meantime")
        parts: list[Message] = []
        if values[DRIVES]:
            parts.append(p.twist(values[: len(BASE)], self._time.in_ns(p.TWIST_S)))
        if values[MOVES_ARM]:
            parts.append(p.arm(values[len(BASE) : len(BASE) + len(ARM)], self._config.arm_speed_rad_s))
        if values[MOVES_CLAW]:
            parts.append(p.claw(values[KEYS.index(CLAW)]))
        if parts:
            await self._command(p.together(*parts), permit)

    async def _command(self, command: Message, permit: Permit | None) -> p.Command | int:
        """Send a command, and return the robot's status for it.

        Raises:
            WireDown: It failed, or was not answered. The robot may still carry it out, so it is stopped.
        """
        with self._end_link_on_failure():
            try:
                status = await self._send_and_read_status(command, permit)
            except LeaseLost as lost:
                self._store_owner(lost)
                return p.Command.UNKNOWN
            if status == p.Command.NO_TIMESYNC:
                raise WireDown("time sync: the robot's clock was changed. Reconnect")
        if status == p.Command.OK:
            self._faults.pop(COMMAND, None)
        else:
            self._faults[COMMAND] = f"the last command was refused: {p.name_of(p.Command, status)}"
        return status

    @contextlib.contextmanager
    def _end_link_on_failure(self) -> Iterator[None]:
        """Run a service. If it fails, the next ``read`` ends the link, because the robot may still
        carry out the command. The robot then sits down."""
        try:
            yield
        except WireDown as down:
            self._link_error = str(down)
            raise

    async def _send_and_read_status(self, command: Message, permit: Permit | None) -> int:
        answer = await self.session.answer(self._send(command, permit))
        if not self._lease.check(answer):
            return p.Command.UNKNOWN
        self._command_id = answer.get("robot_command_id", 0)
        status: int = answer.get("status", 0)
        return status

    def _send(self, command: Message, permit: Permit | None) -> SentRequest:
        """Send a command with the next use number of the lease. Raise ``LeaseLost`` or
        ``WireDown``."""
        body = {"lease": self._lease.use(), "command": command, "clock_identifier": self._time.clock_identifier}
        return self.session.ask("RobotCommand", body, permit)

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self.session_or_none is None:
            self._is_armed = False
            return self._reports(NOT_CONNECTED)
        if safe_state == SafeState.HOLD:
            return await self._hold()
        self._is_armed = False
        outcome, lease_failure = Outcome(False, False, "we have no lease to command the robot"), ""
        if safe_state != SafeState.OFF:
            outcome, lease_failure = await self._sit()
        if outcome.detail:
            session = self.session
            by_estop = await stop_by_estop(session, self._estop, safe_state, SAFE_S - MARGIN_S - SIT_S)
            written = outcome.written or by_estop.written
            outcome = Outcome(written, outcome.acknowledged or by_estop.acknowledged, by_estop.detail)
            lease_failure = await self._give_back() if not outcome.detail else ""
        return self._reports(outcome, lease_failure)

    async def _hold(self) -> tuple[MotorReport, ...]:
        """Command the robot to stand still, and read back that it does.

        If another client has the lease, this program does not move the robot any more. If no client has
        it, the robot can only be observed.
        """
        written = acknowledged = is_unowned = False
        detail, watch = "silent", RestWatch()
        with trio.move_on_after(HOLD_S):
            while True:
                had_lease = self._lease.is_held
                try:
                    if not (acknowledged or is_unowned):
                        status = await self._send_and_read_status(p.STOP, None)
                        written = True
                        acknowledged = status in (p.Command.OK, p.Command.NOT_POWERED_ON)
                        detail = f"not confirmed: the robot answered a stop with {p.name_of(p.Command, status)}"
                    if acknowledged or is_unowned:
                        detail, targets = await self._confirm_standing(watch)
                        if not detail:
                            return self._reports(Outcome(written, True, ""), targets=targets)
                except LeaseLost as lost:
                    written = written or had_lease
                    if self._lease.was_taken:
                        self._store_owner(lost)
                    if lost.owner or not self._lease.was_taken:
                        return self._reports(Outcome(written, True, ""))
                    is_unowned, detail = True, f"not confirmed: {lost}"
                except WireDown as down:
                    written = written or isinstance(down, NoAnswer) or await self._send_without_answer(p.STOP)
                    detail = f"not confirmed: {down}"
                await trio.sleep(LOOK_S)
        return self._reports(Outcome(written, acknowledged, detail))

    async def _send_without_answer(self, command: Message) -> bool:
        """Send a command with our lease on a new connection, without waiting for an answer.

        Damaged answers end a connection. The robot may still understand our commands.

        Returns:
            True if the command was sent.
        """
        session = self.session_or_none
        if session is None or not self._lease.is_held:
            return False
        try:
            await session.connect_without_answer("robot-command")
            self._send(command, None)
        # The caller reports that the stop is not confirmed.
        except WireDown:
            return False
        return True

    async def _confirm_standing(self, watch: RestWatch) -> tuple[str, Targets]:
        """Return two results: why the robot is not known to stand still (empty if it is), and the position of
        each axis of the standing robot.

        Motors that are being powered on are switched off again. Raise ``LeaseLost`` or ``WireDown``.
        """
        session = self.session
        reading = await read_state(session)
        detail = confirm(watch, reading, reason_moving(reading))
        if reading.motors is p.Motors.POWERING_ON and watch.rest is not Rest.NOTHING_SINCE:
            request = session.ask("PowerCommand", {"lease": self._lease.use(), "request": p.POWER_OFF})
            self._lease.check(await session.answer(request))
        return detail, () if detail else held_at(reading)

    async def _sit(self) -> tuple[Outcome, str]:
        """Command the robot to sit down and switch its motors off, then return the lease.

        Returns:
            The outcome of the stop, and why the lease was not returned; empty if it was returned.
        """
        written = acknowledged = False
        detail = "silent"
        with trio.move_on_after(SIT_S):
            try:
                status = await self._send_and_read_status(p.SAFE_POWER_OFF, None)
                written = True
                if status not in (p.Command.OK, p.Command.NOT_POWERED_ON):
                    return Outcome(True, False, f"not confirmed: {p.name_of(p.Command, status)}"), ""
                acknowledged = True
                watch = RestWatch()
                while True:
                    detail = await confirm_off(self.session, watch)
                    if not detail:
                        break
                    await trio.sleep(LOOK_S)
                # From here on ``feed`` sends no more check-ins.
                self._estop.level = p.StopLevel.SETTLE_THEN_CUT
                return Outcome(True, True, ""), await self._give_back()
            except LeaseLost as lost:
                if lost.owner:
                    self._faults[LEASE] = str(lost)
                detail = f"not confirmed: {lost}"
            except WireDown as down:
                written = written or isinstance(down, NoAnswer) or await self._send_without_answer(p.SAFE_POWER_OFF)
                detail = f"not confirmed: {down}"
        return Outcome(written, acknowledged, detail), ""

    async def _give_back(self) -> str:
        """Give the lease (the right to command the body) back to the robot. Return the reason for a failure; empty
        after success, or if there is no lease."""
        if LEASE in self._faults:
            return f"{self._faults[LEASE]}, so it is not returned"
        try:
            return await self._lease.give_back()
        except WireDown as down:
            return f"the lease was not returned: {down}"

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot after its link was lost: by the open connections, then by a new one.

        On the open connections a command with our lease and our e-stop endpoint are used in
        parallel, because each may have to wait for the network. On the new connection only the
        e-stop endpoint is used.
        """
        self._is_armed = False
        sent = False
        if self.session_or_none is not None:

            async def by_lease() -> None:
                nonlocal sent
                sent = await self._send_without_answer(p.STOP if safe_state == SafeState.HOLD else p.SAFE_POWER_OFF)

            async with trio.open_nursery() as nursery:
                if safe_state != SafeState.OFF:
                    nursery.start_soon(by_lease)
                outcome = await stop_by_estop(self.session, self._estop, safe_state, ANSWER_S)
                if not outcome.detail:
                    # The e-stop has made the robot safe. The command with the lease is no longer needed.
                    nursery.cancel_scope.cancel()
            if not outcome.detail:
                return self._reports(outcome)
            # Keep the session object: a later stop uses its lease.
            self.session.close_in_order()
        session = SpotSession(self._config, self._clock, self._open_stream)
        try:
            await session.open(("estop", "robot-state"))
            estop = EstopEndpoint(session, self._config.estop_timeout_s)
            outcome = await stop_by_estop(session, estop, safe_state, SIT_S)
        except WireDown as down:
            outcome = Outcome(sent, False, str(down))
        finally:
            session.close_in_order()
        return self._reports(outcome)

    def _reports(self, outcome: Outcome, lease_failure: str = "", targets: Targets = ()) -> tuple[MotorReport, ...]:
        reports = outcome.reports(*names_of(self._config.axes), targets)
        if not lease_failure or outcome.detail:
            return reports
        return tuple(msgspec.structs.replace(report, detail=lease_failure) for report in reports)

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        if not self._is_armed:
            return robot_stopped()
        if service == "set_twist":
            return await self._set_twist(arguments, permit)
        return await self._stand(permit)

    async def _set_twist(self, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        speeds = {key: float(arguments.get(key, 0.0)) for key in BASE}
        command = p.together(p.twist(tuple(speeds.values()), self._time.in_ns(p.TWIST_S)))
        refusal = self._refusal("set_twist", await self._command(command, permit))
        return refusal or {"robot": self._config.robot, "twist": speeds, "ends_in_s": p.TWIST_S}

    async def _stand(self, permit: Permit) -> dict[str, Any] | Refused:
        refusal = await self._power_on(permit)
        if refusal is not None:
            return refusal
        refusal = self._refusal("stand", await self._command(p.stand(), permit))
        if refusal is not None:
            return refusal
        number = self._command_id
        with trio.move_on_after(STAND_UP_S):
            while not await is_standing(self.session, number):
                permit.check()
                await trio.sleep(LOOK_S)
            return {"standing": True}
        return refusals.not_standing(STAND_UP_S)

    async def _power_on(self, permit: Permit) -> Refused | None:
        session = self.session
        if (await read_state(session)).motors is p.Motors.ON:
            return None
        try:
            with self._end_link_on_failure():
                request = session.ask("PowerCommand", {"lease": self._lease.use(), "request": p.POWER_ON}, permit)
                answer = await session.answer(request)
            self._lease.check(answer)
        except LeaseLost as lost:
            self._store_owner(lost)
            return self._refusal("stand", p.Command.UNKNOWN)
        status = answer.get("status", 0)
        number = answer.get("power_command_id", 0)
        with trio.move_on_after(POWER_ON_S):
            while status == p.Power.IN_PROGRESS:
                permit.check()
                await trio.sleep(LOOK_S)
                status = await power_status(session, number)
            if status == p.Power.SUCCESS:
                return None
        return refusals.no_power(p.name_of(p.Power, status))

    # -- parts

    def _refusal(self, service: str, status: int) -> Refused | None:
        """Turn the status of a command into a refusal; None if the robot accepted the command."""
        if status == p.Command.OK:
            return None
        if LEASE in self._faults:
            return refusals.lease_lost_in_service(self._faults[LEASE])
        return refusals.rejected_command(p.name_of(p.Command, status))

    def _store_owner(self, lost: LeaseLost) -> None:
        """Store which client took the lease, because later answers do not name the client."""
        if lost.owner or LEASE not in self._faults:
            self._faults[LEASE] = str(lost)
