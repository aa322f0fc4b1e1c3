"""What a caller needs of the processes of one robot, on its own host or on another: to start or
reach them, to ask them, to end. What is written to the robot, and by what right, is not decided
here."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar, NamedTuple

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.answers import read_answer
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import ActorRef, AskTimeout, Node, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.failsafe import LINKED, Mode
from strands_actors.supervisors.gate.messages import GetStatus, Lease, Status
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.cameras.handle import Cameras

from .plan import Plan

CONNECT_S = 30.0
"""For a machine that is busy with much else; a tree that ends is noticed at once. Longer where the
driver announces that its SDK is silent for longer (``Timing.silent_s``)."""
LOOK_S = 0.02
"""Between two looks for a tree that starts. It has half a second to compute, which the looks should
leave it."""


CLEANED_UP = "this robot was cleaned up. make a new one"


class NotConnected(Exception):
    """There is no tree, or it does not answer."""


def unreachable(verb: str, failure: Exception) -> Refused:
    why = busy.explained(str(failure)) if isinstance(failure, AskTimeout) else str(failure)
    return Refused(Code.UNREACHABLE, why, "resume() when the robot is back", verb=verb)


class Patience(NamedTuple):
    """How long an answer may take, in seconds. ``command_s``: a command that has not reached the
    wire by then never will."""

    ask_s: float = 0.5
    status_s: float = 0.1
    stop_s: float = 2.0  # of the gate; it may take longer, as the driver says
    command_s: float = 0.25


class Processes(ABC):
    """All methods belong to the trio loop of ``nursery``. ``gate``: once it was started."""

    PATIENCE: ClassVar[Patience] = Patience()
    elsewhere = False
    """The robot is another host's: it is not started, and not ended, from here."""
    gate: ActorRef
    tasks: ActorRef | None = None
    """Who starts named policies in processes of their own; None: nobody does."""

    def __init__(self, node: Node, nursery: trio.Nursery, plan: Plan, driver: Driver) -> None:
        self.driver = driver
        self.deadlines = StopDeadlines.of(driver.timing.safe_s, driver.late_s)
        longer_s = self.deadlines.gate_s - Patience().stop_s
        self.patience = self.PATIENCE._replace(stop_s=self.PATIENCE.stop_s + max(0.0, longer_s))
        self.node = node
        self.nursery = nursery
        self.plan = plan
        self.robot = plan.tool_name
        """The name it was given; from the first start on the one it could get."""
        self.holder = f"{plan.tool_name} in process {os.getpid()}"
        """What others read when they ask who has the robot."""
        self.facts: dict[str, Any] = {}
        """What the wire said of itself when it last answered."""
        self.closed = False
        self.cameras = Cameras(plan.cameras, plan.driver_class)
        self.standby_report: str | None = None
        """What the standby of an earlier tree of this robot had to do."""

    @property
    @abstractmethod
    def started(self) -> bool: ...

    @abstractmethod
    async def start(self, beside: Callable[[], Awaitable[None]]) -> None:
        """``beside`` runs until the end. Raise ``NotConnected``, or ``OSError`` when the system
        does not let us."""

    @abstractmethod
    async def end(self, lease: Lease | None) -> StopResult:
        """Make safe and end. ``lease``: ours, if we have it."""

    @abstractmethod
    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        """What follows a stop that the gate has not answered."""

    @abstractmethod
    async def late(self, verb: str, timeout: AskTimeout) -> Refused:
        """What was not answered in time must not be done late. What the caller is told."""

    @abstractmethod
    async def revive(self, lift: bool, beside: Callable[[], Awaitable[None]]) -> Refused | None:
        """Start again what has died. ``lift=False``: for who is no operator. Raise as ``start``."""

    @abstractmethod
    async def describe(self) -> TreeReport | None:
        """Processes and actors of the tree; None when the root does not answer."""

    @abstractmethod
    async def require_mesh(self) -> None:
        """A robot that was to be reached from elsewhere and is not has not been started:
        ``NotConnected``."""

    @property
    @abstractmethod
    def alive(self) -> bool:
        """Return whether it can answer at all, as far as is known here."""

    def require(self) -> None:
        """Raise ``NotConnected`` when there is nobody to ask."""
        self.require_open()
        if not self.started:
            raise NotConnected("not connected. call connect_eagerly() first")

    def require_open(self) -> None:
        """Raise ``NotConnected`` when it is closed for good."""
        if self.closed:
            raise NotConnected(CLEANED_UP)

    def close(self) -> None:
        """For good. Threads that wait for the gate are told so."""
        self.closed = True
        if self.started and self.node.mesh is not None:
            self.node.mesh.forget(self.gate.address, "this robot was cleaned up")

    async def wait_linked(self, patience_s: float = 0.0) -> Status:
        """``patience_s``: how long to wait for a link that was lost. Raise ``NotConnected``."""
        began = trio.current_time()
        within_s = max(CONNECT_S, self.driver.timing.silent_s)
        deadline = began + within_s
        status: Status | None = None
        while trio.current_time() < deadline:
            if not self.alive:
                raise NotConnected("the root process ended")
            try:
                answer = await self.gate.ask(GetStatus(), self.patience.ask_s)
            except (AskTimeout, Unreachable):
                await trio.sleep(LOOK_S)
                continue
            if isinstance(answer, Refused):
                raise NotConnected(answer.text)
            assert isinstance(answer, Status)
            status = answer
            if status.mode in LINKED and status.mode != Mode.STOPPING:
                return status
            lost = status.connect_error and status.connect_error != "not connected yet"
            if lost and trio.current_time() >= began + patience_s:
                raise NotConnected(status.connect_error)
            await trio.sleep(LOOK_S)
        if status is None:
            raise NotConnected(busy.explained(f"no answer within {within_s:g} s"))
        raise NotConnected(status.connect_error or busy.explained(f"the robot is {status.mode}"))

    async def ask_status(self, verb: str) -> Status | Refused:
        """For a verb that depends on it: wait as long as for a command, and say when nothing was
        answered. A robot that is slow to answer is not one that is not connected."""
        try:
            answer = await self.gate.ask(GetStatus(), self.patience.ask_s)
        except AskTimeout:
            why = busy.explained(f"the wire has not answered for {self.patience.ask_s * 1e3:g} ms")
            return Refused(Code.NO_ANSWER, why, "try again: the host may be busy", verb=verb)
        except Unreachable as failure:
            return unreachable(verb, failure)
        return read_answer(answer, Status, verb)

    async def status(self) -> Status | None:
        """None when the wire does not answer."""
        if not self.started:
            return None
        try:
            answer = await self.gate.ask(GetStatus(), self.patience.status_s)
        except (AskTimeout, Unreachable):
            return None
        if not isinstance(answer, Status):
            return None
        self.facts |= answer.facts
        return answer
