"""Read the log of a simulated robot: each frame that it received, with its time.

This module imports only modules that every peer's environment has.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple


class Frame(NamedTuple):
    """A frame that the robot received, at the time ``t_ns`` (CLOCK_MONOTONIC, in nanoseconds)."""

    t_ns: int
    kind: str
    data: str


class Log:
    """The frames that a simulated robot has received, from its log, which is read while it grows."""

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        self._offset = 0
        self.frames: list[Frame] = []

    def read(self) -> list[Frame]:
        """Return all frames that the robot has received so far."""
        if self._path.exists():
            with self._path.open("rb") as file:
                file.seek(self._offset)
                text = file.read()
            whole = text.rfind(b"\n") + 1
            self._offset += whole
            rows = [json.loads(line) for line in text[:whole].splitlines() if b'"host"' in line]
            self.frames += [Frame(row["t_ns"], row["kind"], row["hex"]) for row in rows]
        return self.frames

    def first(self, kind: str, since_ns: int, within_s: float) -> Frame | None:
        """Wait for the first frame of this kind since ``since_ns``, and return it. Return None if there is none for
        ``within_s``.
        """
        until_s = time.monotonic() + within_s
        while True:
            for frame in frames_since(self.read(), since_ns):
                if frame.kind == kind:
                    return frame
            if time.monotonic() > until_s:
                return None
            time.sleep(0.01)

    def setpoints(self) -> list[Frame]:
        return [frame for frame in self.read() if frame.kind == "setpoint"]


def frames_since(frames: Sequence[Frame], since_ns: int) -> list[Frame]:
    """Return the frames since ``since_ns``, the earliest first."""
    first = len(frames)
    while first and frames[first - 1].t_ns >= since_ns:
        first -= 1
    return list(frames[first:])


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share))]


def processor_s(pid: int) -> float:
    """Return the user and system time of a process with all its threads, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def delays_us(send: Callable[[int], int], log: Log, count: int, pause_s: float = 0.02) -> list[float]:
    """Send setpoints, and return the delay of each: from before the call to the first frame that differs from the
    frame before the call.

    Args:
        send: Sends setpoint number ``i``. Returns the time before the call, in nanoseconds of CLOCK_MONOTONIC.
        log: The log of the simulated robot.
        count: Number of setpoints.
        pause_s: Shortest pause between two setpoints. Pauses vary, so that they do not coincide with a period.

    Raises:
        RuntimeError: Less than 95 % of the setpoints reached the robot.
    """
    began = []
    for number in range(count):
        began.append(send(number))
        time.sleep(pause_s * (1 + (number * 7 % 10) / 10))
    time.sleep(0.1)
    frames = log.setpoints()
    delays, index = [], 0
    for t_ns in began:
        while index < len(frames) and frames[index].t_ns < t_ns:
            index += 1
        before = frames[index - 1].data if index else ""
        new = next((frame for frame in frames[index:] if frame.data != before), None)
        if new is not None:
            delays.append((new.t_ns - t_ns) / 1e3)
    if len(delays) < count * 0.95:
        raise RuntimeError(f"{count} setpoints were sent, but only {len(delays)} reached the robot")
    return delays
