"""The I/O of a driver: ``Wire`` and ``StopChannel``, what they read and what they report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import msgspec
import trio

from strands_actors.kernel.messages import Message, Refused

from .safe_state import SafeState


class Observation(Message, frozen=True):
    """One reading of the robot. Rows are in axis order; an axis never read is NaN with stamp 0."""

    t_ns: int
    position: tuple[float, ...]  # in the driver's units
    stamp_ns: tuple[int, ...]  # when each position was read
    velocity: tuple[float, ...] = ()  # units per second
    sensors: dict[str, tuple[float, ...]] = msgspec.field(default_factory=dict)  # by name, unit in the name
    faults: dict[str, str] = msgspec.field(default_factory=dict)  # axis -> what its motor reports


class MotorReport(Message, frozen=True):
    """What became of one motor when the robot was made safe."""

    axis: str
    id: int
    written: bool  # the frame left
    acknowledged: bool  # the motor answered
    safe: bool  # a register read back says so
    detail: str = ""
    target: float | None = None  # where it was told to hold, in the driver's units


class Permit(Protocol):
    """The transport's word that a setpoint may still go out, or a motor be energised."""

    def check(self) -> None:
        """Raise ``PermitDenied`` once the setpoint's deadline or epoch has passed.

        In ``Wire.arm`` and ``Wire.perform`` a check that passes also notes that the robot is now
        asked for something. If the call is then cut off, no stop is confirmed for ``late_s``
        (``Timing``, ``Service``). So call it as the last thing before a request that energises or
        moves, and not before requests that only read or connect.
        """
        ...


class PermitDenied(Exception):
    """The setpoint may not be written any more. Not an error of the wire; caught by the
    transport."""


class WireDown(Exception):
    """The wire cannot be used: not there, closed, or not answering. The text says what and what to
    do."""


class ProcessSpent(Exception):
    """Only a new process can use this wire again: the SDK in this one hangs, or cannot be closed.
    Any call of a ``Wire`` but ``make_safe`` may raise it. The root ends the process, makes the
    robot safe by its stop channel and starts another; that is no failure of the tree. The text says
    why."""


class Wire(ABC):
    """All I/O of one robot's wire. Calls never overlap, but for ``serve`` and ``perform``.

    A stop cancels ``read`` and ``write`` where they wait: a wire may not be slower than its robot's
    bound. A call that cannot be abandoned (an SDK's, in a thread) is shielded, and has a short
    deadline of its own."""

    interruptible: ClassVar[bool] = False
    """Whether ``arm``, and ``make_safe`` on a safe state that holds, or that takes seconds (land,
    settle), may be cancelled wherever they wait: a stop then cuts them short. Not where an SDK goes
    on with what it was told."""

    hold_failed: str = ""
    """Why the last ``make_safe`` on a safe state that holds could not hold, and brought the robot
    to rest in another way; empty: it did not. Then no setpoint is written until it is armed again,
    before which the transport clears it."""

    @abstractmethod
    async def open(self) -> dict[str, Any]:
        """Open, shake hands, identify. Return facts for ``status``. Moves nothing.
        Raise ``WireDown``."""

    @abstractmethod
    async def arm(self, permit: Permit) -> Observation:
        """Energise without a jump: goal := measured position first, then torque. ``permit.check()``
        before each motor is energised: a stop during bring-up wins. Return what was measured. Raise
        ``WireDown``; what was energised before a failure the caller makes safe."""

    @abstractmethod
    async def read(self) -> Observation:
        """Return one observation. A silent motor is named in ``faults`` and keeps its old stamp;
        raise ``WireDown`` only when the link itself is gone."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep up what runs beside the calls: answer a peer that speaks first, keep the newest
        sample for ``read``.

        Started after ``open``; ``started`` once the first ``read`` may come. Cancelled before
        ``close``; may return when there is nothing to keep up. It writes no setpoint that ``write``
        was not given, and none after ``make_safe``. Raise ``WireDown`` when the link is gone,
        ``ProcessSpent`` as elsewhere."""
        task_status.started()

    async def feed(self) -> None:  # noqa: B027  # most firmware has no watchdog to feed
        """Feed the firmware's own watchdog, where it has one that setpoints alone do not feed.
        Called once per control period, only when the gate and the transport have answered in this
        period. Raise ``WireDown``."""

    @property
    def prompt(self) -> bool:
        """Return whether ``read`` and ``write`` would return now without waiting: the wire takes
        what has arrived, and sends datagrams. Then no task is woken for them."""
        return False

    @abstractmethod
    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write one setpoint (``Candidate.values``). Call ``permit.check()`` as the last thing
        before the bytes leave, after any wait. Raise ``WireDown``."""

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring every motor to ``safe_state``. The first safe frame leaves before the first wait;
        every motor is tried; each is reported as confirmed or not. Never raises: a dead link is a
        report of failures."""

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """As ``make_safe``, without a link: after it was lost (this wire is still open then, or
        closed), or before it was ever up. Write to all that can still be written: what is open
        first, then a port or connection opened for this. The first safe frame leaves before
        anything is asked, and needs no answer; only where the frame itself could move the robot it
        asks first. Leave nothing open that would keep another wire from opening. Never raises; may
        be cancelled wherever it waits; is called again until all motors confirm.

        Default: nothing of its own, and the stop channel (``Driver.stop_channel`` without
        descriptors) is used."""
        return ()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Do one of ``Driver.SERVICES``, after ``Driver.check_service``. Runs beside ``read``; a
        stop cancels it. ``permit.check()`` before each write. Raise ``WireDown``."""
        raise NotImplementedError(f"{type(self).__name__} declares {service} and does not do it")

    def handover(self) -> Sequence[int]:
        """Descriptors the root's stop channel needs; valid until ``close``."""
        return ()

    @abstractmethod
    def close(self) -> None:
        """Release the port. Writes nothing."""


class StopChannel(ABC):
    """The root's own way to the hardware. Used only after the wire process has been fenced, and
    closed before the wire is started again; by the wire process itself when its link is lost.
    Making one must not raise. It may be asked to make safe again and again, until every motor has
    confirmed: what it was given may be dead, so it finds the robot anew each time."""

    SERVED_FIRST: ClassVar[bool] = True
    """Whether one that is made for a stop is served first, for ``Timing.handover_s`` at most. False
    where ``make_safe`` opens what it needs by itself, and writes before the robot has answered."""

    @property
    def hosts(self) -> Sequence[str]:
        """Return the hosts that ``make_safe`` connects to first, by name or number. They are looked up
        before anything is energised."""
        return ()

    @property
    def lacks(self) -> str:
        """Return why it could not make safe at once, after ``serve`` has started; empty: it could.
        While the root's lacks something, nothing is armed."""
        return ""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """What has to be done before the path is needed, and kept up until it is: discovery, a
        session. ``started`` once it could be used at once; the wire does not count as up before.
        Runs until it is cancelled, before ``close``, or returns when there is nothing to keep up.
        Raise ``WireDown``."""
        task_status.started()

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """As ``Wire.make_safe``."""

    @abstractmethod
    def close(self) -> None:
        """Release what ``Driver.stop_channel`` was given."""
