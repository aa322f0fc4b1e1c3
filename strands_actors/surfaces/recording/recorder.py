"""The recorder: a process of its own that attaches to a running robot and writes what it is told.

The robot owes it nothing. When it is slow, frozen or dead the robot's instruments fill up or close
by themselves; when the robot's processes die it says so in the file, and attaches again as soon as
there is somebody to attach to.
"""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import trio

from strands_actors.caller.background import open_background
from strands_actors.caller.nodes import open_node
from strands_actors.caller.run_directory import notes
from strands_actors.kernel.actor import Actor, Cell
from strands_actors.kernel.frames import Down
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import PREFIX, AskTimeout, Node, Unreachable
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
)

from .code import driver_class_of, fingerprint
from .errors import RecordingError
from .file import RecordingFile, new_info

SOURCES = ("wire", "root")
FIRST_S = 5.0
"""How long to wait for the wire process at the beginning."""
ASK_S = 0.5
RETRY_S = 0.02
GONE_S = 2.0
"""A robot none of whose processes has answered for so long has ended."""
DETACH_S = 1.0
FLUSH_S = 1.0


class Summary(msgspec.Struct):
    path: str
    robot: str
    seconds: float
    bytes: int
    commands: int
    refusals: int
    observations: int
    safe: int
    gaps: int
    ended: str  # why the recording ended


