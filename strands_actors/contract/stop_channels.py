"""Stop channels of four kinds, to be completed with what one robot says. The fifth is
``stop_process.OwnProcess``.

``DuplicateDescriptor``  the descriptor that the wire had open; the port opened anew where that is dead
``ConnectWhenNeeded``    a connection of the root's own, made for the stop
``WatchedFirmware``      the same, where the firmware stops by itself and what is left is to see that it did
``KeptSession``          a session of the root's own, kept up, because opening one takes too long

All are made as ``Driver.STOP_CHANNEL`` says: ``class(config, descriptors, clock)``.
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
    def close(self) -> None: ...


class Watch(Closable, Protocol):
    """A connection that shows how the robot stops."""

    def look(self) -> Reports:
        """Take in what has arrived and return what is known of each motor. Raise ``WireDown``."""
        ...


ConfigT = TypeVar("ConfigT")
PortT = TypeVar("PortT", bound=Closable)
WatchT = TypeVar("WatchT", bound=Watch)


class DuplicateDescriptor(StopChannel, Generic[ConfigT, PortT]):
    """A duplicate of the wire's descriptor, used after its owner has ended. Where that is dead, or
    none was handed over, the port is opened anew, and kept until ``close``."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.port: PortT | None = self.adopt(descriptors[0]) if descriptors else None

    @abstractmethod
    def adopt(self, descriptor: int) -> PortT:
        """Return the port on a descriptor that now belongs to it. Must not raise."""

    @abstractmethod
    async def open_port(self) -> PortT:
        """Return the port, opened by its path or address. Raise ``WireDown``."""

    async def hung_up(self, port: PortT) -> None:
        """Return once the device behind the port is gone. Most ports do not tell that."""
        await trio.sleep_forever()

    @abstractmethod
    async def make_safe_on(self, port: PortT, safe_state: SafeState) -> Reports:
        """Do as ``make_safe``. Raise ``WireDown`` when nothing could be written on this port."""

    @abstractmethod
    def failed(self, why: str) -> Reports:
        """Report that nothing was written."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Let go of a port that was unplugged: while somebody has it open, an adapter gets another
        name when it comes back."""
        task_status.started()
        if self.port is not None:
            await self.hung_up(self.port)
            self.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
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
        if self.port is not None:
            self.port.close()
            self.port = None


class ConnectWhenNeeded(StopChannel, Generic[ConfigT, PortT]):
    """A connection made for the stop. By then the wire's is gone with its process, so a controller
    that takes one client takes this one. A name for an address has to be looked up then, too: a
    number is quicker."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock

    @abstractmethod
    async def connect(self) -> PortT:
        """Raise ``WireDown``."""

    @abstractmethod
    async def make_safe_by(self, port: PortT, safe_state: SafeState) -> Reports:
        """Do as ``make_safe``, on this connection. Raise ``WireDown`` when it is lost."""

    @abstractmethod
    def failed(self, why: str, port: PortT | None = None) -> Reports:
        """Report that no motor is confirmed. ``port``: the connection, where there was one."""

    def release(self, port: PortT) -> None:
        port.close()

    async def make_safe(self, safe_state: SafeState) -> Reports:
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
    """The firmware stops by itself once the wire process is gone. Connect, tell it to stop all the
    same, and look until every motor is seen to be safe."""

    CONFIRM_S: ClassVar[float]
    """For so long."""
    LOOK_S: ClassVar[float] = 0.002

    def order(self, watch: WatchT, safe_state: SafeState) -> None:
        """Tell it to stop, for whoever else might be moving it. Raise ``WireDown``."""

    async def make_safe_by(self, watch: WatchT, safe_state: SafeState) -> Reports:
        self.order(watch, safe_state)
        reports = watch.look()
        with trio.move_on_after(self.CONFIRM_S):
            while not all(report.safe and report.acknowledged for report in reports):
                await trio.sleep(self.LOOK_S)
                reports = watch.look()
        return reports


class KeptSession(StopChannel, Generic[ConfigT, PortT]):
    """A session of the root's own, opened before the wire counts as up, and kept up until it is
    used. One that is lost is replaced as soon as another can be opened."""

    AGAIN_S: ClassVar[float] = 0.2
    """Pause before a session is opened in place of one that was lost."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.session: PortT | None = None
        self._serving = trio.CancelScope()

    @abstractmethod
    async def connect(self) -> PortT:
        """Raise ``WireDown``."""

    @abstractmethod
    async def keep_up(self, session: PortT) -> None:
        """Keep the session alive. Return, or raise ``WireDown``, when it is lost."""

    @abstractmethod
    async def make_safe_by(self, session: PortT | None, safe_state: SafeState) -> Reports:
        """Do as ``make_safe``. ``session``: nobody else uses it any more; None: there is none.
        Never raises."""

    @property
    def has_other_way(self) -> bool:
        """Return whether the robot can be stopped without a session of the root's own."""
        return False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        told = False
        with self._serving:
            try:
                self.session = await self.connect()
            except WireDown:
                if not self.has_other_way:
                    raise
            told = True
            task_status.started()
            while self.session is not None:
                with contextlib.suppress(WireDown):
                    await self.keep_up(self.session)
                await trio.sleep(self.AGAIN_S)
                with contextlib.suppress(WireDown):
                    self.replace(await self.connect())
        if not told:
            task_status.started()  # it has been used meanwhile

    async def make_safe(self, safe_state: SafeState) -> Reports:
        self._serving.cancel()
        return await self.make_safe_by(self.session, safe_state)

    def replace(self, session: PortT | None) -> None:
        """Close the session, and go on with another."""
        if self.session is not None and self.session is not session:
            self.session.close()
        self.session = session

    def close(self) -> None:
        self.replace(None)
