"""Read the log of frames that a simulated robot writes, while it is being written."""

from __future__ import annotations

import threading
from bisect import bisect_left
from pathlib import Path
from typing import NamedTuple

import msgspec

from strands_actors.kernel.clock import NS


class _Line(msgspec.Struct):
    t_ns: int
    sender: str = msgspec.field(name="from")
    kind: str
    safe_state: str | None = None


class Frame(NamedTuple):
    """A frame (message of the robot's protocol) that the driver has sent to the robot."""

    t_ns: int
    kind: str  # One of setpoint, safe, enable, read, config, other.
    # The safe state that this frame brings the whole robot to. None if the log does not state it.
    safe_state: str | None


class Wire:
    """The frames (messages between driver and robot) that were logged so far. Any thread may call ``poll``.
    Frames are only appended, never changed."""

    def __init__(self, log: Path) -> None:
        self.frames: list[Frame] = []
        self.times_ns: list[int] = []  # The times of all frames, in both directions.
        self._log = log
        self._read = 0
        self._decode = msgspec.json.Decoder(_Line).decode
        self._lock = threading.Lock()

    def poll(self) -> None:
        """Read the lines that were added to the log of frames since the last call."""
        with self._lock:
            if not self._log.exists():
                return
            with self._log.open("rb") as file:
                file.seek(self._read)
                data = file.read()
            whole = data[: data.rfind(b"\n") + 1]  # The last line may still be incomplete.
            self._read += len(whole)
            for line in whole.splitlines():
                entry = self._decode(line)
                self.times_ns.append(entry.t_ns)
                if entry.sender == "host":
                    self.frames.append(Frame(entry.t_ns, entry.kind, entry.safe_state))

    def first_safe(self, safe_state: str, since_ns: int) -> int | None:
        """Return the index of the first frame since a time that brings the whole robot to a safe state."""
        for index in range(self._index(since_ns), len(self.frames)):
            frame = self.frames[index]
            if frame.kind == "safe" and frame.safe_state in (None, safe_state):
                return index
        return None

    def last(self, *kinds: str) -> Frame | None:
        return next((frame for frame in reversed(self.frames) if frame.kind in kinds), None)

    def setpoints_behind(self, index: int, until_ns: int) -> int:
        """Return how many setpoints follow a frame, by the order of the log. Their times are not compared,
        because frames that arrive together are logged with the same time."""
        behind = self.frames[index + 1 : self._index(until_ns)]
        return sum(frame.kind == "setpoint" for frame in behind)

    def setpoint_times_ns(self, since_ns: int, until_ns: int) -> list[int]:
        between = self.frames[self._index(since_ns) : self._index(until_ns)]
        return [frame.t_ns for frame in between if frame.kind == "setpoint"]

    def frames_per_s(self, now_ns: int, window_s: float = 1.0) -> float:
        """Return the number of frames per second, in both directions together."""
        count = 0
        for t_ns in reversed(self.times_ns):
            if t_ns < now_ns - window_s * NS:
                break
            count += 1
        return count / window_s

    def _index(self, t_ns: int) -> int:
        return bisect_left(self.frames, t_ns, key=lambda frame: frame.t_ns)
