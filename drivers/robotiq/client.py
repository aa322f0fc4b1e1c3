"""A gripper's registers over one connection, and how it is made to hold. Shared by the wire and by
the root's stop channel. What carries them: ``tcp_client``, ``serial_client``; one of the two is
opened by ``connect``."""

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
"""Of all attempts: these, and a connection, fit into what a stop may take (``Timing.safe_s``)."""

POLL_S = 0.05
ECHO_POLLS = 2
"""By then the gripper repeats what it was told [assumed; no manual has a number]; before, what it
says of going and of objects is about the past."""


class GripperClient(ABC):
    """One gripper on one connection: its registers as ``Command`` and ``Status``. What raises,
    raises ``WireDown``."""

    descriptors: Sequence[int] = ()
    """What the root's stop channel may go on with."""

    @abstractmethod
    async def clear_way(self) -> None:
        """Wait until what is written next meets nothing on its way: at most for one answer."""

    @abstractmethod
    def write(self, command: Command) -> None:
        """Send at once."""

    @abstractmethod
    async def status(self, within_s: float, permit: Permit | None = None) -> Status | None:
        """Ask, until there is an answer. None: not in time. ``permit`` is checked meanwhile."""

    @abstractmethod
    async def soonest(self, number: int | None, within_s: float) -> Status | None:
        """Ask anew, and return what comes first: the answer to this, or the one that is owed to
        question ``number``. None: neither in time. Neither is of interest afterwards."""

    @abstractmethod
    def ask(self) -> int:
        """A number to give to ``answer`` or to ``forget``."""

    @abstractmethod
    async def answer(self, number: int, within_s: float) -> Status | None:
        """None: not yet."""

    @abstractmethod
    def forget(self, number: int) -> None:
        """The answer is of no more interest; it may still come."""

    @property
    @abstractmethod
    def hears_part(self) -> bool:
        """Whether it has begun an answer, and not ended it."""

    @abstractmethod
    def close(self) -> None: ...


async def hold(gripper: GripperClient, known: Status | None, config: RobotiqConfig) -> MotorReport:
    """Stop the fingers where they are, and prove it. Never raises. Without a ``known`` state the
    gripper is asked first: a hold would activate one that is not, and that moves its fingers. One
    that does not answer within ``CONFIRM_S`` is reset."""
    written = heard = False
    detail = "silent"
    command: Command | None = None
    try:
        with trio.move_on_after(HOLD_S):
            for _ in range(ATTEMPTS):
                # One that does not answer is reset: that stops it, and moves none that was reset before.
                known = known or await gripper.status(CONFIRM_S) or Status()
                # A reset may not have been taken up yet: a hold behind it would be the rising edge.
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
                    heard = True
                    detail = protocol.unsafe_words(known, command)
                    if not detail:
                        return config.report(written, heard, detail)
                    if command.activate and not protocol.safe_command(known).activate:
                        break  # it is being activated, and only a reset ends that
    except WireDown as error:
        detail = str(error)
    return config.report(written, heard, detail)
