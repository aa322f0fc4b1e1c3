"""Access a gripper's registers on one connection, and hold the gripper.

The wire and the root's stop channel share this code. The transports are ``tcp_client`` and ``serial_client``;
``connect`` opens one of the two.
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
"""Limit of all attempts. With a connection, they fit into the time limit of a stop (``Timing.safe_s``)."""

POLL_S = 0.05
ECHO_POLLS = 2
"""Number of polls after which the gripper repeats a command [assumed; no manual has a number]. Before that, its
bits for motion and object belong to the previous command."""


class GripperClient(ABC):
    """One gripper on one connection: its registers as ``Command`` and ``Status``. Methods that fail raise
    ``WireDown``."""

    descriptors: Sequence[int] = ()
    """Descriptors with which the root's stop channel may continue."""

    @abstractmethod
    async def clear_way(self) -> None:
        """Wait until the line is free for the next write, at most for one answer."""

    @abstractmethod
    def write(self, command: Command) -> None:
        """Send a command at once."""

    @abstractmethod
    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        """Request the status until an answer arrives. Return None after the timeout. ``permit`` is checked during
        the wait."""

    @abstractmethod
    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Request the status, and return the first answer to this or to the open request ``number``.

        Return None if neither arrives in time. Both requests are forgotten afterwards.
        """

    @abstractmethod
    def ask(self) -> int:
        """Request the status without waiting. Return a number for ``answer`` or ``forget``."""

    @abstractmethod
    async def answer(self, number: int, within_s: float) -> Status | None:
        """Wait for the answer to a request. Return None if it has not arrived yet."""

    @abstractmethod
    def forget(self, number: int) -> None:
        """Discard the answer to a request. It may still arrive."""

    @property
    @abstractmethod
    def has_partial_answer(self) -> bool:
        """Whether an answer has arrived in part only."""

    @abstractmethod
    def close(self) -> None: ...


async def hold(gripper: GripperClient, known: Status | None, config: RobotiqConfig) -> MotorReport:
    """Stop the fingers where they are, and confirm it. Never raises.

    Without a ``known`` status the gripper is asked first. A hold would activate a gripper that is not active, and
    that moves its fingers. A gripper that does not answer within ``CONFIRM_S`` is reset.
    """
    written = answered = False
    detail = "silent"
    command: Command | None = None
    try:
        with trio.move_on_after(HOLD_S):
            for _ in range(ATTEMPTS):
                # A gripper without an answer is reset. That stops it, and does not move one that was reset before.
                known = known or await gripper.status(CONFIRM_S) or Status()
                # Stay with a reset: if it was not taken yet, a hold after it would be a rising edge of rACT.
                if command is None or command.activate:
                    command = protocol.safe_command(known)
                await gripper.clear_way()
                gripper.write(command)
                written = True
                for poll in range(ECHO_POLLS):
                    if poll:
                        await trio.sleep(POLL_S)
                    known = await gripper.status(CONFIRM_S)
                    if known is None:
                        detail = "silent"
                        break
                    answered = True
                    detail = protocol.unsafe_words(known, command)
                    if not detail:
                        return config.report(written, answered, detail)
                    if command.activate and not protocol.safe_command(known).activate:
                        break  # An activation is running, and only a reset ends it.
    except WireDown as error:
        detail = str(error)
    return config.report(written, answered, detail)
