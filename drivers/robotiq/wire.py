"""Connect the wire process to the gripper's registers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.modbus import NotUnderstood
from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import NS, Clock

from . import protocol
from .client import ECHO_POLLS, POLL_S, GripperClient, hold
from .config import AXIS, RobotiqConfig
from .connect import OpenPort, OpenStream, open_gripper
from .gates import FORCE, POSITION, SPEED
from .protocol import Activation, Command, Contact, Status
from .tcp_client import ASK_AGAIN_S

READ_S = 0.03
"""How long one reading waits for its answer. The next reading continues the wait, so that the watchdog does not
miss the wire."""

FRESH_S = 2 * READ_S
"""Longest age of a status, two readings without an answer, at which the gripper still counts as activated. With
an older one its supply may have dipped, and any command with rACT set would activate it. A dip that is shorter
than this remains undetected."""

SOON_S = 0.02
"""How long to wait for an answer if the status is too old. A serial line, on which an open answer must arrive
first, needs a little more than twice as long. Both keep a stop within ``Driver.bound_s``."""

HANDSHAKE_S = 0.6
"""Timeout of the first answer. It is longer than a peer may be silent, so that one that accepts the connection
but never answers is reported as such."""

RESET_S = 1.0

_NAN = math.nan


class RobotiqSession:
    """The state that exists between ``open`` and ``close``."""

    def __init__(self, gripper: GripperClient, status: Status, now_ns: int) -> None:
        self.gripper = gripper
        self.status = status
        self.heard_ns = now_ns
        self.asked: int | None = None  # number of the reading without an answer
        self.asked_ns = 0
        self.told: int | None = None  # position in the last setpoint
        self.misses = 0  # consecutive readings that repeat another position


class RobotiqWire(SessionWire[RobotiqSession]):
    interruptible: ClassVar[bool] = True

    def __init__(
        self,
        config: RobotiqConfig,
        clock: Clock,
        open_stream: OpenStream = open_tcp,
        open_port: OpenPort = open_serial,
    ) -> None:
        self._config = config
        self._clock = clock
        self._open = partial(open_gripper, config, clock, open_stream, open_port)
        self._last: Status | None = None  # from the previous session, once it is closed

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self._config
        gripper = await self._open()
        try:
            status = await gripper.status(HANDSHAKE_S)
            if status is None:
                raise WireDown(
                    f"{config.robot} at {config.port}: connected, but no answer. Check unit_id= and its power"
                )
        except BaseException:
            gripper.close()
            raise
        self.session_or_none = RobotiqSession(gripper, status, self._clock.now_ns())
        speed = {"baud": config.baud} if config.serial else {}
        return {"port": config.port, **speed, "unit_id": config.unit_id, "stroke_mm": config.stroke_mm}

    async def arm(self, permit: Permit) -> Observation:
        session = self.session
        status = await self._ask(permit)
        if status.fault == protocol.RELEASING:
            raise WireDown(
                f"arm: the gripper reports {protocol.fault_words(status.fault)}. Wait until it has ended"
            )
        if status.needs_activation:
            status = await self._activate(permit)
        command = protocol.safe_command(status)
        await session.gripper.clear_way()
        permit.check()
        session.gripper.write(command)
        for _ in range(ECHO_POLLS):
            status = await self._ask(permit)
            if status.request == command.position and not status.going:
                break
            await trio.sleep(POLL_S)
        else:
            raise WireDown(
                f"arm: the gripper does not take its position as target ({status.request}, not "
                f"{command.position}). Try again; check who else writes to it"
            )
        session.told = None
        return self._observation(session)

    async def read(self) -> Observation:
        session = self.session
        now_ns = self._clock.now_ns()
        if session.asked is not None and now_ns - session.asked_ns > ASK_AGAIN_S * NS:
            session.gripper.forget(session.asked)
            session.asked = None
        if session.asked is None:
            session.asked, session.asked_ns = session.gripper.ask(), now_ns
        status = await session.gripper.answer(session.asked, READ_S)
        if status is not None:
            session.asked = None
            self._take_unless_reset(session, status, "read")
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not session.status.active:  # A setpoint would activate it.
            raise WireDown("write: the gripper is not activated. Activate it first")
        if not self._fresh(session):
            status = await self._soonest(session)
            if status is None:
                age_ms = (self._clock.now_ns() - session.heard_ns) / 1e6
                raise PermitDenied(f"the gripper is silent for {age_ms:.0f} ms")
            self._take_unless_reset(session, status, "write")
        position, speed, force = (protocol.counts_of(values[slot]) for slot in (POSITION, SPEED, FORCE))
        await session.gripper.clear_way()
        permit.check()
        session.gripper.write(Command(go_to=True, position=position, speed=speed, force=force))
        if session.told != position:
            session.told, session.misses = position, 0

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Hold the gripper. If the status is too old, ask first.

        A hold has rACT set, and would activate a gripper that was reset meanwhile. A gripper without an answer may
        have been reset, or may still move. It is reset, which stops it in the second case and does nothing in the
        first.
        """
        session = self.session_or_none
        if session is None:
            return (self._config.report(False, False, "not connected"),)
        session.told = None
        known: Status | None = session.status
        if not self._fresh(session):
            known = None
            with contextlib.suppress(WireDown):  # ``hold`` finds out whether it can be written to.
                known = await self._soonest(session)
        return (await hold(session.gripper, known or Status(), self._config),)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Hold the gripper on a new connection, and ask first: a gripper that has lost its power would be activated
        and move.

        A gripper with unreadable answers has power. It gets the safe command for its last valid status. A gripper
        without answers is reset, as in ``make_safe``.
        """
        self.close()  # This discards bytes that were sent on the old connection but not taken yet.
        if self._last is None:
            return ()
        report = await self._hold_anew(self._last)
        return (report or await self._hold_anew(None) or self._config.report(False, False, "silent"),)

    async def _hold_anew(self, known: Status | None) -> MotorReport | None:
        """Hold on a new connection.

        Args:
            known: The last valid status; None to reset the gripper without asking.

        Returns:
            The report; None if the connection was lost before the gripper answered.
        """
        try:
            gripper = await self._open()
        except WireDown as error:
            return self._config.report(False, False, str(error))
        try:
            if known is not None:
                with contextlib.suppress(NotUnderstood):
                    status = await gripper.status(READ_S)
                    if status is not None or not gripper.has_partial_answer:
                        known = status or Status()
            return await hold(gripper, known or Status(), self._config)
        except WireDown:
            return None
        finally:
            gripper.close()

    def handover(self) -> Sequence[int]:
        return () if self.session_or_none is None else self.session_or_none.gripper.descriptors

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.gripper.close()
            self._last = self.session_or_none.status
        self.session_or_none = None

    async def _activate(self, permit: Permit) -> Status:
        session = self.session
        if not self._config.activate:
            raise WireDown(
                f"arm: the gripper is not activated (gSTA {session.status.activation}, gFLT "
                f"{session.status.fault}), and activate= is False. Activating moves its fingers through their "
                "whole stroke"
            )
        await session.gripper.clear_way()
        permit.check()
        session.gripper.write(protocol.RESET)
        if await self._poll(permit, RESET_S, Activation.RESET) is None:
            raise WireDown("arm: the gripper does not take the reset. Check who else writes to it")
        await session.gripper.clear_way()
        permit.check()
        session.gripper.write(protocol.ACTIVATE)
        status = await self._poll(permit, protocol.ACTIVATION_S, Activation.ACTIVE)
        if status is None:
            raise WireDown(
                f"arm: the gripper did not finish its activation within {protocol.ACTIVATION_S:g} s (gSTA "
                f"{session.status.activation}, {protocol.fault_words(session.status.fault)}). "
                "Free its fingers and check its supply"
            )
        if status.fault >= protocol.MAJOR:
            raise WireDown(f"arm: activated, but {protocol.fault_words(status.fault)}. Check supply and fingers")
        return status

    async def _poll(self, permit: Permit, within_s: float, activation: Activation) -> Status | None:
        """Return the first status with this gSTA; None after the timeout."""
        with trio.move_on_after(within_s):
            while True:
                status = await self._ask(permit)
                if status.activation == activation:
                    return status
                await trio.sleep(POLL_S)
        return None

    async def _ask(self, permit: Permit) -> Status:
        """Wait for a status. Raise ``WireDown``."""
        session = self.session
        status = await session.gripper.status(HANDSHAKE_S, permit)
        if status is None:
            raise WireDown("arm: the gripper does not answer. Check its power")
        self._take(session, status)
        return status

    def _fresh(self, session: RobotiqSession) -> bool:
        """Return whether the status is new enough to rely on the gripper being active."""
        return self._clock.now_ns() - session.heard_ns <= FRESH_S * NS

    async def _soonest(self, session: RobotiqSession) -> Status | None:
        """Ask for a status because the last one is too old. Return None without an answer within ``SOON_S``. Raise
        ``WireDown``."""
        owed, session.asked = session.asked, None
        return await session.gripper.soonest(owed, SOON_S)

    def _take_unless_reset(self, session: RobotiqSession, status: Status, when: str) -> None:
        """Take a status. Raise ``WireDown`` if the gripper is no longer active: earlier decisions were made for
        another state."""
        was_active = session.status.active
        self._take(session, status)
        if was_active and not status.active:
            raise WireDown(
                f"{when}: the gripper is no longer activated (gSTA {status.activation}). Was its power cut? "
                "A stop to which it does not answer resets it, too"
            )

    def _take(self, session: RobotiqSession, status: Status) -> None:
        session.status = status
        session.heard_ns = self._clock.now_ns()
        session.misses = 0 if session.told in (None, status.request) else session.misses + 1

    def _observation(self, session: RobotiqSession) -> Observation:
        status = session.status
        # Without rGTO gOBJ has no meaning. Before the echo it belongs to the previous command.
        believed = status.active and status.going and session.told in (None, status.request)
        closed = status.position / protocol.TOP
        faults = [protocol.fault_words(status.fault)] if status.fault else []
        if session.misses >= ECHO_POLLS:
            faults.append(f"unconfirmed: asked for {session.told}, it repeats {status.request}")
        return Observation(
            t_ns=session.heard_ns,
            position=(closed,),
            stamp_ns=(session.heard_ns,),
            sensors={
                "aperture_mm": (self._config.aperture_mm(closed),),
                "current_a": (status.current * protocol.CURRENT_A,),
                "moving": (float(status.contact == Contact.MOVING) if believed else _NAN,),
                "contact": (_CONTACT[Contact(status.contact)] if believed else _NAN,),
                "activation": (float(status.activation),),
                "fault": (float(status.fault),),
            },
            faults={AXIS: ", ".join(faults)} if faults else {},
        )


_CONTACT = {Contact.MOVING: _NAN, Contact.OPENING: -1.0, Contact.CLOSING: 1.0, Contact.ARRIVED: 0.0}
"""Values of the sensor ``contact``: met while opening, met while closing, no object. It is unknown while the
fingers move."""
