"""A gripper's registers over one connection, and how it is made to hold. Shared by the wire and by
the root's stop channel. What carries them: ``tcp_client``, ``serial_client``; one of the two is
opened by ``connect``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from strands_actors.contract.wire import MotorReport, Permit, WireDown

from . import protocol
from .config import RobotiqConfig
from .protocol import Command, Status

ATTEMPTS = 3
CONFIRM_S = 0.25
"""Of each attempt: three, and a connection, fit into what a stop may take."""


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
    gripper is asked first: a hold would activate one that is not, and that moves its fingers."""
    written = heard = False
    detail = "silent"
    try:
        for _ in range(ATTEMPTS):
            known = known or await gripper.status(CONFIRM_S)
            if known is None:
                continue
            await gripper.clear_way()
            gripper.write(protocol.safe_command(known))
            written = True
            known = await gripper.status(CONFIRM_S)
            heard = heard or known is not None
            detail = "silent" if known is None else protocol.unsafe_words(known)
            if not detail:
                break
    except WireDown as error:
        detail = str(error)
    return config.report(written, heard, detail)
