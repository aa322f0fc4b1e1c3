"""Access the registers of a gripper, and stop its fingers (``hold``).

The wire process and the stop channel of the supervising process (root) share this code. A client uses TCP
(``tcp_client``) or a serial port (``serial_client``). ``connect`` opens the right one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import trio

from strands_actors.contract.wire import MotorReport, Permit, WireDown

from . import protocol
from .config import RobotiqConfig
from .protocol import Command, Status

ATTEMPTS = 3
CONFIRM_S = 0.25
"""Longest wait for one answer."""
HOLD_S = ATTEMPTS * CONFIRM_S
"""Time limit for all attempts. Together with the time to connect it is below the limit of a stop
(``Timing.safe_s``)."""

POLL_S = 0.05
ECHO_POLLS = 2
"""Number of status readings after which a gripper repeats (echoes) the values of a new command [assumed; the
manuals do not say it]. Until then its status bits for motion and object still belong to the previous command."""


class GripperClient(ABC):
    """Write commands to a gripper and read its status, on one connection. Methods that fail raise ``WireDown``."""

    descriptors: Sequence[int] = ()
    """File descriptors that the stop channel of the root process may also use."""

    @abstractmethod
    async def wait_until_ready(self) -> None:
        """Wait until the next command can be sent. On a serial line an answer may have to arrive first."""

    @abstractmethod
    def write(self, command: Command) -> None:
        """Send a command to the gripper without waiting."""

    @abstractmethod
    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        """Request the status again and again until an answer arrives. Return None after ``within_s`` seconds.

        ``permit`` (the right to send) is checked before each request. If it is no longer valid, this raises
        ``PermitDenied``.
        """

    @abstractmethod
    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Request the status. Return the first answer to this request or to an earlier one, ``number``.

        Return None if neither is answered in time. Later answers to both requests are discarded.
        """

    @abstractmethod
    def ask(self) -> int:
        """Request the status without waiting. Return the request's number, for ``answer`` or ``forget``."""

    @abstractmethod
    async def answer(self, number: int, within_s: float) -> Status | None:
        """Wait for the answer to a status request. Return None if it does not arrive within ``within_s``
        seconds."""

    @abstractmethod
    def forget(self, number: int) -> None:
        """Discard the answer to a status request, even if it arrives later."""

    @property
    @abstractmethod
    def has_partial_answer(self) -> bool:
        """True if only a part of an answer has arrived, or an answer that cannot be decoded."""

    @abstractmethod
    def close(self) -> None: ...


async def hold(gripper: GripperClient, last_status: Status | None, config: RobotiqConfig) -> MotorReport:
    """Stop the fingers where they are, and confirm this by the status. Never raises.

    A hold command has the activation bit set. A gripper that is not active would therefore begin its activation,
    which moves the fingers. So the status is read first, unless the caller passes it as ``last_status``. If the
    gripper does not answer within ``CONFIRM_S``, a reset is sent instead, which stops the fingers, too.
    """
    written = answered = False
    detail = "silent"
    command: Command | None = None
    try:
        with trio.move_on_after(HOLD_S):
            for _ in range(ATTEMPTS):
                # Without an answer, send a reset (the command for the empty status). It stops a gripper that moves,
                # and changes nothing if the gripper was already reset.
                last_status = last_status or await _settled_status(gripper) or Status()
                # After a reset send only resets. A hold after a reset would set the bit rACT again, and that would
                # start an activation.
                if command is None or command.activate:
                    command = protocol.safe_command(last_status)
                await gripper.wait_until_ready()
                gripper.write(command)
                written = True
                for poll in range(ECHO_POLLS):
                    if poll:
                        await trio.sleep(POLL_S)
                    last_status = await gripper.status(CONFIRM_S)
                    if last_status is None:
                        detail = "silent"
                        break
                    answered = True
                    detail = protocol.unsafe_words(last_status, command)
                    if not detail:
                        return config.report(written, answered, detail)
                    if command.activate and not protocol.safe_command(last_status).activate:
                        break  # An activation is running. Only a reset ends it, so try again with a reset.
    except WireDown as error:
        detail = str(error)
    return config.report(written, answered, detail)


async def _settled_status(gripper: GripperClient) -> Status | None:
    """Read the status twice, and return the second; None if the gripper does not answer.

    After a pause the gripper reads what waits on all its connections, in any order. So a reset on another
    connection may follow the first answer, and a hold after that reset would activate the gripper. The second
    request is read after everything that waited.
    """
    if await gripper.status(CONFIRM_S) is None:
        return None
    return await gripper.status(CONFIRM_S)
