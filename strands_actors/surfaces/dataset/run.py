"""Run the recorder process of a dataset: connect to the robot, open the dataset, and carry out the commands of
the demonstrator (the person that shows the task)."""

from __future__ import annotations

import os
import signal
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Protocol

import msgspec
import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.supervisors import addresses
from strands_actors.supervisors.instrument import Attached
from strands_actors.supervisors.root.messages import EpisodeState
from strands_actors.supervisors.root.tasks import Tasks
from strands_actors.surfaces.recording.recorder import Recorder, visit

from .cameras import Attach, attach_camera, wait_for_shapes
from .dataset import Dataset
from .errors import DatasetError
from .order import Event, Order, Progress, State
from .second.follower import Follower
from .second.place import require_url
from .session import DatasetSession
from .storage import Storage
from .video import require_codec

FPS = (1, 240)


class Command(Protocol):
    """The signature of ``DatasetSession.command``."""

    def __call__(self, word: str, pressed_ns: int = 0, command_number: int = 0) -> None: ...


Controls = Callable[[Command], Awaitable[None]]
"""Reads commands from somewhere, and calls its argument with each, until it is cancelled."""


class Onlooker:
    """Keeps the newest state of the recording, for the web pages that show it to a remote operator."""

    def __init__(self, tell: Callable[[EpisodeState], None] = lambda state: None) -> None:
        self._tell = tell
        self.state = EpisodeState()

    def add_event(self, event: Event) -> None:
        running = event.type == "started" or (event.type in ("refused", "copy") and self.state.running)
        self._show(msgspec.structs.replace(self.state, running=running, last_event=event.line))

    def show(self, progress: Progress) -> None:
        running = progress.state == State.RECORDING
        self._show(msgspec.structs.replace(self.state, running=running, text=progress.line))

    def _show(self, state: EpisodeState) -> None:
        self.state = state
        self._tell(state)


class EpisodeSummary(msgspec.Struct, frozen=True):
    episode: int
    frames: int
    seconds: float
    gaps: int
    defects: str = msgspec.field(name="marks")


class Summary(msgspec.Struct, frozen=True):
    dataset: str
    robot: str
    seconds: float
    episodes: list[EpisodeSummary]  # The episodes of this recording.
    total_episodes: int
    # Files that belonged to no episode when the dataset was opened. They were moved to .staging/uncounted.
    moved_strays: list[str] = msgspec.field(name="swept")
    # What remains to be repaired, as text. Empty if the last episode is complete.
    remaining: str = msgspec.field(name="left")
    ended: str
    # The missing episodes of the second place, as text. Empty if it has all, or if no place was given.
    not_copied: str = ""


def require_order(order: Order) -> None:
    """Check the options of a recording. Raise ``DatasetError`` if an option is wrong."""
    if not isinstance(order.task, str) or not order.task.strip():
        raise DatasetError("task is missing. Give a sentence that describes the task")
    if type(order.fps) is not int or not FPS[0] <= order.fps <= FPS[1]:
        raise DatasetError(f"fps is {order.fps!r}. Give a whole number from {FPS[0]} to {FPS[1]}")
    if len(set(order.cameras)) < len(order.cameras):
        raise DatasetError(f"cameras is {', '.join(order.cameras)}. Give each camera once")
    if order.codec is not None:
        require_codec(order.codec, [])
    if order.copy_to:
        require_url(order.copy_to, Path(order.root))


async def record_episodes(
    order: Order,
    controls: Controls,
    tell: Callable[[Event], None],
    show: Callable[[Progress], None] = lambda progress: None,
    attach: Attach = attach_camera,
    storage: Storage | None = None,
) -> Summary:
    """Record episodes until the command ``quit``, the last requested episode, Ctrl-C, or the end of the robot.

    Call this in the main thread, since it receives signals.

    Args:
        order: The options of the recording.
        controls: Function that reads the demonstrator's commands and passes them on.
        tell: Called with each event.
        show: Called with the progress, once per second.
        attach: Opens a camera; a test may replace it.
        storage: The disk; a test may replace it.

    Raises:
        RecordingError: The robot, a camera or the dataset cannot be used.
        OSError: The disk cannot be written.
    """
    require_order(order)
    dataset = Dataset(Path(order.root), storage)
    try:
        return await _record(order, dataset, controls, tell, show, attach)
    finally:
        dataset.close()


async def _record(
    order: Order,
    dataset: Dataset,
    controls: Controls,
    tell: Callable[[Event], None],
    show: Callable[[Progress], None],
    attach: Attach,
) -> Summary:
    codec = dataset.codec_for(order.codec)
    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with visit(order.robot) as node, open_background() as nursery:
            readers = {name: attach(order.robot, name) for name in order.cameras}
            shapes = await trio.to_thread.run_sync(wait_for_shapes, readers, abandon_on_cancel=True)
            require_codec(codec, shapes)
            recorder: Recorder[DatasetSession]
            operator = Onlooker(node.ref(addresses.of(order.robot).tasks, Tasks).tell)

            def on_event(event: Event) -> None:
                operator.add_event(event)
                tell(event)

            follower = Follower(order.root, order.copy_to, lambda text: on_event(Event("copy", text=text)))
            if order.copy_to:
                nursery.start_soon(follower.run)
                await follower.require_accepted()
            session = DatasetSession(
                order,
                dataset,
                readers,
                shapes,
                on_event,
                end=lambda reason: recorder.end(reason),
                fail=lambda failure: recorder.fail(failure),
            )
            begun = trio.Event()

            def open_sink(attached: Attached) -> DatasetSession:
                opened = session.open_sink(attached)
                begun.set()
                return opened

            def progress(seconds: float, session: DatasetSession) -> None:
                if session.is_ready:
                    try:
                        now = session.progress()
                    except (DatasetError, OSError) as failure:
                        recorder.fail(failure)
                        return
                    operator.show(now)
                    show(now)

            async def after(run: Callable[[], Awaitable[None]]) -> None:
                await begun.wait()
                await run()

            async def listen() -> None:
                async for _ in signals:
                    recorder.end("interrupted")

            recorder = Recorder(order.robot, open_sink, progress)
            nursery.start_soon(listen)
            nursery.start_soon(after, session.run)
            nursery.start_soon(after, session.work)
            nursery.start_soon(after, lambda: controls(session.command))
            try:
                ending = await recorder.run(node)
            finally:
                with trio.CancelScope(shield=True):
                    remaining = await session.leave()
                    not_copied = await follower.leave(len(dataset.episodes)) if order.copy_to else ""
                for reader in readers.values():
                    reader.close()
    saved = [
        EpisodeSummary(
            episode.index,
            episode.frames,
            round(episode.frames / order.fps, 3),
            episode.quality.gaps,
            episode.quality.as_text,
        )
        for episode in session.saved
    ]
    return Summary(
        order.root,
        order.robot,
        ending.seconds,
        saved,
        len(dataset.episodes),
        dataset.moved_strays,
        remaining,
        ending.reason,
        not_copied,
    )


def give_way() -> None:
    """Lower the priority of this process, so that the robot's processes run first on a busy computer."""
    os.nice(10)
