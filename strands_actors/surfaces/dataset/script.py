"""Record a dataset from a script: ``with record_dataset(robot, folder, task=...) as recording:``.

The recorder runs in a separate process (``child``). The script sends it commands, and waits for the answers.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Protocol

import msgspec

from strands_actors.contract.shown import shown
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.surfaces.recording.arguments import name_of_robot, name_of_started, path_of

from .errors import DatasetError
from .order import Event, Order
from .run import require_order
from .second import follower
from .second.place import absolute_url
from .session import LEAVE_S

CHILD = f"{__package__}.child"
END_S = LEAVE_S + follower.LEAVE_S + 15.0
"""Timeout of the recorder's end after SIGINT, in seconds."""
READY_S = 60.0
"""Timeout of the recorder's start, in seconds: on a slow computer, with the first state and pictures."""
SILENT_S = 10.0
"""Timeout without any line from the recorder, in seconds. It sends a heartbeat each second."""
ANSWER_S = 300.0
"""Timeout of an answer, in seconds, for a slow disk that has to take an episode."""
KILL_S = 5.0
"""Timeout of the recorder's end after SIGKILL, in seconds."""
SLICE_S = 0.5


class Named(Protocol):
    @property
    def name(self) -> str: ...


def record_dataset(
    robot: str | Named,
    root: str | Path,
    *,
    task: str,
    fps: int = 30,
    cameras: Sequence[str] | str = (),
    codec: str | None = None,
    copy_to: str | Path = "",
) -> DatasetRecording:
    """Record episodes of a robot into a dataset in LeRobot's format.

    Example::

        with record_dataset(arm, "pick", task="pick the cube up", cameras=["wrist"]) as recording:
            with recording.episode():
                ...

    Args:
        robot: A robot, or the name of a running robot. A robot that is not connected yet is connected first.
        root: The folder of the dataset. If a dataset exists in it, the episodes are added.
        task: The task of the episodes, as a sentence.
        fps: Frames per second, from 1 to 240.
        cameras: The names of the robot's cameras.
        codec: The codec of the videos, ``av1`` or ``mpeg4``. None means the codec of the existing videos, or
            ``av1`` for a new dataset.
        copy_to: A second place, to which each finished episode is copied while the next one is recorded: a
            folder, ``s3://bucket/folder`` or ``hf://datasets/user/name``. Empty for none. The recording never
            waits for it.

    Returns:
        The recording, to be used in a ``with`` statement.

    Raises:
        RecordingError: An argument is wrong, or the robot cannot be connected. A running robot is not affected.
    """
    func = "record_dataset"
    name = name_of_robot(func, robot, DatasetError)
    folder = os.path.abspath(path_of(func, "root", root, DatasetError))
    named = (cameras,) if isinstance(cameras, str) else cameras
    if not isinstance(named, Sequence) or not all(isinstance(each, str) and each.strip() for each in named):
        raise DatasetError(f"{func}: cameras is {shown(cameras)}. Give the names of the robot's cameras, in a list")
    order = Order(name, folder, task, fps, tuple(named), codec, copy_to=absolute_url(copy_to))
    require_order(order)
    name_of_started(func, robot, DatasetError)
    return DatasetRecording(order)


