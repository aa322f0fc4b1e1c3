"""The recorder connects to a running robot and passes the robot's journal to a sink.

The journal is the list of all internal messages of a robot. The recorder runs in a separate process. The sink
is a file to view and replay (``to_file``), or a dataset for training (``surfaces.dataset``).

The robot never waits for the recorder. If the recorder is slow, frozen or dead, the actors that send the
journal ("instruments") drop entries or disconnect. If a process of the robot ends, the recorder notes this in
the sink, and connects to the next process that replaces it.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Generic, Protocol, TypeVar

import msgspec
import trio

from strands_actors.caller.processes.nodes import open_node
from strands_actors.caller.processes.run_directory import notes
from strands_actors.kernel.actor import Actor, Cell
from strands_actors.kernel.frames import Down
from strands_actors.kernel.health.processor import life_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import PREFIX, AskTimeout, Node, Unreachable
from strands_actors.kernel.processes.process import exists
from strands_actors.supervisors import addresses
from strands_actors.supervisors.instrument import (
    SILENT_S,
    Acknowledge,
    Attach,
    Attached,
    Batch,
    Detach,
    Detached,
    InstrumentKeeper,
    Taken,
)

from .errors import RecordingError

SOURCES = ("wire", "root")
FIRST_S = 5.0
"""How long to wait for wire and root at the beginning."""
ASK_S = 0.5
RETRY_S = 0.02
GONE_S = 2.0
"""A robot has ended if no process of it has answered for so long."""
GONE = "the robot is gone"
DETACH_S = 1.0
LEAVE_S = 0.3
"""How long to wait for a detach after a failure, when the remaining entries are not needed."""
FLUSH_S = 1.0


class Sink(Protocol):
    """The receiver of the recorded batches of journal entries, in order.

    If a method raises ``OSError`` or ``RecordingError``, the recording ends for this reason. The robot is not
    affected.
    """

    def add(self, source: str, batch: Batch) -> None: ...

    def lost(self, source: str, reason: str) -> None:
        """Record that a process has stopped sending its journal (its internal messages)."""
        ...

    def flush(self) -> None:
        """Write buffered data. The recorder calls this once a second."""
        ...

    def close(self) -> None: ...


SomeSink = TypeVar("SomeSink", bound=Sink)


class Ending(msgspec.Struct, frozen=True):
    """The length of a recording, and why it ended."""

    seconds: float
    reason: str


class Source(Actor):
    """Receive the journal (internal messages) of one process of the robot. Connect again whenever the
    connection is lost.

    Args:
        name: The process: ``wire`` or ``root``.
        instrument: The address of the actor that sends the journal of this process.
        on_batch: Called with each batch of entries, in order.
        on_attached: Called with the process's answer to each request to send its journal.
        on_lost: Called with the reason when the connection is lost.
    """

    def __init__(
        self,
        name: str,
        instrument: str,
        on_batch: Callable[[str, Batch], None],
        on_attached: Callable[[str, Attached | Taken | Refused], None],
        on_lost: Callable[[str, str], None],
    ) -> None:
        self._name = name
        self._instrument_address = instrument
        self._on_batch = on_batch
        self._on_attached = on_attached
        self._on_lost = on_lost
        self._session = os.getpid() << 20
        self._number = 0
        self._lost = trio.Event()
        self._reason = ""
        self.attached = False
        self.last_received_at = trio.current_time()

    async def started(self) -> None:
        self._instrument = self.context.ref(self._instrument_address, InstrumentKeeper)
        self.context.start_soon(self._keep_attached)

    def receive(self, message: Batch | Down) -> None:
        if isinstance(message, Down):
            self._lose(f"the {self._name} process ended or cannot be reached")
        elif message.session == self._session and self.attached:
            if message.number != self._number + 1:
                self._lose(f"batches {self._number + 1} to {message.number - 1} did not arrive")
                return
            self._number = message.number
            self.last_received_at = trio.current_time()
            self._on_batch(self._name, message)
            self._instrument.tell(Acknowledge(self._session, message.number))

    def _lose(self, reason: str) -> None:
        self._reason = reason
        self._lost.set()

    async def _keep_attached(self) -> None:
        while True:
            answer = await self._attach()
            self._on_attached(self._name, answer)
            if isinstance(answer, Taken | Refused):
                await trio.sleep(ASK_S)
                continue
            await self._until_lost()
            self.attached = False
            self._on_lost(self._name, self._reason)

    async def _attach(self) -> Attached | Taken | Refused:
        while True:
            self._session += 1
            self._number = 0
            self._lost = trio.Event()
            # Set this before the answer arrives, because the first batch may arrive earlier than the answer.
            self.attached = True
            try:
                answer = await self._instrument.ask(
                    Attach(self.context.address, self._session, f"process {os.getpid()}", pid=os.getpid()),
                    ASK_S,
                )
            except (AskTimeout, Unreachable):
                answer = None
            if isinstance(answer, Attached | Taken | Refused):
                self.attached = isinstance(answer, Attached)
                return answer
            self.attached = False
            await trio.sleep(RETRY_S)

    async def _until_lost(self) -> None:
        self.context.watch(self._instrument_address)
        self.last_received_at = trio.current_time()
        while not self._lost.is_set():
            last_received_at = self.last_received_at
            with trio.move_on_after(SILENT_S):
                await self._lost.wait()
            if not self._lost.is_set() and self.last_received_at == last_received_at:
                self._lose(f"the {self._name} process has sent nothing for {SILENT_S:g} s")

    async def detach(self) -> None:
        """Disconnect. The robot's process first sends its remaining entries."""
        if self.attached:
            try:
                answer = await self._instrument.ask(Detach(self._session), DETACH_S)
            except (AskTimeout, Unreachable):
                answer = None
            if not isinstance(answer, Detached):
                reason = (
                    answer.reason
                    if isinstance(answer, Refused)
                    else "the process did not confirm the end of its journal"
                )
                self._on_lost(self._name, reason)


