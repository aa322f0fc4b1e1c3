"""The classes of a driver that do I/O: ``Wire`` and ``StopChannel``.

``Wire`` is the connection to a robot, and ``StopChannel`` a second connection for stops. This module also has their
observations and reports.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import msgspec
import trio

from strands_actors.kernel.messages import Message, Refused

from .safe_state import SafeState


class Observation(Message, frozen=True):
    """One reading of the robot. Each tuple is in axis order.

    Attributes:
        t_ns: Time of the newest value, in nanoseconds of CLOCK_MONOTONIC.
        position: Position of each axis in the driver's units; NaN if it was never read.
        stamp_ns: Time at which each position was read (ns); 0 if it was never read.
        velocity: Velocity of each axis in units per second; empty if the robot does not report velocities.
        sensors: Other values by name. The name ends with the unit (``rpy_rad``).
        faults: Text of the fault that a motor reports, by axis.
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
        written: True if the frame with the stop was sent.
        acknowledged: True if the motor has answered.
        safe: True if a value that was read afterwards shows that the motor is in the safe state.
        detail: Why the motor is not safe; empty if it is safe.
        target: The position that the motor holds, in the driver's units; None if it does not hold one.
    """

    axis: str
    id: int
    written: bool
    acknowledged: bool
    safe: bool
    detail: str = ""
    target: float | None = None


def all_safe(motors: Sequence[MotorReport]) -> bool:
    """Return True if the reports confirm a stop: each motor is safe. Without a report, nothing is confirmed."""
    return bool(motors) and all(motor.safe for motor in motors)


class Permit(Protocol):
    """Decides, immediately before bytes are sent, whether a setpoint or a request to energise is still allowed."""

    def check(self) -> None:
        """Raise ``PermitDenied`` if the setpoint has expired, is from before a stop, or if a stop waits.

        In ``Wire.arm`` and ``Wire.perform`` a successful check also notes that a request is being sent. If the call
        is then cut off, no stop is confirmed for ``late_s`` (see ``Timing`` and ``Service``). So call this method
        immediately before each request that energises or moves the robot, and not before requests that only read or
        connect.
        """
        ...


class PermitDenied(Exception):
    """The setpoint must not be written any more, because a stop has come or its time is over.

    This is not an error of the connection. The caller of ``Wire.write`` catches it.
    """


class WireDown(Exception):
    """The connection to the robot cannot be used: it is missing, closed or silent.

    The text gives the reason and the remedy.
    """


class ProcessSpent(Exception):
    """An SDK in this process hangs or cannot be closed, so only a new process can connect to the robot again.

    Any method of ``Wire`` except ``make_safe`` may raise this. The root process then ends the wire process, stops
    the robot by its stop channel, and starts another wire process. This does not count as a failure.
    """


class Wire(ABC):
    """The connection to one robot, with all I/O. Only the wire process uses it.

    One method at a time is called, except that ``serve`` and ``perform`` run at the same time as others. A stop
    cancels ``read`` and ``write`` while they wait. A call that cannot be cancelled (of an SDK, in a thread) has to
    be shielded. It needs a deadline that is shorter than the robot's bound for a stop.
    """

    interruptible: ClassVar[bool] = False
    """True if a stop may cancel ``arm``, and ``make_safe`` to a safe state that holds or takes seconds
    (land, settle), wherever they wait. False if an SDK would go on with the order."""

    hold_failed: str = ""
    """Why the last hold failed and the robot was stopped in another way; empty if it did not fail.
    No setpoint is written until the robot is armed again. The transport clears it before arming."""

    ended_in: SafeState | None = None
    """The safe state that the last ``make_safe`` has led to, if it is another one than the ordered one: an arm that
    could not be lowered to the end is limp. The transport clears it before a stop, and reports it."""

    expires_ns: int = 0
    """When the motion of the setpoint has to end; 0 if it ends with its writer's lease. The transport sets it
    before each write."""

    streamed: bool = False
    """True if the setpoint is part of a stream. The transport sets it before each write."""

    reason: str = ""
    """The ``Reason`` of the stop or hold. The transport sets it before ``make_safe`` and ``reach``."""

    lifts: bool = False
    """True if an operator's resume arms the robot, which lifts the lock of an e-stop. The transport sets it before
    ``arm``."""

    @property
    def seen(self) -> Observation | None:
        """The newest reading of a stop that takes seconds (land, lowered, settle); None if it reads no positions.

        The transport publishes it, so that others see how the robot comes down.
        """
        return None

    @abstractmethod
    async def open(self) -> dict[str, Any]:
        """Connect to the robot and identify it, without moving anything.

        Returns:
            Facts about the robot, which ``status`` shows.

        Raises:
            WireDown: The robot cannot be reached.
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
            WireDown: The robot could not be energised. The caller then stops the motors that already have torque.
            PermitDenied: A stop has come. Do not catch this exception.
        """

    @abstractmethod
    async def read(self) -> Observation:
        """Return one observation.

        A motor that does not answer keeps its old ``stamp_ns`` and is named in ``faults``.

        Raises:
            WireDown: The connection itself is lost.
        """

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Do the background work: answer requests of the robot, and keep its newest sample for ``read``.

        This method is started after ``open`` and cancelled before ``close``. It may return if there is nothing to
        do. It must write only setpoints that ``write`` was given, and no setpoint after ``make_safe``.

        Args:
            task_status: Call ``started()`` when ``read`` can be called.

        Raises:
            WireDown: The connection is lost.
            ProcessSpent: An SDK hangs.
        """
        task_status.started()

    async def feed(self) -> None:  # noqa: B027  # most firmware has no watchdog to feed
        """Send the frame that keeps the firmware's watchdog from stopping the robot, if setpoints do not.

        This method is called once per control period, but only if our checks and our writer have replied in this
        period.

        Raises:
            WireDown: The connection is lost.
        """

    @property
    def prompt(self) -> bool:
        """True if ``read`` and ``write`` now return without waiting, for example because they only send datagrams.

        They are then called without a task switch.
        """
        return False

    @abstractmethod
    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write one setpoint.

        Args:
            values: ``Candidate.values``.
            permit: Call ``permit.check()`` immediately before the bytes leave, after any wait.

        Raises:
            WireDown: The connection is lost.
            PermitDenied: The setpoint must not be written any more. Do not catch this exception.
        """

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring every motor to a safe state. Never raises.

        The first frame with the stop must be sent before the first wait. Every motor is tried.

        Returns:
            A report on each motor. If the connection is lost, no motor is confirmed.
        """

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Do the work of ``make_safe`` without a working connection (lost, or not open yet).

        Write on every connection that is still open, and then on a port or connection that is opened for the stop.
        Send the stop before any question, without waiting for an answer. Only if that frame could move the robot,
        ask first. At the end, leave nothing open that would keep another process from connecting. Never raises. The
        call may be cancelled wherever it waits, and is repeated until all motors confirm.

        Returns:
            A report on each motor. If there are no reports (the default), a new stop channel is used instead.
        """
        return ()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run a service of ``Driver.SERVICES``. A stop cancels it.

        Args:
            service: The name of the service.
            arguments: The arguments of the service, which ``Driver.check_service`` has accepted.
            permit: Call ``permit.check()`` before each write.

        Returns:
            The result for the caller, or a refusal.

        Raises:
            WireDown: The connection is lost.
        """
        raise NotImplementedError(f"{type(self).__name__} declares {service} and does not do it")

    def handover(self) -> Sequence[int]:
        """Return the file descriptors for the stop channel of the root process (the supervisor).

        They stay valid until ``close``.
        """
        return ()

    @abstractmethod
    def close(self) -> None:
        """Close the port, without writing anything."""


