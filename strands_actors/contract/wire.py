"""The I/O of a driver: ``Wire``, ``StopChannel``, their observations and their reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import msgspec
import trio

from strands_actors.kernel.messages import Message, Refused

from .safe_state import SafeState


class Observation(Message, frozen=True):
    """One reading of the robot. Rows are in axis order.

    Attributes:
        t_ns: Time of the newest value, in nanoseconds of CLOCK_MONOTONIC.
        position: Position of each axis in the driver's units; NaN for an axis that was never read.
        stamp_ns: When each position was read; 0 for never.
        velocity: Units per second of each axis; empty if the robot does not report it.
        sensors: Other values by name. The name ends with the unit (``rpy_rad``).
        faults: Fault texts by axis, as the motors report them.
    """

    t_ns: int
    position: tuple[float, ...]
    stamp_ns: tuple[int, ...]
    velocity: tuple[float, ...] = ()
    sensors: dict[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    faults: dict[str, str] = msgspec.field(default_factory=dict)


class MotorReport(Message, frozen=True):
    """The result of a stop for one motor.

    Attributes:
        axis: The axis of the motor.
        id: The number of the motor.
        written: The safe frame has left.
        acknowledged: The motor has answered.
        safe: A value that was read back afterwards shows the safe state.
        detail: Why it is not safe; empty if it is.
        target: The position at which it holds, in the driver's units; None if it does not hold.
    """

    axis: str
    id: int
    written: bool
    acknowledged: bool
    safe: bool
    detail: str = ""
    target: float | None = None


class Permit(Protocol):
    """The last check before a setpoint is written or a motor is energised."""

    def check(self) -> None:
        """Raise ``PermitDenied`` if the setpoint's deadline or epoch has passed, or a stop waits.

        In ``Wire.arm`` and ``Wire.perform`` a passed check also notes that a request is being sent. If
        the call is then cut off, no stop is confirmed for ``late_s`` (``Timing``, ``Service``). So call
        it immediately before each request that energises or moves the robot, and not before requests
        that only read or connect.
        """
        ...


class PermitDenied(Exception):
    """The setpoint must not be written any more.

    This is no error of the wire; the transport catches it.
    """


class WireDown(Exception):
    """The wire cannot be used: it is missing, closed or silent. The text says why, and the remedy."""


class ProcessSpent(Exception):
    """Only a new process can use this wire again, because an SDK hangs in this one or cannot be closed.

    Any call of a ``Wire`` except ``make_safe`` may raise it. The root then ends the process, stops the
    robot by its stop channel, and starts another process. This does not count as a failure.
    """


class Wire(ABC):
    """All I/O of one robot, in the wire process.

    Calls never overlap, except that ``serve`` and ``perform`` run at the same time as others. A stop cancels
    ``read`` and ``write`` wherever they wait. A call that cannot be cancelled (of an SDK, in a thread) has to
    be shielded, with a deadline shorter than the robot's bound.
    """

    interruptible: ClassVar[bool] = False
    """True if a stop may cancel ``arm``, and ``make_safe`` to a safe state that holds or takes seconds
    (land, settle), wherever they wait. False if an SDK would go on with the order."""

    hold_failed: str = ""
    """Why the last hold failed and the robot was stopped in another way; empty if it did not fail.
    No setpoint is written until the robot is armed again. The transport clears it before arming."""

    @abstractmethod
    async def open(self) -> dict[str, Any]:
        """Connect to the robot and identify it, without moving anything.

        Returns:
            Facts for ``status``.

        Raises:
            WireDown: It cannot be connected to.
        """

    @abstractmethod
    async def arm(self, permit: Permit) -> Observation:
        """Energise the robot without a jump.

        Write the measured position as the goal, then switch on torque.

        Args:
            permit: Call ``permit.check()`` before each motor is energised.

        Returns:
            The measured positions.

        Raises:
            WireDown: It failed. The caller stops the motors that were energised before.
            PermitDenied: A stop came; let it pass.
        """

    @abstractmethod
    async def read(self) -> Observation:
        """Return one observation. A silent motor keeps its old stamp and is named in ``faults``.

        Raises:
            WireDown: The link itself is gone.
        """

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run in the background: answer a peer that sends requests, keep the newest sample for ``read``.

        It is started after ``open`` and cancelled before ``close``. It may return if there is nothing to do. It
        writes only setpoints from ``write``, and no setpoint after ``make_safe``.

        Args:
            task_status: Call ``started()`` when the first ``read`` may come.

        Raises:
            WireDown: The link is gone.
            ProcessSpent: An SDK hangs.
        """
        task_status.started()

    async def feed(self) -> None:  # noqa: B027  # most firmware has no watchdog to feed
        """Feed the firmware's watchdog, if it has one that setpoints do not feed.

        It is called once per control period, if gate and transport have replied in this period.

        Raises:
            WireDown: The link is gone.
        """

    @property
    def prompt(self) -> bool:
        """True if ``read`` and ``write`` return without waiting now, as a wire of datagrams does.

        The transport then calls them without a task switch.
        """
        return False

    @abstractmethod
    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write one setpoint.

        Args:
            values: ``Candidate.values``.
            permit: Call ``permit.check()`` immediately before the bytes leave, after any wait.

        Raises:
            WireDown: The link is gone.
            PermitDenied: It must not be written; let it pass.
        """

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring every motor to a safe state. Never raises.

        The first safe frame leaves before the first wait. Every motor is tried.

        Returns:
            A report of each motor. On a dead link every motor is unconfirmed.
        """

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """As ``make_safe``, without a working link: after it was lost, or before the first ``open``.

        Write on everything that is still open, then on a port or connection opened for this. The
        first safe frame leaves before any question, and needs no answer. Only if that frame could move
        the robot, ask first. Leave nothing open that would keep another wire from opening. Never
        raises. It may be cancelled wherever it waits, and is repeated until all motors confirm.

        Returns:
            A report of each motor. Without any, a new stop channel is used instead (the default).
        """
        return ()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run a service of ``Driver.SERVICES``. A stop cancels it.

        Args:
            service: Its name.
            arguments: Its arguments, which ``Driver.check_service`` has accepted.
            permit: Call ``permit.check()`` before each write.

        Returns:
            The result for the caller, or a refusal.

        Raises:
            WireDown: The link is gone.
        """
        raise NotImplementedError(f"{type(self).__name__} declares {service} and does not do it")

    def handover(self) -> Sequence[int]:
        """Return the descriptors that the root's stop channel needs. They are valid until ``close``."""
        return ()

    @abstractmethod
    def close(self) -> None:
        """Close the port, without writing anything."""