class Source(Actor):
    """The recorder's end of one instrument. ``on_batch``, ``on_attached`` and ``on_lost`` are
    called in order."""

    def __init__(
        self,
        name: str,
        instrument: str,
        on_batch: Callable[[str, Batch], None],
        on_attached: Callable[[str, Attached | Refused], None],
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
        self._why = ""
        self.attached = False
        self.heard_at = trio.current_time()

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
            self.heard_at = trio.current_time()
            self._on_batch(self._name, message)
            self._instrument.tell(Acknowledge(self._session, message.number))

    def _lose(self, why: str) -> None:
        self._why = why
        self._lost.set()

    async def _keep_attached(self) -> None:
        while True:
            answer = await self._attach()
            self._on_attached(self._name, answer)
            if isinstance(answer, Refused):
                await trio.sleep(ASK_S)
                continue
            await self._until_lost()
            self.attached = False
            self._on_lost(self._name, self._why)

    async def _attach(self) -> Attached | Refused:
        while True:
            self._session += 1
            self._number = 0
            self._lost = trio.Event()
            self.attached = True  # the first batch may overtake the answer
            try:
                answer = await self._instrument.ask(
                    Attach(self.context.address, self._session, f"process {os.getpid()}"), ASK_S
                )
            except (AskTimeout, Unreachable):
                answer = None
            if isinstance(answer, Attached | Refused):
                self.attached = isinstance(answer, Attached)
                return answer
            self.attached = False
            await trio.sleep(RETRY_S)

    async def _until_lost(self) -> None:
        self.context.watch(self._instrument_address)
        self.heard_at = trio.current_time()
        while not self._lost.is_set():
            heard_at = self.heard_at
            with trio.move_on_after(SILENT_S):
                await self._lost.wait()
            if not self._lost.is_set() and self.heard_at == heard_at:
                self._lose(f"nothing came from the {self._name} process for {SILENT_S:g} s")

    async def detach(self) -> None:
        """Have the rest sent."""
        if self.attached:
            try:
                answer = await self._instrument.ask(Detach(self._session), DETACH_S)
            except (AskTimeout, Unreachable):
                answer = None
            if not isinstance(answer, Detached):
                self._on_lost(self._name, "it did not say good-bye")


class Recorder:
    """Writes one robot's recording. ``on_started``: it is under way. ``on_progress``: once a
    second, with the seconds it runs."""

    def __init__(
        self,
        robot: str,
        path: Path,
        on_started: Callable[[], None] = lambda: None,
        on_progress: Callable[[float, RecordingFile], None] = lambda seconds, file: None,
    ) -> None:
        self._robot = robot
        self._path = path
        self._on_started = on_started
        self._on_progress = on_progress
        self._early: list[tuple[str, Batch]] = []  # what came before the wire process had presented itself
        self._file: RecordingFile | None = None
        self._failure: Exception | None = None
        self._ended = ""
        self._over = trio.Event()
        self._sources: list[Source] = []
        self._began = trio.current_time()

    def end(self, why: str) -> None:
        self._ended = self._ended or why
        self._over.set()

    async def run(self, node: Node, seconds: float | None = None) -> Summary:
        """Until ``seconds`` are over, ``end`` is called, or the robot is gone. Raise
        ``RecordingError`` or ``OSError``."""
        try:
            async with trio.open_nursery() as nursery:
                for name in SOURCES:
                    await nursery.start(self._cell(node, name).run)
                nursery.start_soon(self._watch)
                with trio.move_on_after(float("inf") if seconds is None else seconds):
                    await self._over.wait()
                self.end(f"{seconds} s are over")
                if self._failure is None:
                    async with trio.open_nursery() as leaving:
                        for source in self._sources:
                            leaving.start_soon(source.detach)
                nursery.cancel_scope.cancel()
        finally:
            self._close()
        return self._summary()

    def _cell(self, node: Node, name: str) -> Cell:
        instrument = f"{PREFIX}/{addresses.of(self._robot).instrument(name)}"
        source = Source(name, instrument, self._batch, self._attached, self._lost)
        self._sources.append(source)
        return node.cell(f"recorder.{os.getpid()}/actor/{name}", lambda: source)

    async def _watch(self) -> None:
        while True:
            await trio.sleep(FLUSH_S)
            now = trio.current_time()
            if self._file is None:
                if now > self._began + FIRST_S:
                    self._fail(RecordingError(f"{self._robot}: its wire process does not answer"))
                continue
            self._written(self._file.flush)
            self._on_progress(now - self._began, self._file)
            if not any(source.attached for source in self._sources):
                heard_at = max(source.heard_at for source in self._sources)
                if now > heard_at + GONE_S:
                    self.end("the robot is gone")

    # -- from the sources

    def _attached(self, name: str, answer: Attached | Refused) -> None:
        if isinstance(answer, Refused):
            if self._file is None:
                self._fail(RecordingError(f"{self._robot}: {answer.text}"))
        elif name == "wire" and self._file is None and self._failure is None:
            self._written(self._start, answer)

    def _start(self, attached: Attached) -> None:
        try:
            code = fingerprint(driver_class_of(attached.driver))
        except RecordingError:
            code = ""  # driven by a class that is not registered: the rows are there, a replay is not
        self._file = file = RecordingFile(self._path, new_info(self._robot, code, attached))
        self._on_started()
        for name, batch in self._early:
            file.add(name, batch)
        self._early.clear()

    def _batch(self, name: str, batch: Batch) -> None:
        if self._file is None:
            self._early.append((name, batch))
        else:
            self._written(self._file.add, name, batch)

    def _lost(self, name: str, why: str) -> None:
        self._early = [(source, batch) for source, batch in self._early if source != name]
        if self._file is not None:
            self._written(self._file.lost, name, why)

    # -- the file

    def _written(self, write: Callable[..., None], *args: object) -> None:
        """A full disk ends the recording, with its reason, and nothing else."""
        if self._failure is None:
            try:
                write(*args)
            except OSError as failure:
                self._fail(failure)

    def _fail(self, failure: Exception) -> None:
        self._failure = failure
        self._over.set()

    def _close(self) -> None:
        if self._file is not None:
            try:
                self._file.close()
            except OSError as failure:
                self._failure = self._failure or failure
        if self._failure is not None:
            raise self._failure

    def _summary(self) -> Summary:
        if self._file is None:
            raise RecordingError(f"{self._robot}: {self._ended} before anything was recorded")
        counts = self._file.counts
        return Summary(
            str(self._path),
            self._robot,
            round(trio.current_time() - self._began, 3),
            self._path.stat().st_size,
            counts["command"],
            counts["refusal"],
            counts["observation"],
            counts["safe"],
            counts["gap"],
            self._ended,
        )


def _require_free(path: Path) -> None:
    if path.exists():
        raise RecordingError(f"{path} is there already. give another name, or remove it")


@asynccontextmanager
async def visit(robot: str) -> AsyncIterator[Node]:
    """A node joined to a running robot. Raise ``RecordingError`` when there is none of that
    name."""
    running = {note.robot: note for note in notes()}
    if robot not in running:
        there = f". there are {', '.join(running)}" if running else ""
        raise RecordingError(f"no robot {robot!r} of this user is running{there}")
    async with open_node(f"recorder.{os.getpid()}", connect=running[robot].endpoints) as (node, _):
        yield node


async def record_until_told(
    robot: str,
    path: Path,
    seconds: float | None,
    on_started: Callable[[], None],
    on_progress: Callable[[float, RecordingFile], None],
) -> Summary:
    """Until Ctrl-C, SIGTERM, or as ``Recorder.run``. In the main thread."""
    _require_free(path)
    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with visit(robot) as node, open_background() as nursery:
            recorder = Recorder(robot, path, on_started, on_progress)

            async def listen() -> None:
                async for _ in signals:
                    recorder.end("interrupted")

            nursery.start_soon(listen)
            return await recorder.run(node, seconds)
