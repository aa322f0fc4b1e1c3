"""Base classes for stop channels.

A stop channel stops a robot when the wire process, which usually writes to the robot, cannot. A driver adds the
frames of its robot.

``DuplicateDescriptor``  a duplicate of the file descriptor that the wire process has open. If it does not
                         work, the port is opened again
``ConnectWhenNeeded``    a new connection for each stop
``WatchedFirmware``      the same, for firmware that stops by itself; the channel confirms that it did
``KeptSession``          a session that is kept open, because opening one takes too long
``OwnProcess``           processes that load an SDK (``stop_process``)

All are made as ``class(config, descriptors, clock)``.
"""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

import trio

from strands_actors.kernel.clock import Clock

from .safe_state import SafeState
from .wire import MotorReport, StopChannel, WireDown

Reports = tuple[MotorReport, ...]


class Closable(Protocol):
    """A port, connection or session of a stop channel, which can be closed."""

    def close(self) -> None:
        """Close the descriptors of the port or connection."""
        ...


class Watch(Closable, Protocol):
    """A connection on which the robot reports its state."""

    def look(self) -> Reports:
        """Read the data that the robot has sent, and return the report on each motor.

        Raises:
            WireDown: The connection is lost.
        """
        ...


ConfigT = TypeVar("ConfigT")
PortT = TypeVar("PortT", bound=Closable)
WatchT = TypeVar("WatchT", bound=Watch)


class DuplicateDescriptor(StopChannel, Generic[ConfigT, PortT]):
    """Stop by a duplicate of the file descriptor that the wire process has open.

    If the descriptor does not work or is missing, the port is opened again. It stays open until ``close``. A
    subclass defines ``adopt``, ``open_port``, ``make_safe_on`` and ``failed``.
    """

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.port: PortT | None = self.adopt(descriptors[0]) if descriptors else None

    @abstractmethod
    def adopt(self, descriptor: int) -> PortT:
        """Return a port object that uses this file descriptor and closes it later. Must not raise."""

    @abstractmethod
    async def open_port(self) -> PortT:
        """Open the port by its path or address. Raise ``WireDown`` if this fails."""

    async def hung_up(self, port: PortT) -> None:
        """Wait until the device behind the port is unplugged.

        The default waits for ever, since most ports never report that.
        """
        await trio.sleep_forever()

    @abstractmethod
    async def make_safe_on(self, port: PortT, safe_state: SafeState) -> Reports:
        """Bring every motor to the safe state by this port, and return a report on each motor.

        Raise ``WireDown`` if nothing could be written.
        """

    @abstractmethod
    def failed(self, reason: str) -> Reports:
        """Return a report on each motor, according to which its safe state is not confirmed for this reason."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Close the port when its adapter is unplugged.

        If the port stayed open, a returning adapter would get another device name.
        """
        task_status.started()
        if self.port is not None:
            await self.hung_up(self.port)
            self.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """Bring every motor to the safe state by the open port. If the port is lost or missing, open it again."""
        if self.port is not None:
            try:
                return await self.make_safe_on(self.port, safe_state)
            except WireDown:
                self.close()
        try:
            self.port = await self.open_port()
            return await self.make_safe_on(self.port, safe_state)
        except WireDown as down:
            return self.failed(str(down))

    def close(self) -> None:
        """Close the port. The next ``make_safe`` opens it again."""
        if self.port is not None:
            self.port.close()
            self.port = None


class ConnectWhenNeeded(StopChannel, Generic[ConfigT, PortT]):
    """Stop by a new connection.

    The wire process has ended before this is used, and so has its connection. So a controller that accepts only one
    client accepts the new connection. If the address is a host name, the name has to be looked up first, which
    takes longer. A subclass defines ``connect``, ``make_safe_by`` and ``failed``.
    """

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock

    @abstractmethod
    async def connect(self) -> PortT:
        """Connect to the robot. Raise ``WireDown`` if this fails."""

    @abstractmethod
    async def make_safe_by(self, port: PortT, safe_state: SafeState) -> Reports:
        """Bring every motor to the safe state by this connection, and return a report on each motor.

        Raise ``WireDown`` if the connection is lost.
        """

    @abstractmethod
    def failed(self, reason: str, port: PortT | None = None) -> Reports:
        """Return a report on each motor, according to which its safe state is not confirmed for this reason.

        ``port`` is the connection; None if connecting failed.
        """

    def release(self, port: PortT) -> None:
        """Close the connection after the stop. It must not raise, because ``make_safe`` never does."""
        port.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """Connect, bring every motor to the safe state, and close the connection."""
        try:
            port = await self.connect()
        except WireDown as down:
            return self.failed(str(down))
        try:
            return await self.make_safe_by(port, safe_state)
        except WireDown as down:
            return self.failed(str(down), port)
        finally:
            self.release(port)

    def close(self) -> None:
        """Do nothing, since no connection is kept open."""


