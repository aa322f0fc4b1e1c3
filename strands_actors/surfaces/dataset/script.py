"""``with record_dataset(robot, folder, task=...) as recording:`` from a script: the recorder runs in
a process of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Protocol

import msgspec

from strands_actors.kernel.processes.interpreter import PYTHON, environment

from .errors import DatasetError
from .run import require_order
from .session import LEAVE_S, Event, Order
from .video import DEFAULT

CHILD = f"{__package__}.child"
END_S = LEAVE_S + 15.0


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
    codec: str = DEFAULT,
) -> DatasetRecording:
    """Record episodes of a connected robot (or the running one of that name) into a dataset, which
    is made, or grows.

    with record_dataset(arm, "pick", task="pick the cube up", cameras=["wrist"]) as recording:
        with recording.episode():
            ...

    Raise ``RecordingError`` when it cannot be recorded; the robot does not notice.
    """
    name = robot if isinstance(robot, str) else robot.name
    named = (cameras,) if isinstance(cameras, str) else tuple(cameras)
    order = Order(name, os.path.abspath(root), task, fps, named, codec)
    require_order(order)
    return DatasetRecording(order)


class DatasetRecording:
    """Episodes, one after the other, within its ``with`` block. What it is told is answered by the
    recorder's process."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self._process: subprocess.Popen[bytes] | None = None
        self._said = bytearray()
        self._asked = 0  # commands so far
        self.saved: list[dict[str, object]] = []
        """What was saved: number, frames and marks of each episode."""

    def __enter__(self) -> DatasetRecording:
        self._process = subprocess.Popen(
            [*PYTHON, "-m", CHILD, msgspec.json.encode(self._order).decode()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(),
        )
        # Read all the time: a process that complains a lot must not wait for us.
        self._listener = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._listener.start()
        try:
            self._wait_for("ready")
        except BaseException:
            self._kill()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the recording. An episode that runs is not finished by that; it can be repaired."""
        process = self._process
        if process is None:
            return
        process.send_signal(signal.SIGINT)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._kill()
            raise DatasetError(f"the recorder did not end within {END_S:g} s") from None
        self._listener.join()
        if process.returncode and kind is None:
            raise DatasetError(self._why())
        self._close()

    def start(self) -> None:
        """Begin an episode. Raise ``RecordingError`` when it cannot begin: no picture, no room."""
        self._tell("start", "started")

    def finish(self) -> None:
        """Return when the episode is saved: counted, and on the disk."""
        event = self._tell("finish", "saved")
        self.saved.append({"episode": event.episode, "frames": event.frames, "marks": event.marks})

    def discard(self) -> None:
        self._tell("discard", "discarded")

    @contextlib.contextmanager
    def episode(self) -> Iterator[None]:
        """Record the block as an episode; one that raises is discarded."""
        self.start()
        try:
            yield
        except BaseException:
            self.discard()
            raise
        self.finish()

    def _tell(self, word: str, answer: str) -> Event:
        self._asked += 1
        if self._process is None or self._process.stdin is None:
            raise DatasetError(f"{word}: nothing is recorded outside the with block")
        try:
            self._process.stdin.write(f"{self._asked} {word}\n".encode())
            self._process.stdin.flush()
        except BrokenPipeError:
            return self._raise_why()
        return self._wait_for(answer)

    def _wait_for(self, what: str) -> Event:
        """Return the answer to what was asked last. The keys of a page are answered, too: to others."""
        assert self._process is not None and self._process.stdout is not None
        while line := self._process.stdout.readline():
            event = msgspec.json.decode(line, type=Event)
            if event.asked != self._asked:
                continue
            if event.what == what:
                return event
            if event.what == "refused":
                raise DatasetError(event.text)
        return self._raise_why()

    def _raise_why(self) -> NoReturn:
        assert self._process is not None
        self._process.wait(END_S)
        self._listener.join()
        raise DatasetError(self._why())

    def _why(self) -> str:
        assert self._process is not None
        said = self._said.decode(errors="replace").strip()
        return said or f"the recorder ended with code {self._process.returncode}"

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        while piece := process.stderr.read1(4096):  # type: ignore[attr-defined]
            self._said += piece

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._close()

    def _close(self) -> None:
        process, self._process = self._process, None
        for stream in (process.stdin, process.stdout, process.stderr) if process else ():
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
