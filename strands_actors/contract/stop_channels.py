"""Base classes for stop channels. A driver adds the frames of its robot.

``DuplicateDescriptor``  a duplicate of the wire's descriptor; if it is dead, the port is opened anew
``ConnectWhenNeeded``    a new connection for each stop
``WatchedFirmware``      the same for firmware that stops by itself; the channel sees that it did
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
    """A port, connection or session of a stop channel."""

    def close(self) -> None:
        """Close the descriptors of the port or connection."""
        ...


class Watch(Closable, Protocol):
    """A connection on which the robot reports its state."""

    def look(self) -> Reports:
        """Read the received data and return the report of each motor.

        Raises:
            WireDown: The connection is lost.
        """
        ...


ConfigT = TypeVar("ConfigT")
PortT = TypeVar("PortT", bound=Closable)
WatchT = TypeVar("WatchT", bound=Watch)


class DuplicateDescriptor(StopChannel, Generic[ConfigT, PortT]):
    """Stop by a duplicate of the wire's descriptor.

    If it is dead or missing, the port is opened again, and stays open until ``close``. A subclass defines
    ``adopt``, ``open_port``, ``make_safe_on`` and ``failed``.
    """

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.port: PortT | None = self.adopt(descriptors[0]) if descriptors else None

    @abstractmethod
    def adopt(self, descriptor: int) -> PortT:
        """Return a port that owns the descriptor. Must not raise."""

    @abstractmethod
    async def open_port(self) -> PortT:
        """Open the port by its path or address. Raise ``WireDown``."""

    async def hung_up(self, port: PortT) -> None:
        """Wait until the device behind the port is gone. Most ports never report that."""
        await trio.sleep_forever()

    @abstractmethod
    async def make_safe_on(self, port: PortT, safe_state: SafeState) -> Reports:
        """As ``make_safe``, on this port. Raise ``WireDown`` if nothing could be written."""

    @abstractmethod
    def failed(self, why: str) -> Reports:
        """Report that nothing was written."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Close the port when its adapter was unplugged.

        While the port is open, the adapter gets another name when it comes back.
        """
        task_status.started()
        if self.port is not None:
            await self.hung_up(self.port)
            self.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """Make the robot safe on the open port. If that is lost or missing, open the port again."""
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

    The wire's connection is gone with its process by then, so a controller with one client accepts this
    one. A host name has to be looked up for it, which takes longer than an address. A subclass defines
    ``connect``, ``make_safe_by`` and ``failed``.
    """

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock

    @abstractmethod
    async def connect(self) -> PortT:
        """Connect to the robot. Raise ``WireDown``."""

    @abstractmethod
    async def make_safe_by(self, port: PortT, safe_state: SafeState) -> Reports:
        """As ``make_safe``, on this connection. Raise ``WireDown`` if it is lost."""

    @abstractmethod
    def failed(self, why: str, port: PortT | None = None) -> Reports:
        """Return reports in which no motor is confirmed. ``port`` is the connection, if there was one."""

    def release(self, port: PortT) -> None:
        """Close a connection after its stop. This must not raise, since ``make_safe`` never does."""
        port.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """Connect, make the robot safe, and release the connection."""
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
        """Nothing is kept open."""


class WatchedFirmware(ConnectWhenNeeded[ConfigT, WatchT]):
    """Stop a robot with firmware that stops by itself when the wire process is gone.

    The channel orders the stop nevertheless, and observes the robot until every motor is safe. A subclass
    defines ``connect``, ``failed`` and ``CONFIRM_S``, and ``order`` if another client may move the robot.
    """

    CONFIRM_S: ClassVar[float]
    """Longest time of the observation."""
    LOOK_S: ClassVar[float] = 0.002
    """Pause between two observations."""

    def order(self, watch: WatchT, safe_state: SafeState) -> None:
        """Order the stop, in case another client moves the robot. Raise ``WireDown``."""

    async def make_safe_by(self, watch: WatchT, safe_state: SafeState) -> Reports:
        """Order the stop, and observe the robot for ``CONFIRM_S`` at most until every motor is safe."""
        self.order(watch, safe_state)
        reports = watch.look()
        with trio.move_on_after(self.CONFIRM_S):
            while not all(report.safe and report.acknowledged for report in reports):
                await trio.sleep(self.LOOK_S)
                reports = watch.look()
        return reports


class KeptSession(StopChannel, Generic[ConfigT, PortT]):
    """Stop by a session that is opened before the wire's link counts as up, and kept open.

    A lost session is replaced. A subclass defines ``connect``, ``keep_up`` and ``make_safe_by``, and
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
        """Open a session. Raise ``WireDown``."""

    @abstractmethod
    async def keep_up(self, session: PortT) -> None:
        """Keep a session alive until it is lost. Return then, or raise ``WireDown``."""

    @abstractmethod
    async def make_safe_by(self, session: PortT | None, safe_state: SafeState) -> Reports:
        """As ``make_safe``. Never raises. ``session`` is for this call alone, and None without one."""

    @property
    def has_other_way(self) -> bool:
        """True if the robot can be stopped without a session."""
        return False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Open a session, keep it up, and replace it ``AGAIN_S`` after it is lost.

        The first ``make_safe`` ends it, so that the session is used for the stop alone.

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
            task_status.started()  # It was used for a stop meanwhile.

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """End ``serve`` and make the robot safe by the session, or without one if there is none."""
        self._serving.cancel()
        return await self.make_safe_by(self.session, safe_state)

    def replace(self, session: PortT | None) -> None:
        """Close the session and use another one."""
        if self.session is not None and self.session is not session:
            self.session.close()
        self.session = session

    def close(self) -> None:
        """Close the session."""
        self.replace(None)
