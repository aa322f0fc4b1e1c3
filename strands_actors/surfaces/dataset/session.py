"""Record episodes of one robot. The commands of the demonstrator (the person that shows the task) begin and end
each episode.

A recorder delivers the robot's journal (its internal messages) to the session. Each period, the session takes
the newest picture of each camera and queues a frame. The module ``frames`` builds the frames. A worker thread
encodes and writes them. If the worker is too slow, frames are dropped, and the episode counts them as gaps.

The states are IDLE (between episodes), RECORDING, and FINISHING (the last frames wait for entries of the
journal).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import aclosing

import msgspec
import numpy as np
import trio

from strands_actors.kernel.clock import NS, Clock, MonotonicClock
from strands_actors.supervisors.instrument import Attached, Batch
from strands_actors.surfaces.recording.views import View, decode_entries, keys_pressed

from .cameras import CameraReader, frame_of
from .dataset import Dataset
from .episode import Episode
from .errors import DatasetError
from .frames import Assembler, Axes, BuiltFrame, missed
from .layout import CameraShape, Layout
from .order import Event, Order, Progress, State
from .robot_axes import axes_of
from .staging import Picture
from .video import VideoError
from .worker import Worker
from .writer import EpisodeWriter

QUEUE_FRAMES = 60
QUEUE_BYTES = 128 << 20
"""Longest queue for the disk and the encoders: the smaller of these two limits applies."""
LEAST_FREE_BYTES = 256 << 20
"""No episode begins with less free space on the disk."""
FIRST_S = 10.0
"""How long to wait for the robot's first state, in seconds."""
ABSENT_S = 1.0
"""If an optional axis is in no state for so long, in seconds, the robot does not have it. One state without it
is no proof."""
PRESSED_NS = NS
"""A key that was pressed longer ago is ignored. By then the operator has seen that it had no effect."""
LEAVE_S = 20.0
"""Longest time for the worker to finish its queue at the end, in seconds."""