class StopChannel(ABC):
    """A second connection to the robot, for a stop without the wire process.

    The root process uses it after it has killed the wire process, and closes it before the next wire process
    starts. The wire process uses a stop channel when its own connection is lost, and the standby process has
    another stop channel. The constructor must not raise. ``make_safe`` is called again until every motor confirms.
    The given descriptors may no longer work by that time, so each call must be able to connect to the robot again.
    """

    SERVED_FIRST: ClassVar[bool] = True
    """True if a channel that is made during a stop has to be served first, for ``Timing.handover_s`` at most.
    False if ``make_safe`` opens its own connections, and writes before the robot has answered."""

    @property
    def hosts(self) -> Sequence[str]:
        """The hosts that ``make_safe`` connects to, by name or address.

        Their addresses are looked up before any motor is energised.
        """
        return ()

    @property
    def lacks(self) -> str:
        """Why the channel is not ready for a stop, after ``serve`` has started; empty if it is ready.

        No motor is energised while the stop channel of the root process (the supervisor) is not ready.
        """
        return ""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Prepare the channel and keep it ready: discovery, a session.

        This task is cancelled before ``close``. It may return if there is nothing to keep ready.

        Args:
            task_status: Call ``started()`` when the channel is ready for a stop. Only then does the robot count as
                connected.

        Raises:
            WireDown: The channel is lost.
        """
        task_status.started()

    @abstractmethod
    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Bring every motor to a safe state, with the same rules as ``Wire.make_safe``. Never raises."""

    @abstractmethod
    def close(self) -> None:
        """Close the descriptors that the channel has got from ``Driver.stop_channel``."""
