"""Connect the wire process (the only writer to the robot) to a gripper: activate it, read it, write setpoints."""

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
"""Longest wait for an answer in one ``read``. The next ``read`` continues the wait. So ``read`` returns often
enough for the watchdog of this process."""

FRESH_S = 2 * READ_S
"""If the status is older than this (two readings without an answer), the gripper may have lost its power meanwhile.
Then a command with the bit rACT set would activate it. A shorter loss of power is not detected."""

SOON_S = 0.02
"""How long to wait for a new status if the last one is too old. On a serial line this takes a little more than
twice as long, because an earlier answer must arrive first. In both cases a stop stays within ``Driver.bound_s``."""

HANDSHAKE_S = 0.6
"""Timeout of the first answer. It is longer than the timeout for a silent peer, so that a peer that accepts the
connection but never answers is reported as silent."""

RESET_S = 1.0

_NAN = math.nan


class RobotiqSession:
    """One connection to the gripper, from ``open`` to ``close``, with its last status and setpoint."""

    def __init__(self, gripper: GripperClient, status: Status, now_ns: int) -> None:
        self.gripper = gripper
        self.status = status
        self.last_received_ns = now_ns
        self.pending_request: int | None = None  # Number of the status request that has no answer yet.
        self.requested_ns = 0
        self.sent_position: int | None = None  # Position in the last setpoint, in register counts.
        self.misses = 0  # Number of consecutive readings that do not repeat the position of the last setpoint.
        self.has_unanswered_stop = False  # The last stop was sent, and the gripper did not answer.


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
        self._last: Status | None = None  # Last status of the previous connection, after it was closed.

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self._config
        gripper = await self._open()
        try:
            status = await gripper.status(HANDSHAKE_S)
            if status is None:
                raise WireDown(
                    f"{config.robot} at {config.port}: connected, but the gripper does not answer. "
                    "Check unit_id= and its power"
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
                f"arming: the gripper reports {protocol.fault_words(status.fault)}. "
                "Wait until the release has ended"
            )
        if status.needs_activation:
            status = await self._activate(permit)
        command = protocol.safe_command(status)
        await session.gripper.wait_until_ready()
        permit.check()
        session.gripper.write(command)
        for _ in range(ECHO_POLLS):
            status = await self._ask(permit)
            if status.request == command.position and not status.going:
                break
            await trio.sleep(POLL_S)
        else:
            raise WireDown(
                f"arming: the gripper does not confirm the hold (sent {command.position}, it repeats "
                f"{status.request}). Check whether another program writes to it, then try again"
            )
        session.sent_position, session.has_unanswered_stop = None, False
        return self._observation(session)

    async def read(self) -> Observation:
        session = self.session
        now_ns = self._clock.now_ns()
        if session.pending_request is not None and now_ns - session.requested_ns > ASK_AGAIN_S * NS:
            session.gripper.forget(session.pending_request)
            session.pending_request = None
        if session.pending_request is None:
            session.pending_request, session.requested_ns = session.gripper.ask(), now_ns
        status = await session.gripper.answer(session.pending_request, READ_S)
        if status is not None:
            session.pending_request = None
            self._take_unless_reset(session, status, "read")
        return self._observation(session)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not session.status.active:  # A setpoint would activate the gripper, which moves its fingers.
            raise WireDown("write: the gripper is not activated. Call stop(), then resume()")
        if not self._fresh(session):
            status = await self._soonest(session)
            if status is None:
                age_ms = (self._clock.now_ns() - session.last_received_ns) / 1e6
                raise PermitDenied(f"the gripper has not answered for {age_ms:.0f} ms")
            self._take_unless_reset(session, status, "write")
        position, speed, force = (protocol.counts_of(values[slot]) for slot in (POSITION, SPEED, FORCE))
        await session.gripper.wait_until_ready()
        permit.check()
        session.gripper.write(Command(go_to=True, position=position, speed=speed, force=force))
        if session.sent_position != position:
            session.sent_position, session.misses = position, 0

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Hold the gripper. If the last status is too old, read it first.

        A hold command has the bit rACT set. If the gripper was reset meanwhile, a hold would activate it, and the
        fingers would move. If it does not answer, a reset is sent instead. A reset stops moving fingers, and does
        nothing to a gripper that was already reset.
        """
        session = self.session_or_none
        if session is None:
            return (self._config.report(False, False, "not connected"),)
        session.sent_position = None
        last_status: Status | None = session.status
        if not self._fresh(session):
            last_status = None
            with contextlib.suppress(WireDown):  # If the connection is lost, ``hold`` below reports it.
                last_status = await self._soonest(session)
        report = await hold(session.gripper, last_status or Status(), self._config)
        session.has_unanswered_stop = report.written and not report.safe
        return (report,)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the gripper on the old connection, which may still carry commands to it, and hold it on a new one,
        after reading its status there.

        Without the status, a hold would activate a gripper that has lost its power, and the fingers would move. If
        the gripper's answers are unreadable, it has power, and the command for its last valid status is sent. If it
        does not answer, a reset is sent, as in ``make_safe``.

        A gripper that has not answered a stop on the old connection may carry out a reset at any moment. A hold on
        the new connection would then activate it again, so only resets are sent there.
        """
        session = self.session_or_none
        resets_only = session is not None and await self._stop_unanswered(session)
        self.close()  # This discards bytes on the old connection that were not sent to the gripper yet.
        if self._last is None:
            return ()
        report = None if resets_only else await self._hold_anew(self._last)
        return (report or await self._hold_anew(None) or self._config.report(False, False, "silent"),)

    async def _stop_unanswered(self, session: RobotiqSession) -> bool:
        """Send a stop on a connection that is given up, and wait up to ``SOON_S`` for an answer.

        Return True if the gripper may still carry out a reset that it has not answered.
        """
        command = protocol.safe_command(session.status if self._fresh(session) else Status())
        answered = False
        with contextlib.suppress(WireDown), trio.move_on_after(SOON_S):
            await session.gripper.wait_until_ready()
            session.gripper.write(command)
            session.has_unanswered_stop = session.has_unanswered_stop or not command.activate
            answered = await session.gripper.status(SOON_S) is not None
        return session.has_unanswered_stop and not answered

    async def _hold_anew(self, last_status: Status | None) -> MotorReport | None:
        """Open a new connection and hold the gripper on it.

        Args:
            last_status: The last valid status. None: send a reset without reading the status.

        Returns:
            The report on the stop. None if the connection was lost before the gripper answered.
        """
        try:
            gripper = await self._open()
        except WireDown as error:
            return self._config.report(False, False, str(error))
        try:
            if last_status is not None:
                with contextlib.suppress(NotUnderstood):
                    status = await gripper.status(READ_S)
                    if status is not None or not gripper.has_partial_answer:
                        last_status = status
            # If a reset is sent, the last valid status is out of date, and must not lead to a hold later.
            self._last = last_status or Status()
            return await hold(gripper, self._last, self._config)
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
                f"arming: the gripper is not activated (gSTA {session.status.activation}, gFLT "
                f"{session.status.fault}), and activate= is False. Activating moves its fingers through their "
                "whole stroke"
            )
        await session.gripper.wait_until_ready()
        permit.check()
        session.gripper.write(protocol.RESET)
        if await self._poll(permit, RESET_S, Activation.RESET) is None:
            raise WireDown(
                "arming: the gripper does not carry out the reset. Check whether another program writes to it"
            )
        await session.gripper.wait_until_ready()
        permit.check()
        session.gripper.write(protocol.ACTIVATE)
        status = await self._poll(permit, protocol.ACTIVATION_S, Activation.ACTIVE)
        if status is None:
            raise WireDown(
                f"arming: the gripper did not finish its activation within {protocol.ACTIVATION_S:g} s (gSTA "
                f"{session.status.activation}, {protocol.fault_words(session.status.fault)}). "
                "Free its fingers and check its power supply"
            )
        if status.fault >= protocol.MAJOR:
            raise WireDown(
                f"arming: the gripper is activated, but reports {protocol.fault_words(status.fault)}. "
                "Check its power supply and its fingers"
            )
        return status

    async def _poll(self, permit: Permit, within_s: float, activation: Activation) -> Status | None:
        """Read the status until it has this activation state (gSTA). Return None after ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            while True:
                status = await self._ask(permit)
                if status.activation == activation:
                    return status
                await trio.sleep(POLL_S)
        return None

    async def _ask(self, permit: Permit) -> Status:
        """Read and store the status. Raise ``WireDown`` if the gripper does not answer."""
        session = self.session
        status = await session.gripper.status(HANDSHAKE_S, permit)
        if status is None:
            raise WireDown("arming: the gripper does not answer. Check its power")
        self._take(session, status)
        return status

    def _fresh(self, session: RobotiqSession) -> bool:
        """Return True if the last status is so new that the gripper cannot have lost its power since."""
        return self._clock.now_ns() - session.last_received_ns <= FRESH_S * NS

    async def _soonest(self, session: RobotiqSession) -> Status | None:
        """Read the status again because the last one is too old.

        Return None if no answer arrives within ``SOON_S``. Raise ``WireDown`` if the connection is lost.
        """
        earlier_request, session.pending_request = session.pending_request, None
        return await session.gripper.soonest(earlier_request, SOON_S)

    def _take_unless_reset(self, session: RobotiqSession, status: Status, when: str) -> None:
        """Store a status. Raise ``WireDown`` if the gripper was active before and is not active any more."""
        was_active = session.status.active
        self._take(session, status)
        if was_active and not status.active:
            raise WireDown(
                f"{when}: the gripper is no longer activated (gSTA {status.activation}). It has lost its power, or "
                "it did not answer during a stop and was reset. Check its power, then call resume()"
            )

    def _take(self, session: RobotiqSession, status: Status) -> None:
        session.status = status
        session.last_received_ns = self._clock.now_ns()
        session.misses = 0 if session.sent_position in (None, status.request) else session.misses + 1

    def _observation(self, session: RobotiqSession) -> Observation:
        status = session.status
        # The contact state (gOBJ) is valid only with rGTO set, and only once the status repeats the last position.
        # Before that it belongs to the previous command.
        contact_is_valid = status.active and status.going and session.sent_position in (None, status.request)
        closed = status.position / protocol.TOP
        faults = [protocol.fault_words(status.fault)] if status.fault else []
        if session.misses >= ECHO_POLLS:
            faults.append(f"unconfirmed: sent {session.sent_position}, it repeats {status.request}")
        return Observation(
            t_ns=session.last_received_ns,
            position=(closed,),
            stamp_ns=(session.last_received_ns,),
            sensors={
                "aperture_mm": (self._config.aperture_mm(closed),),
                "current_a": (status.current * protocol.CURRENT_A,),
                "moving": (float(status.contact == Contact.MOVING) if contact_is_valid else _NAN,),
                "contact": (protocol.CONTACTS[Contact(status.contact)] if contact_is_valid else _NAN,),
                "activation": (float(status.activation),),
                "fault": (float(status.fault),),
            },
            faults={AXIS: ", ".join(faults)} if faults else {},
        )