class DatasetSession:
    """One recording of episodes. A ``Recorder`` delivers the robot's journal (its internal messages) to it."""

    def __init__(
        self,
        order: Order,
        dataset: Dataset,
        cameras: Mapping[str, CameraReader],
        shapes: Sequence[CameraShape],
        tell: Callable[[Event], None],
        end: Callable[[str], None],
        fail: Callable[[Exception], None],
        clock: Clock | None = None,
    ) -> None:
        self._order = order
        self._dataset = dataset
        self._cameras = cameras
        self._shapes = tuple(shapes)
        self._tell = tell
        self._end = end
        self._fail = fail
        self._clock = clock or MonotonicClock()
        self._period_ns = round(NS / order.fps)
        size = max(1, sum(shape.height * shape.width * 3 for shape in shapes))
        self._worker = Worker(max(2, min(QUEUE_FRAMES, QUEUE_BYTES // size)))
        self._state = State.IDLE
        self.is_ready = self._leaving = self._has_ended = False
        self._number = len(dataset.episodes)  # Number of the running episode, or of the next episode.
        self._finish_command_number = 0  # Number of the command that has ended the running episode.
        self._finished = 0
        self._writer = EpisodeWriter(dataset, order.task)  # Used in the worker's thread.
        self._shown: dict[str, tuple[Picture, int]] = {}
        self._began_ns = self._last_ns = self._first_ns = 0
        self._frames = self._gaps = self._late = 0  # Counters of the running episode.
        self._frames_since = 0  # Number of frames since the last call of ``progress``.
        self.saved: list[Episode] = []

    # -- the sink

    def open_sink(self, attached: Attached) -> DatasetSession:
        self._robot_type = f"strands_{attached.driver['robot']}"
        self._view = View("wire", attached.axes, 0)
        self._assembler = Assembler(axes_of(attached), self._period_ns / NS)
        self._opened_ns = self._clock.now_ns()
        return self

    def _about(self) -> str:
        shown = ", ".join(f"{shape.name} {shape.width}x{shape.height}" for shape in self._shapes) or "no cameras"
        return f"{self._order.robot} into {self._order.root}: {self._order.fps} fps, {shown}"

    def add(self, source: str, batch: Batch) -> None:
        entries = decode_entries(msgspec.msgpack.encode(batch.entries))
        if source == "wire":
            self._assembler.add_entries(self._view.rows(entries))
            return
        for key in keys_pressed(entries):
            self.command(key.word, key.t_ns)

    def lost(self, source: str, reason: str) -> None:
        if source == "wire":
            self._assembler.add_entries(self._view.lost(self._clock.now_ns(), reason))

    def flush(self) -> None:
        """Do nothing. All built frames are already queued for the worker thread."""

    def close(self) -> None:
        """Do nothing. The worker thread may still write, and ``leave`` waits for it."""

    # -- the demonstrator's commands

    def command(self, word: str, pressed_ns: int = 0, command_number: int = 0) -> None:
        """Carry out a command of the demonstrator. The result is reported as an ``Event``.

        Args:
            word: ``start``, ``finish``, ``discard``, ``again`` or ``quit``; ``toggle`` starts or finishes.
            pressed_ns: When a remote operator pressed the key, in nanoseconds of CLOCK_MONOTONIC; 0 for
                a local command.
            asked: The number of the command. The event that answers the command has the same number. 0 means no
                number.
        """
        if pressed_ns and (late_ns := self._clock.now_ns() - pressed_ns) > PRESSED_NS:
            self._refuse(
                f"{word}: the key press arrived {late_ns / NS:.1f} s late. Press the key again", command_number
            )
            return
        if word == "toggle":
            word = "finish" if self._state is State.RECORDING else "start"
        do = {
            "start": self._start,
            "finish": self._finish,
            "discard": self._discard,
            "again": self._again,
            "quit": self._quit,
        }.get(word)
        if do is None:
            self._refuse(
                f"there is no command {word[:40]!r}. Use start, finish, discard, again or quit", command_number
            )
        else:
            do(command_number)

    def _refuse(self, reason: str, command_number: int) -> None:
        self._tell(Event("refused", self._number, text=reason, command_number=command_number))

    def _start(self, command_number: int = 0) -> None:
        if reason := self._cannot_start():
            self._refuse(f"start: {reason}", command_number)
            return
        self._assembler.begin()
        self._state = State.RECORDING
        self._began_ns = self._clock.now_ns()
        self._last_ns = self._frames = self._gaps = self._late = 0
        self._worker.put(lambda: self._writer.open(self._layout))
        self._tell(Event("started", self._number, command_number=command_number))

    def _cannot_start(self) -> str:
        if self._leaving:
            return "the recording ends"
        if self._state is State.RECORDING:
            return "an episode is running. Finish or discard it first"
        if self._state is State.FINISHING:
            return "the last frames of the previous episode are still being saved. Try again"
        if self._order.episodes is not None and self._finished >= self._order.episodes:
            return "the last episode is being saved"
        if not self._assembler.has_state(self._clock.now_ns()):
            return self._nothing_read()
        if not self.is_ready:
            return f"it is not known yet which axes {self._order.robot} has. Try again in {ABSENT_S:g} s"
        if dark := [name for name, reader in self._cameras.items() if frame_of(reader.newest()) is None]:
            return f"no new picture of {', '.join(dark)}. Check the camera"
        try:
            free = self._dataset.free_bytes()
        except (DatasetError, OSError) as problem:
            return str(problem)
        if free < LEAST_FREE_BYTES:
            return f"the disk has {free / 1e6:.0f} MB left, an episode needs {LEAST_FREE_BYTES / 1e6:.0f}"
        return ""

    def _finish(self, command_number: int = 0) -> None:
        if self._state is not State.RECORDING:
            self._refuse("finish: no episode is running", command_number)
            return
        self._state = State.FINISHING
        self._finish_command_number = command_number

    def _discard(self, command_number: int = 0) -> None:
        if self._state is State.IDLE:
            self._refuse("discard: no episode is running", command_number)
            return
        # A script still waits for the answer to its command ``finish``.
        if self._state is State.FINISHING and self._finish_command_number:
            self._refuse("finish: the episode was discarded meanwhile", self._finish_command_number)
        self._state = State.IDLE
        self._assembler.begin()
        self._worker.put(self._writer.drop)
        self._tell(Event("discarded", self._number, command_number=command_number))

    def _again(self, command_number: int = 0) -> None:
        if self._state is not State.IDLE:
            self._discard(command_number)
        self._start(command_number)

    def _quit(self, command_number: int = 0) -> None:
        """End the recording. A running episode is finished first."""
        self._leaving = True
        if self._state is State.RECORDING:
            self._finish(command_number)
        elif self._state is State.IDLE:
            self._worker.put(lambda: trio.from_thread.run_sync(self._end, "done"))

    # -- frames

    async def run(self) -> None:
        """Queue a frame each period, until cancelled."""
        async with aclosing(self._clock.ticks(self._period_ns / NS)) as ticks:
            async for now_ns in ticks:
                self.tick(now_ns)

    async def work(self) -> None:
        """Run the worker that writes frames, until cancelled. An error of the worker ends the recording."""
        try:
            await self._worker.run()
        except (OSError, DatasetError) as failure:
            self._fail(failure)
        except VideoError as failure:
            self._fail(DatasetError(f"a video cannot be written: {failure}"))

    def tick(self, now_ns: int) -> None:
        if self._has_ended:
            return
        if not self.is_ready:
            self._look_whether_ready(now_ns)
            return
        if self._state is State.RECORDING:
            self._due(now_ns)
        for frame in self._assembler.frames(now_ns):
            self._queue(frame)
        if self._state is State.FINISHING and not self._assembler.waiting:
            self._state = State.IDLE
            gap, command_number = self._assembler.take_gap(), self._finish_command_number
            self._gaps += gap
            self._worker.put(lambda: self._save_episode(gap, command_number))
            self._number += 1
            self._finished += 1
            if self._leaving:
                self._quit()
        if self._order.seconds is not None:
            self._by_itself(now_ns, self._order.seconds)

    def _look_whether_ready(self, now_ns: int) -> None:
        if self._assembler.has_state(now_ns):
            self._first_ns = self._first_ns or now_ns
            if not self._assembler.has_all and now_ns - self._first_ns < ABSENT_S * NS:
                return
            try:
                self._layout = self._layout_of(self._assembler.leave_out_absent())
            except DatasetError as refused:
                self._fail(refused)
                return
            self.is_ready = True
            self._tell(Event("ready", self._number, text=self._about()))
        elif now_ns - self._opened_ns > FIRST_S * NS:
            self._fail(DatasetError(self._nothing_read()))

    def _layout_of(self, axes: Axes) -> Layout:
        codec = self._dataset.codec_for(self._order.codec)
        return self._dataset.require(
            Layout(
                self._robot_type,
                self._order.fps,
                axes.joints,
                self._shapes,
                codec,
                axes.units,
                axes.read_only_joints,
            )
        )

    def _nothing_read(self) -> str:
        unread = ", ".join(self._assembler.unread)
        return f"no readings of {f'{unread} of ' if unread else ''}{self._order.robot}. Check the robot"

    def _by_itself(self, now_ns: int, seconds: float) -> None:
        if self._state is State.RECORDING and now_ns - self._began_ns >= seconds * NS:
            self._finish()
        elif self._state is State.IDLE and not self._worker.is_busy and not self._cannot_start():
            self._start()

    def _due(self, now_ns: int) -> None:
        self._assembler.count_missing(missed(now_ns, self._last_ns, self._period_ns))
        self._last_ns = now_ns
        pictures, age_ms = {}, {}
        for name, reader in self._cameras.items():
            frame = frame_of(reader.newest())
            shown = self._shown.get(name)
            if frame is not None and (shown is None or frame.captured_ns != shown[1]):
                # Copy the picture, because the camera may overwrite the memory in which it is.
                shown = self._shown[name] = np.array(frame.image), frame.captured_ns
            if shown is None:
                # The camera has no picture any more. An episode begins only if each camera has one.
                self._assembler.count_missing()
                return
            pictures[name], captured_ns = shown
            age_ms[name] = max(0.0, (now_ns - captured_ns) / 1e6)
        self._assembler.due(now_ns, pictures, age_ms)

    def _queue(self, frame: BuiltFrame) -> None:
        if self._worker.is_full:
            self._assembler.count_missing(frame.row.gap + 1)
            return
        self._frames += 1
        self._frames_since += 1
        self._gaps += frame.row.gap
        self._late += bool(frame.row.stale)
        self._worker.put(lambda: self._writer.add(frame), frames=1)

    # -- in the worker's thread

    def _save_episode(self, gap: int, command_number: int) -> None:
        episode = self._writer.save(gap)
        if episode is None:
            trio.from_thread.run_sync(self._not_saved, command_number)
        else:
            trio.from_thread.run_sync(self._saved, episode, command_number)

    def _not_saved(self, command_number: int) -> None:
        self._number -= 1
        self._finished -= 1
        self._refuse("finish: the episode had no frames, so it was not saved", command_number)

    def _saved(self, episode: Episode, command_number: int) -> None:
        self.saved.append(episode)
        self._tell(
            Event("saved", episode.index, episode.frames, episode.quality.as_text, command_number=command_number)
        )
        if self._order.episodes is not None and len(self.saved) >= self._order.episodes and not self._leaving:
            self._quit()

    # -- the progress and the end of the recording

    def progress(self) -> Progress:
        """Return the progress. Call this once per second: the frames since the last call are shown as the rate.

        Raises:
            DatasetError: The dataset's folder was moved, or its disk unmounted.
            OSError: The disk does not answer.
        """
        runs = self._state is not State.IDLE
        frames, self._frames_since = self._frames_since, 0
        return Progress(
            str(self._state),
            self._number,
            len(self.saved),
            self._order.episodes,
            (self._clock.now_ns() - self._began_ns) / NS if runs else 0.0,
            float(frames),
            self._gaps,
            self._late,
            self._dataset.free_bytes(),
        )

    async def leave(self) -> str:
        """Wait until the worker has written all queued frames, for ``LEAVE_S`` at most.

        Returns:
            What remains to be repaired, as text. Empty if the last episode is complete.
        """
        self._has_ended = True  # From now on, queue no frames.
        with trio.move_on_after(LEAVE_S) as scope:
            await self._worker.drain()
        if scope.cancelled_caught:
            return (
                f"the disk took longer than {LEAVE_S:g} s. "
                "Repair the last episode with `strands-actors dataset repair`"
            )
        if self._writer.abandon():
            return f"the running episode was not finished. `strands-actors dataset repair {self._order.root}`"
        return ""
