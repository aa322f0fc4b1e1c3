"""The interface to the processes of one robot, on this host or on another.

It starts the processes or connects to them, sends them requests, and ends them. Commands and leases (the right
to command) are not decided here.
"""

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
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.failsafe import LINKED, Mode
from strands_actors.supervisors.gate.messages import GetStatus, Lease, Status
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.cameras.handle import Cameras

from . import refusals
from .plan import Plan

CONNECT_S = 30.0
"""Longest time for a connect, on a busy computer. If the processes end, that is noticed at once. The time is
longer if the driver declares that its SDK is silent for longer (``Timing.silent_s``).
"""
LOOK_S = 0.02
"""Period of the check while a robot's processes start. Their start needs half a second of computing time, so
the checks must be rare.
"""


CLEANED_UP = "this robot was cleaned up. Make a new one"


class NotConnected(Exception):
    """The robot's processes do not run or do not answer. The text has the reason."""


def unreachable(verb: str, failure: Exception) -> Refused:
    """Return the refusal of a verb after a message was not delivered or not answered."""
    refusal = refusals.unreachable(verb, failure)
    return busy.with_load(refusal) if isinstance(failure, AskTimeout) else refusal


class Patience(NamedTuple):
    """Timeouts for the answers of a robot, in seconds.

    Attributes:
        ask_s: For the answer to a command or a question.
        status_s: For the status.
        stop_s: For the result of a stop. It is longer if the driver's safe state takes longer.
        command_s: Longest time from making a command to writing it, if the command stays in force until the
            next one. A later command is not written.
    """

    ask_s: float = 0.5
    status_s: float = 0.1
    stop_s: float = 2.0
    command_s: float = 0.25


class Processes(ABC):
    """The processes of one robot. Only the trio loop of ``nursery`` may call it.

    ``gate`` (checks commands) and ``tasks`` (runs policies) exist after ``start``.
    """

    PATIENCE: ClassVar[Patience] = Patience()
    elsewhere = False
    """True if another host runs the robot. It is then neither started nor ended from here."""
    gate: ActorRef
    tasks: ActorRef | None = None
    """The actor that starts named policies in separate processes; None if there is no such actor."""

    def __init__(self, node: Node, nursery: trio.Nursery, plan: Plan, driver: Driver) -> None:
        self.driver = driver
        self.deadlines = StopDeadlines.of(driver.timing.safe_s, driver.late_s)
        longer_s = self.deadlines.gate_s - Patience().stop_s
        self.patience = self.PATIENCE._replace(stop_s=self.PATIENCE.stop_s + max(0.0, longer_s))
        self.node = node
        self.nursery = nursery
        self.plan = plan
        self.robot = plan.tool_name
        """The requested name; after the first start the name that was free."""
        self.holder = f"{plan.tool_name} in process {os.getpid()}"
        """The name of this caller, as other programs see it in the lease."""
        self.facts: dict[str, Any] = {}
        """The facts that the robot reported when it was opened (``Wire.open``), from the last status."""
        self.closed = False
        self.cameras = Cameras(plan.cameras, plan.driver_class)
        self.standby_report: str | None = None
        """The report of the standby process (the last one that can stop a robot) of this robot's earlier run."""

    @property
    @abstractmethod
    def started(self) -> bool: ...

    @abstractmethod
    async def start(self, background: Callable[[], Awaitable[None]]) -> None:
        """Start the processes, or connect to them if another host runs them.

        Args:
            background: An async function to run as long as the processes, such as sending heartbeats.

        Raises:
            NotConnected: The processes cannot be started, or cannot be reached.
            OSError: The system refuses to start a process.
        """

    @abstractmethod
    async def end(self, lease: Lease | None) -> StopResult:
        """Make the robot safe, and end the processes.

        ``lease`` is this caller's right to command the robot; None if it has no lease.
        """

    @abstractmethod
    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        """Stop the robot after the gate did not answer a stop in time."""

    @abstractmethod
    async def cancel_late_request(self, verb: str, timeout: AskTimeout) -> Refused:
        """Handle a request that was not answered in time, and return its refusal.

        It makes sure that the request does not take effect later.
        """

    @abstractmethod
    async def revive(self, lift: bool, background: Callable[[], Awaitable[None]]) -> Refused | None:
        """Restart the processes that have ended. Raise as ``start`` does.

        Args:
            lift: True for an operator. False for another caller, which gets a refusal if the processes have ended,
                since they may have been locked by an e-stop.
            background: As in ``start``.
        """

    @abstractmethod
    async def describe(self) -> TreeReport | None:
        """Return the processes and actors of the robot; None if the root process does not answer."""

    @abstractmethod
    async def require_mesh(self) -> None:
        """Raise ``NotConnected`` if the robot should be reachable from other hosts, and is not."""

    @property
    @abstractmethod
    def alive(self) -> bool:
        """Return False if it is certain that the processes cannot answer any more."""

    async def is_guarded(self, within_s: float) -> bool:
        """Return True if the guardian (it stops the robot if the wire process fails) answers within this time."""
        return self.alive

    def require(self) -> None:
        """Raise ``NotConnected`` if no processes were started, or after ``close``."""
        self.require_open()
        if not self.started:
            raise NotConnected("not connected. Call connect_eagerly() first")

    def require_open(self) -> None:
        """Raise ``NotConnected`` after ``close``."""
        if self.closed:
            raise NotConnected(CLEANED_UP)

    def close(self) -> None:
        """Refuse all further calls. Threads that wait for the gate get an error."""
        self.closed = True
        if self.started and self.node.mesh is not None:
            self.node.mesh.forget(self.gate.address, "this robot was cleaned up")

    async def wait_linked(self, patience_s: float = 0.0) -> Status:
        """Wait until the wire process is connected to the robot, and return the gate's status.

        Args:
            patience_s: Seconds to wait for a lost connection to come back.

        Raises:
            NotConnected: The root process has ended, the connection is lost, or the timeout has passed.
        """
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
        """Return the gate's status for a verb, or a refusal.

        It waits as long as for a command. If the answer is late, the refusal does not claim that the robot is
        not connected, since a late answer does not show that.
        """
        try:
            answer = await self.gate.ask(GetStatus(), self.patience.ask_s)
        except AskTimeout:
            return busy.with_load(refusals.late_status(verb, self.patience.ask_s * 1e3))
        except Unreachable as failure:
            return unreachable(verb, failure)
        return read_answer(answer, Status, verb)

    async def status(self) -> Status | None:
        """Return the status from the gate (it checks every command); None if the gate does not answer in time."""
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
