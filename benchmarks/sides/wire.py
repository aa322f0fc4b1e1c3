"""Read a twin's wire log, for sides at a robot's twin. It imports only modules that every peer's environment
has."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple


class Frame(NamedTuple):
    """A frame from the host. ``t_ns`` is when the twin had read it, in nanoseconds of CLOCK_MONOTONIC."""

    t_ns: int
    kind: str
    data: str


class Log:
    """The host's frames in a twin's log, which is read while it grows."""

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        self._at = 0
        self.frames: list[Frame] = []

    def read(self) -> list[Frame]:
        """Return all frames of the host so far."""
        if self._path.exists():
            with self._path.open("rb") as file:
                file.seek(self._at)
                text = file.read()
            whole = text.rfind(b"\n") + 1
            self._at += whole
            rows = [json.loads(line) for line in text[:whole].splitlines() if b'"host"' in line]
            self.frames += [Frame(row["t_ns"], row["kind"], row["hex"]) for row in rows]
        return self.frames

    def first(self, kind: str, since_ns: int, within_s: float) -> Frame | None:
        """Wait for the first frame of a kind since a time, and return it; None after ``within_s``."""
        until_s = time.monotonic() + within_s
        while True:
            for frame in reversed_until(self.read(), since_ns):
                if frame.kind == kind:
                    return frame
            if time.monotonic() > until_s:
                return None
            time.sleep(0.01)

    def setpoints(self) -> list[Frame]:
        return [frame for frame in self.read() if frame.kind == "setpoint"]


def reversed_until(frames: Sequence[Frame], since_ns: int) -> list[Frame]:
    """Return the frames since ``since_ns``, in order."""
    at = len(frames)
    while at and frames[at - 1].t_ns >= since_ns:
        at -= 1
    return list(frames[at:])


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share))]


def processor_s(pid: int) -> float:
    """Return the user and system time of a process with all its threads, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def delays_us(send: Callable[[int], int], log: Log, count: int, pause_s: float = 0.02) -> list[float]:
    """Return the delays of setpoints: from before each call to the next frame that differs from the last one.

    Args:
        send: Sends setpoint ``i``, and returns when it began, in nanoseconds of CLOCK_MONOTONIC.
        log: The twin's log.
        count: Number of setpoints.
        pause_s: Least pause between them. Pauses vary, so that they do not coincide with a period of a side.

    Raises:
        RuntimeError: Less than 95 % of them were seen on the wire.
    """
    began = []
    for number in range(count):
        began.append(send(number))
        time.sleep(pause_s * (1 + (number * 7 % 10) / 10))
    time.sleep(0.1)
    frames = log.setpoints()
    found, at = [], 0
    for t_ns in began:
        while at < len(frames) and frames[at].t_ns < t_ns:
            at += 1
        before = frames[at - 1].data if at else ""
        new = next((frame for frame in frames[at:] if frame.data != before), None)
        if new is not None:
            found.append((new.t_ns - t_ns) / 1e3)
    if len(found) < count * 0.95:
        raise RuntimeError(f"{count} setpoints sent, {len(found)} seen on the wire")
    return found