class DatasetRecording:
    """A recording in progress. Within its ``with`` block, episodes are recorded one after the other.

    Each method sends a command to the recorder process and waits for its answer.
    """

    def __init__(self, order: Order) -> None:
        self._order = order
        self._process: subprocess.Popen[bytes] | None = None
        self._error_output = bytearray()
        # Events of the recorder. None means that its output has ended.
        self._answers: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._line_count = 0  # Number of lines that the recorder has sent.
        self._ended = ""  # The reason why the recording ended.
        self._command_number = 0  # Number of the last command, counted from 1.
        self.saved: list[dict[str, object]] = []
        """The saved episodes: ``episode`` (its number), ``frames`` and ``marks`` (its defects as text) of each."""
        self.not_copied = ""
        """After the recording: what the second place lacks, as text. Empty if it has every episode."""

    def __enter__(self) -> DatasetRecording:
        self._process = subprocess.Popen(
            [*PYTHON, "-m", CHILD, msgspec.json.encode(self._order).decode()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(),
        )
        # Read the recorder's output all the time, so that the recorder never waits for a full pipe.
        self._listeners = [
            threading.Thread(target=listen, args=(self._process,), daemon=True)
            for listen in (self._read_errors, self._read_events)
        ]
        for listener in self._listeners:
            listener.start()
        try:
            self._wait_for("ready", READY_S, READY_S)
        except BaseException:
            self._kill()
            raise
        return self

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the recording. An episode that is still running stays unfinished, and can be repaired."""
        process = self._process
        if process is None:  # The recorder has already ended, or was killed after a timeout.
            return
        process.send_signal(signal.SIGINT)
        self._wait_for_its_end()
        failure = self._failure() if process.returncode else ""
        self._close()
        if failure and error_type is None:  # Do not hide an exception of the block.
            raise DatasetError(failure)

    def start(self) -> None:
        """Begin an episode.

        Raises:
            RecordingError: The episode cannot begin, for example because a camera has no picture or the disk
                is full.
        """
        self._tell("start", "started")

    def finish(self) -> None:
        """Finish the episode, and wait until it is saved on the disk.

        Raises:
            RecordingError: The episode could not be saved.
        """
        event = self._tell("finish", "saved")
        self.saved.append({"episode": event.episode, "frames": event.frames, "marks": event.defects})

    def discard(self) -> None:
        """Remove the running episode without saving it.

        Raises:
            RecordingError: No episode is running, or the recorder has ended.
        """
        self._tell("discard", "discarded")

    @contextlib.contextmanager
    def episode(self) -> Iterator[None]:
        """Record the block as an episode. If the block raises, the episode is discarded."""
        self.start()
        try:
            yield
        except BaseException:
            with contextlib.suppress(DatasetError):  # Do not hide the exception of the block.
                self.discard()
            raise
        self.finish()

    def _tell(self, word: str, answer: str) -> Event:
        self._command_number += 1
        if self._process is None or self._process.stdin is None:
            raise DatasetError(self._ended or f"{word}: the recording is not open. Call it inside the with block")
        try:
            self._process.stdin.write(f"{self._command_number} {word}\n".encode())
            self._process.stdin.flush()
        except BrokenPipeError:
            return self._raise_reason()
        return self._wait_for(answer, ANSWER_S, SILENT_S)

    def _wait_for(self, event_type: str, within_s: float, silent_s: float) -> Event:
        """Wait for the answer to the last command and return it. Ignore events with other numbers, which come
        from keys on a web page."""
        waited_s = silence_s = 0.0
        line_count = self._line_count
        while waited_s < within_s and silence_s < silent_s:
            try:
                event = self._answers.get(timeout=SLICE_S)
            except queue.Empty:
                # Count the waiting time in short slices. If this script is suspended, the time of the
                # suspension is then not counted as silence of the recorder.
                waited_s += SLICE_S
                silence_s = silence_s + SLICE_S if self._line_count == line_count else 0.0
                line_count = self._line_count
                continue
            if event is None:
                return self._raise_reason()
            if event.command_number != self._command_number:
                continue
            if event.type == event_type:
                return event
            if event.type == "refused":
                raise DatasetError(event.text)
        return self._give_up(f"did not answer ({event_type}) within {min(waited_s, within_s):g} s")

    def _give_up(self, failure: str) -> NoReturn:
        """Kill a recorder that does not answer, and raise ``DatasetError``. The dataset can be repaired
        afterwards."""
        self._kill()
        self._ended = f"the recorder {failure}, so it was killed. {self._remedy()}"
        raise DatasetError(self._ended)

    def _raise_reason(self) -> NoReturn:
        self._wait_for_its_end()
        self._ended = self._failure()
        self._close()
        raise DatasetError(self._ended)

    def _wait_for_its_end(self) -> None:
        assert self._process is not None
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._ended = f"the recorder did not end within {END_S:g} s. {self._remedy()}"
            self._end_it()
        self._join()

    def _failure(self) -> str:
        assert self._process is not None
        error_output = self._error_output.decode(errors="replace").strip()
        return (
            error_output
            or self._ended
            or f"the recorder ended with code {self._process.returncode}. {self._remedy()}"
        )

    def _remedy(self) -> str:
        return f"Save the recorded frames with `strands-actors dataset repair {self._order.root}`"

    def _read_errors(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        while piece := process.stderr.read1(4096):  # type: ignore[attr-defined]
            self._error_output += piece

    def _read_events(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._line_count += 1
            event = msgspec.json.decode(line, type=Event)
            if event.type == "ended":
                self._ended = event.text
            elif event.type == "not_copied":
                self.not_copied = event.text
            elif event.command_number or event.type == "ready":
                self._answers.put(event)
        self._answers.put(None)

    def _kill(self) -> None:
        if self._process is not None:
            self._end_it()
            self._close()

    def _end_it(self) -> None:
        assert self._process is not None
        self._process.kill()
        # A killed process may wait for a disk that does not answer.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(KILL_S)
        self._join()

    def _join(self) -> None:
        for listener in self._listeners:
            listener.join(KILL_S)

    def _close(self) -> None:
        process, self._process = self._process, None
        for stream in (process.stdin, process.stdout, process.stderr) if process else ():
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