class StopChannel(ABC):
    """A second way to the hardware, for a stop without the wire.

    The root uses it after it has fenced the wire process, and closes it before the next wire starts.
    The wire process uses one when its link is lost, and the standby has its own. Making one must not
    raise. ``make_safe`` is repeated until every motor confirms. The descriptors may be dead by then, so
    each call finds the robot anew.
    """

    SERVED_FIRST: ClassVar[bool] = True
    """True if a channel that is made during a stop has to be served first, for ``Timing.handover_s`` at most.
    False if ``make_safe`` opens its own connections, and writes before the robot has answered."""

    @property
    def hosts(self) -> Sequence[str]:
        """The hosts that ``make_safe`` connects to, by name or address.

        They are looked up before anything is energised.
        """
        return ()

    @property
    def lacks(self) -> str:
        """Why the channel is not ready for a stop, after ``serve`` has started; empty if it is.

        While the root's channel lacks something, nothing is armed.
        """
        return ""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Prepare the channel and keep it ready: discovery, a session.

        It is cancelled before ``close``. It may return if there is nothing to keep up.

        Args:
            task_status: Call ``started()`` when the channel is ready for a stop. The wire's link
                counts as up only then.

        Raises:
            WireDown: The channel is lost.
        """
        task_status.started()

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring every motor to a safe state, as ``Wire.make_safe``. Never raises."""

    @abstractmethod
    def close(self) -> None:
        """Close the descriptors that ``Driver.stop_channel`` was given."""