class WatchedFirmware(ConnectWhenNeeded[ConfigT, WatchT]):
    """Stop a robot with firmware that stops by itself when it loses the connection to the wire process.

    The channel still sends the stop, and observes the robot until every motor is safe. A subclass defines
    ``connect``, ``failed`` and ``CONFIRM_S``, and also ``order`` if another client may move the robot.
    """

    CONFIRM_S: ClassVar[float]
    """Longest time of the observation."""
    LOOK_S: ClassVar[float] = 0.002
    """Pause between two observations."""

    def order(self, watch: WatchT, safe_state: SafeState) -> None:
        """Send the stop, in case another client moves the robot. Raise ``WireDown`` if the connection is lost."""

    async def make_safe_by(self, watch: WatchT, safe_state: SafeState) -> Reports:
        """Send the stop, and observe the robot until every motor is safe, for at most ``CONFIRM_S``."""
        self.order(watch, safe_state)
        reports = watch.look()
        with trio.move_on_after(self.CONFIRM_S):
            while not all(report.safe and report.acknowledged for report in reports):
                await trio.sleep(self.LOOK_S)
                reports = watch.look()
        return reports


class KeptSession(StopChannel, Generic[ConfigT, PortT]):
    """Stop by a session that is opened before the robot counts as connected, and that stays open.

    A lost session is replaced. A subclass defines ``connect``, ``keep_up`` and ``make_safe_by``. It also defines
    ``has_other_way`` if the robot can be stopped without a session.
    """

    AGAIN_S: ClassVar[float] = 0.2
    """Pause before a lost session is replaced."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.session: PortT | None = None
        self._serving = trio.CancelScope()

    @abstractmethod
    async def connect(self) -> PortT:
        """Open a session. Raise ``WireDown`` if this fails."""

    @abstractmethod
    async def keep_up(self, session: PortT) -> None:
        """Keep a session alive. When it is lost, return or raise ``WireDown``."""

    @abstractmethod
    async def make_safe_by(self, session: PortT | None, safe_state: SafeState) -> Reports:
        """Bring every motor to the safe state by the session, and return a report on each motor. Never raises.

        ``session`` is None if no session is open. No other call uses it at the same time.
        """

    @property
    def has_other_way(self) -> bool:
        """True if the robot can be stopped without a session."""
        return False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Open a session, keep it up, and replace it ``AGAIN_S`` after it is lost.

        The first ``make_safe`` cancels this task, so that only the stop uses the session.

        Raises:
            WireDown: The first session cannot be opened, and the robot cannot be stopped without one.
        """
        is_started = False
        with self._serving:
            try:
                self.session = await self.connect()
            except WireDown:
                if not self.has_other_way:
                    raise
            is_started = True
            task_status.started()
            while self.session is not None:
                with contextlib.suppress(WireDown):
                    await self.keep_up(self.session)
                await trio.sleep(self.AGAIN_S)
                with contextlib.suppress(WireDown):
                    self.replace(await self.connect())
        if not is_started:
            # ``make_safe`` has cancelled this task before a session was open.
            task_status.started()

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """End ``serve``, and bring every motor to the safe state, by the session if one is open."""
        self._serving.cancel()
        return await self.make_safe_by(self.session, safe_state)

    def replace(self, session: PortT | None) -> None:
        """Close the present session, and use this one instead."""
        if self.session is not None and self.session is not session:
            self.session.close()
        self.session = session

    def close(self) -> None:
        """Close the session."""
        self.replace(None)