class Recorder(Generic[SomeSink]):
    """Pass the journals (internal messages) of a robot's processes to a sink, such as a file.

    Args:
        robot: The name of the robot.
        open_sink: Makes the sink. It is called with the wire process's answer, once the wire process and the
            root process have answered.
        on_progress: Called once a second, with the length of the recording in seconds and the sink.
    """

    def __init__(
        self,
        robot: str,
        open_sink: Callable[[Attached], SomeSink],
        on_progress: Callable[[float, SomeSink], None] = lambda seconds, sink: None,
    ) -> None:
        self._robot = robot
        self._open_sink = open_sink
        self._on_progress = on_progress
        # The answers of the processes, by name. The recording begins when both have answered.
        self._present: dict[str, Attached] = {}
        self._early: list[tuple[str, Batch]] = []  # Batches that have arrived before both processes had answered.
        self._sink: SomeSink | None = None
        self._failure: Exception | None = None
        self._ended = ""
        self._refused = ""  # The reason of the robot's last refusal.
        self._over = trio.Event()
        self._sources: list[Source] = []
        self._began = trio.current_time()

    def end(self, reason: str) -> None:
        """End the recording. Only the first reason is kept."""
        self._ended = self._ended or reason
        self._over.set()

    async def run(self, node: Node, seconds: float | None = None) -> Ending:
        """Record for ``seconds``, or until ``end`` is called or the robot has ended.

        Args:
            node: A connection to the robot, from ``visit``.
            seconds: How long to record; None for no limit.

        Raises:
            RecordingError: The robot cannot be recorded, or has ended before the recording began.
            OSError: The sink has failed.
        """
        try:
            async with trio.open_nursery() as nursery:
                for name in SOURCES:
                    await nursery.start(self._cell(node, name).run)
                nursery.start_soon(self._watch)
                with trio.move_on_after(float("inf") if seconds is None else seconds):
                    await self._over.wait()
                self.end(f"{seconds} s are over")
                # Detach even after a failure. Otherwise the robot would refuse the next recorder, because it
                # serves only one recorder at a time.
                with trio.move_on_after(float("inf") if self._failure is None else LEAVE_S):
                    async with trio.open_nursery() as leaving:
                        for source in self._sources:
                            leaving.start_soon(source.detach)
                nursery.cancel_scope.cancel()
        finally:
            self._close()
        if self._sink is None:
            raise RecordingError(f"{self._robot}: the recording ended before it began ({self._ended})")
        return Ending(round(trio.current_time() - self._began, 3), self._ended)

    def _cell(self, node: Node, name: str) -> Cell:
        instrument = f"{PREFIX}/{addresses.of(self._robot).instrument(name)}"
        source = Source(name, instrument, self._batch, self._attached, self._lost)
        self._sources.append(source)
        return node.cell(f"recorder.{os.getpid()}/actor/{name}", lambda: source)

    async def _watch(self) -> None:
        while True:
            await trio.sleep(FLUSH_S)
            now = trio.current_time()
            if self._sink is None:
                if now > self._began + FIRST_S:
                    if self._refused:
                        self.fail(RecordingError(self._refused))
                        return
                    silent = next(name for name in SOURCES if name not in self._present)
                    self.fail(RecordingError(f"{self._robot}: its {silent} process does not answer"))
                continue
            self._written(self._sink.flush)
            self._on_progress(now - self._began, self._sink)
            if not any(source.attached for source in self._sources):
                last_received_at = max(source.last_received_at for source in self._sources)
                if now > last_received_at + GONE_S:
                    self.end(GONE)

    # -- called by the sources (``Source``)

    def _attached(self, name: str, answer: Attached | Taken | Refused) -> None:
        if isinstance(answer, Taken | Refused):
            self._refused = f"{self._robot}: {answer.text}"
            # If the other recorder was killed, the robot soon notices this. Ask again until then.
            if self._sink is None and not _is_of_the_dead(answer):
                self.fail(RecordingError(self._refused))
        elif self._sink is None and self._failure is None:
            self._present[name] = answer
            if len(self._present) == len(SOURCES):
                self._written(self._start, self._present["wire"])

    def _start(self, attached: Attached) -> None:
        self._sink = sink = self._open_sink(attached)
        for name, batch in self._early:
            sink.add(name, batch)
        self._early.clear()

    def _batch(self, name: str, batch: Batch) -> None:
        if self._sink is None:
            self._early.append((name, batch))
        else:
            self._written(self._sink.add, name, batch)

    def _lost(self, name: str, reason: str) -> None:
        self._present.pop(name, None)
        self._early = [(source, batch) for source, batch in self._early if source != name]
        if self._sink is not None:
            self._written(self._sink.lost, name, reason)

    # -- the sink

    def _written(self, write: Callable[..., None], *args: object) -> None:
        """Write to the sink. A failure such as a full disk ends the recording, and does not affect the
        robot."""
        if self._failure is None:
            try:
                write(*args)
            except (OSError, RecordingError) as failure:
                self.fail(failure)

    def fail(self, failure: Exception) -> None:
        """End the recording with an exception, which ``run`` raises."""
        self._failure = failure
        self._over.set()

    def _close(self) -> None:
        if self._sink is not None:
            try:
                self._sink.close()
            except (OSError, RecordingError) as failure:
                self._failure = self._failure or failure
        if self._failure is not None:
            raise self._failure


def _is_of_the_dead(answer: Taken | Refused) -> bool:
    """Return True if a robot refuses because of another recorder whose process has ended."""
    if not isinstance(answer, Taken) or not answer.pid:
        return False
    return not exists(answer.pid) or life_of(answer.pid).dying


@asynccontextmanager
async def visit(robot: str) -> AsyncIterator[Node]:
    """Open a connection to a running robot of this user. Raise ``RecordingError`` if no robot of this name
    runs."""
    running = {note.robot: note for note in notes()}
    if robot not in running:
        listed = f". There are {', '.join(running)}" if running else ""
        raise RecordingError(f"no robot {robot!r} of this user is running{listed}")
    async with open_node(f"recorder.{os.getpid()}", connect=running[robot].endpoints) as (node, _):
        yield node
