"""Read the twin's log of the wire while the twin writes it."""

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
    """A frame from the host."""

    t_ns: int
    kind: str  # setpoint, safe, enable, read, config or other
    safe_state: str | None  # to which a safe frame alone brings the whole robot; None if not stated


class Wire:
    """The frames so far. Any thread may call ``poll``. Frames are only appended, never changed."""

    def __init__(self, log: Path) -> None:
        self.frames: list[Frame] = []
        self.times_ns: list[int] = []  # of every frame, also of those from the robot
        self._log = log
        self._read = 0
        self._decode = msgspec.json.Decoder(_Line).decode
        self._lock = threading.Lock()

    def poll(self) -> None:
        """Read the lines that were written since the last call."""
        with self._lock:
            if not self._log.exists():
                return
            with self._log.open("rb") as file:
                file.seek(self._read)
                data = file.read()
            whole = data[: data.rfind(b"\n") + 1]  # the last line may be incomplete
            self._read += len(whole)
            for line in whole.splitlines():
                entry = self._decode(line)
                self.times_ns.append(entry.t_ns)
                if entry.sender == "host":
                    self.frames.append(Frame(entry.t_ns, entry.kind, entry.safe_state))

    def first_safe(self, safe_state: str, since_ns: int) -> int | None:
        """Return the index of the first frame since a time that brings the whole robot to a safe state."""
        for index in range(self._at(since_ns), len(self.frames)):
            frame = self.frames[index]
            if frame.kind == "safe" and frame.safe_state in (None, safe_state):
                return index
        return None

    def last(self, *kinds: str) -> Frame | None:
        return next((frame for frame in reversed(self.frames) if frame.kind in kinds), None)

    def setpoints_behind(self, index: int, until_ns: int) -> int:
        """Return how many setpoints follow a frame. The order of the log counts, since frames that were read
        together have the same time."""
        behind = self.frames[index + 1 : self._at(until_ns)]
        return sum(frame.kind == "setpoint" for frame in behind)

    def setpoint_times_ns(self, since_ns: int, until_ns: int) -> list[int]:
        between = self.frames[self._at(since_ns) : self._at(until_ns)]
        return [frame.t_ns for frame in between if frame.kind == "setpoint"]

    def frames_per_s(self, now_ns: int, window_s: float = 1.0) -> float:
        """Return the rate of frames in both directions."""
        count = 0
        for t_ns in reversed(self.times_ns):
            if t_ns < now_ns - window_s * NS:
                break
            count += 1
        return count / window_s

    def _at(self, t_ns: int) -> int:
        return bisect_left(self.frames, t_ns, key=lambda frame: frame.t_ns)
