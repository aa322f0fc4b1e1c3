"""The wire of a Spot, in the wire process.

The wire sends nothing twice, and nothing by itself. A twist ends on the robot's clock. The check-ins of
our e-stop endpoint leave only while gate and transport reply (``feed``). Each command uses a newer lease
than the previous one, so that the robot refuses a command that arrives late, after a stop.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome, names_of
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.spot.refusals import SpotCode
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import protocol as p
from .config import SAFE_S, SpotConfig
from .control import (
    NOTHING_SINCE,
    BodyLease,
    EstopEndpoint,
    FreshState,
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
from .session import ANSWER_S, Asked, NoAnswer, OpenStream, SpotSession
from .stopping import LOOK_S, reason_not_off, stop_by_estop

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
        self._given_up = ""  # why a command failed that the robot may still carry out

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
        self._faults, self._given_up = {}, ""
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
        """Return an observation. Its age counts from the change of the robot's stamp, so an answer that
        repeats the stamp is not new."""
        session, before = self.session, self._reading
        if self._given_up:
            raise WireDown(self._given_up)
        try:
            self._reading = await read_state(session)
            if before is None or self._reading.stamp_ns != before.stamp_ns:
                self._read_ns = self._clock.now_ns()
        except NoAnswer:
            if before is None or self._silent_s() > self._config.silent_s:
                raise
        if self._silent_s() > self._config.silent_s:
            raise WireDown(
                f"robot state: what it reports stands still for {self._silent_s():.1f} s. Check the robot"
            )
        assert self._reading is not None
        return observe(self._reading, self._read_ns, self._faults)

    def _silent_s(self) -> float:
        return (self._clock.now_ns() - self._read_ns) / NS

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Renew the token and the robot's clock beside the other calls. Either may take longer than a call,
        and the old values stay valid for a while."""
        session = self.session
        task_status.started()
        while True:
            await session.renew()
            await self._time.renew()
            await trio.sleep(RENEW_LOOK_S)

    async def feed(self) -> None:
        """Check in at a third of the endpoint's timeout, and show that the lease is in use."""
        _ = self.session  # raises without a session
        now_ns = self._clock.now_ns()
        with contextlib.suppress(NoAnswer):  # ``read`` judges how long the robot may be silent.
            if self._estop.level is p.StopLevel.NONE and now_ns - self._checked_in_ns >= self._check_in_ns:
                await self._check_in(now_ns)
            if self._lease.is_held and now_ns - self._retained_ns >= RETAIN_S * NS:
                self._retained_ns = now_ns
                try:
                    await self._lease.retain()
                except LeaseLost as lost:
                    self._note(lost)

    async def _check_in(self, now_ns: int) -> None:
        """Check in, unless the timeout has passed. A later check-in would lift the e-stop that the robot
        has asserted by then."""
        late_s = (now_ns - self._checked_in_ns) / NS
        if late_s >= self._config.estop_timeout_s:
            self._estop.level = p.StopLevel.SETTLE_THEN_CUT
            self._faults[ESTOP] = f"a check-in of our e-stop endpoint was {late_s:.1f} s late"
            return
        if await self._estop.check_in(p.StopLevel.NONE):
            self._checked_in_ns = now_ns
        else:
            self._faults[ESTOP] = "the robot's e-stop was set up anew by somebody else"

    @property
    def _check_in_ns(self) -> int:
        """Period of check-ins: a third of the timeout, less one period of the tree. ``feed`` is called in
        such periods."""
        return round((self._config.estop_timeout_s / 3 - 0.1) * NS)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.close()
        self.session_or_none = self._reading = None
        self._is_armed = False

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Take the lease, and set up an e-stop endpoint that lets the robot be powered. Motors keep their
        power state."""
        if not self._lease.is_held:
            await self._lease.acquire()
            self._faults.pop(LEASE, None)
        if not self._estop.is_known:
            await self._set_up_estop()
        permit.check()
        if not await self._estop.check_in(p.StopLevel.NONE, permit):
            raise WireDown("arm: the robot does not know our e-stop endpoint any more. Call resume() again")
        self._faults.pop(ESTOP, None)
        self._checked_in_ns = self._clock.now_ns()
        await self._until_released()
        permit.check()
        self._is_armed = True
        self._faults.pop(COMMAND, None)
        return await self.read()

    async def _set_up_estop(self) -> None:
        """Set up our e-stop endpoint.

        Raises:
            WireDown: The robot refuses, so another client drives it. Our lease is given back for that
                client.
        """
        try:
            await self._estop.set_up()
        except WireDown:
            with contextlib.suppress(WireDown):
                await self._lease.give_back()
            raise

    async def _until_released(self) -> None:
        """Read back that our endpoint is in force and no e-stop is pressed. Raise ``WireDown``."""
        why = "it has not said"
        with trio.move_on_after(RELEASED_S):
            while True:
                pressed = (await read_state(self.session)).pressed
                why = ", ".join(pressed) or await self._estop.read_back()
                if not why:
                    return
                await trio.sleep(LOOK_S)
        raise WireDown(f"arm: the robot is E-stopped ({why}). Release it first")

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        if not self._is_armed:
            raise PermitDenied("it was made safe since")
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
        with self._or_give_up():
            try:
                status = await self._commanded(command, permit)
            except LeaseLost as lost:
                self._note(lost)
                return p.Command.UNKNOWN
            if status == p.Command.NO_TIMESYNC:
                raise WireDown("time sync: the robot's clock was set anew. Reconnect")
        if status == p.Command.OK:
            self._faults.pop(COMMAND, None)
        else:
            self._faults[COMMAND] = f"the last command was refused: {p.name_of(p.Command, status)}"
        return status

    @contextlib.contextmanager
    def _or_give_up(self) -> Iterator[None]:
        """Note a failed service, so that the next ``read`` ends the link. The robot is then settled,
        whether or not it carries out the command."""
        try:
            yield
        except WireDown as down:
            self._given_up = str(down)
            raise

    async def _commanded(self, command: Message, permit: Permit | None) -> int:
        answer = await self.session.answer(self._send(command, permit))
        if not self._lease.check(answer):
            return p.Command.UNKNOWN
        self._command_id = answer.get("robot_command_id", 0)
        status: int = answer.get("status", 0)
        return status

    def _send(self, command: Message, permit: Permit | None) -> Asked:
        """Send a command with the next use of the lease. Raise ``LeaseLost`` or ``WireDown``."""
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
        outcome, returned = Outcome(False, False, "it cannot be told by its lease"), ""
        if safe_state != SafeState.OFF:
            outcome, returned = await self._sit()
        if outcome.detail:
            session = self.session
            by_estop = await stop_by_estop(session, self._estop, safe_state, SAFE_S - MARGIN_S - SIT_S)
            written = outcome.written or by_estop.written
            outcome = Outcome(written, outcome.acknowledged or by_estop.acknowledged, by_estop.detail)
            returned = await self._give_back() if not outcome.detail else ""
        return self._reports(outcome, returned)

    async def _hold(self) -> tuple[MotorReport, ...]:
        """Command the robot to stand still, and read back that it does.

        If another client has the lease, this program does not move the robot any more. If no client has
        it, the robot can only be observed.
        """
        written = acknowledged = is_nobodys = False
        detail, fresh = "silent", FreshState(self.session)
        with trio.move_on_after(HOLD_S):
            while True:
                had = self._lease.is_held
                try:
                    if not (acknowledged or is_nobodys):
                        status = await self._commanded(p.STOP, None)
                        written = True
                        acknowledged = status in (p.Command.OK, p.Command.NOT_POWERED_ON)
                        detail = f"not confirmed: a stop is answered with {p.name_of(p.Command, status)}"
                    if acknowledged or is_nobodys:
                        detail, targets = await self._why_moving(fresh)
                        if not detail:
                            return self._reports(Outcome(written, True, ""), targets=targets)
                except LeaseLost as lost:
                    written = written or had
                    if self._lease.was_taken:
                        self._note(lost)
                    if lost.owner or not self._lease.was_taken:
                        return self._reports(Outcome(written, True, ""))
                    is_nobodys, detail = True, f"not confirmed: {lost}"
                except WireDown as down:
                    written = written or isinstance(down, NoAnswer) or await self._send_without_answer(p.STOP)
                    detail = f"not confirmed: {down}"
                await trio.sleep(LOOK_S)
        return self._reports(Outcome(written, acknowledged, detail))

    async def _send_without_answer(self, command: Message) -> bool:
        """Send a command with our lease on a new connection, without waiting for an answer.

        Damaged answers end a connection, and the robot may understand us all the same.

        Returns:
            True if the command was sent.
        """
        session = self.session_or_none
        if session is None or not self._lease.is_held:
            return False
        try:
            await session.connect_without_answer("robot-command")
            self._send(command, None)
        except WireDown:  # The report shows that the stop is not confirmed.
            return False
        return True

    async def _why_moving(self, fresh: FreshState) -> tuple[str, Targets]:
        """Return why the robot does not stand still, empty if it does, and its held position.

        Motors that are being powered on are switched off again. Raise ``LeaseLost`` or ``WireDown``.
        """
        reading = await fresh.read()
        if reading is None:
            return NOTHING_SINCE, ()
        if reading.motors is p.Motors.POWERING_ON:
            session = self.session
            asked = session.ask("PowerCommand", {"lease": self._lease.use(), "request": p.POWER_OFF})
            self._lease.check(await session.answer(asked))
            return "not confirmed: its motors are being powered on", ()
        detail = reason_moving(reading)
        return detail, () if detail else held_at(reading)

    async def _sit(self) -> tuple[Outcome, str]:
        """Let the robot sit, switch motors off, and return the lease.

        Returns:
            The outcome, and why the lease was not returned; empty if it was.
        """
        written = acknowledged = False
        detail = "silent"
        with trio.move_on_after(SIT_S):
            try:
                status = await self._commanded(p.SAFE_POWER_OFF, None)
                written = True
                if status not in (p.Command.OK, p.Command.NOT_POWERED_ON):
                    return Outcome(True, False, f"not confirmed: {p.name_of(p.Command, status)}"), ""
                acknowledged = True
                fresh = FreshState(self.session)
                while True:
                    detail = reason_not_off(await fresh.read())
                    if not detail:
                        break
                    await trio.sleep(LOOK_S)
                # From here on ``feed`` checks in no more.
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
        """Return the lease to the robot. The result says why that failed; empty if it did not, or if there
        is no lease."""
        if LEASE in self._faults:
            return f"{self._faults[LEASE]}: it is not returned"
        try:
            return await self._lease.give_back()
        except WireDown as down:
            return f"the lease was not returned: {down}"

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop by the open connections, then by a new one.

        On the open ones, a command with our lease and our e-stop endpoint run in parallel, since each may
        have to wait for the network. On the new one only the endpoint is used.
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
                    nursery.cancel_scope.cancel()  # The robot is safe without the command by lease.
            if not outcome.detail:
                return self._reports(outcome)
            self.session.close_in_order()  # The session is kept: a later stop uses its lease.
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

    def _reports(self, outcome: Outcome, returned: str = "", targets: Targets = ()) -> tuple[MotorReport, ...]:
        reports = outcome.reports(*names_of(self._config.axes), targets)
        if not returned or outcome.detail:
            return reports
        return tuple(msgspec.structs.replace(one, detail=returned) for one in reports)

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        if not self._is_armed:
            return Refused(Code.DISARMED, "the robot was stopped", "call resume() first")
        if service == "set_twist":
            return await self._set_twist(arguments, permit)
        return await self._stand(permit)

    async def _set_twist(self, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        speeds = {key: float(arguments.get(key, 0.0)) for key in BASE}
        command = p.together(p.twist(tuple(speeds.values()), self._time.in_ns(p.TWIST_S)))
        refused = self._refused("set_twist", await self._command(command, permit))
        return refused or {"robot": self._config.robot, "twist": speeds, "ends_in_s": p.TWIST_S}

    async def _stand(self, permit: Permit) -> dict[str, Any] | Refused:
        refused = await self._power_on(permit)
        if refused is not None:
            return refused
        refused = self._refused("stand", await self._command(p.stand(), permit))
        if refused is not None:
            return refused
        number = self._command_id
        with trio.move_on_after(STAND_UP_S):
            while not await is_standing(self.session, number):
                permit.check()
                await trio.sleep(LOOK_S)
            return {"standing": True}
        return Refused(SpotCode.NOT_STANDING, f"it does not stand after {STAND_UP_S:g} s", "look at the robot")

    async def _power_on(self, permit: Permit) -> Refused | None:
        session = self.session
        if (await read_state(session)).motors is p.Motors.ON:
            return None
        try:
            with self._or_give_up():
                asked = session.ask("PowerCommand", {"lease": self._lease.use(), "request": p.POWER_ON}, permit)
                answer = await session.answer(asked)
            self._lease.check(answer)
        except LeaseLost as lost:
            self._note(lost)
            return self._refused("stand", p.Command.UNKNOWN)
        status = answer.get("status", 0)
        number = answer.get("power_command_id", 0)
        with trio.move_on_after(POWER_ON_S):
            while status == p.Power.IN_PROGRESS:
                permit.check()
                await trio.sleep(LOOK_S)
                status = await power_status(session, number)
            if status == p.Power.SUCCESS:
                return None
        why = p.name_of(p.Power, status)
        return Refused(SpotCode.NO_POWER, f"its motors are not powered on: {why}", "look at the robot", why)

    # -- parts

    def _refused(self, service: str, status: int) -> Refused | None:
        """Return the robot's refusal of a command; None if it accepted it."""
        if status == p.Command.OK:
            return None
        if LEASE in self._faults:
            return Refused(SpotCode.LEASE_LOST, self._faults[LEASE], "let its owner return it, then resume()")
        why = p.name_of(p.Command, status)
        return Refused(Code.ROBOT, f"the robot refuses it: {why}", "look at the robot", why)

    def _note(self, lost: LeaseLost) -> None:
        """Note the client that took the lease. Later answers do not name it."""
        if lost.owner or LEASE not in self._faults:
            self._faults[LEASE] = str(lost)
