"""For sides that speak to a robot's twin: its wire log, without anything that a peer's environment
lacks."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple


class Frame(NamedTuple):
    """``t_ns``: CLOCK_MONOTONIC, when the twin had read it off the wire."""

    t_ns: int
    kind: str
    data: str


class Log:
    """What the host wrote, read as it grows."""

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        self._at = 0
        self.frames: list[Frame] = []

    def read(self) -> list[Frame]:
        """All frames of the host so far."""
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
        """The first of a kind from then on; wait for it."""
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
    """The frames from ``since_ns`` on, in order."""
    at = len(frames)
    while at and frames[at - 1].t_ns >= since_ns:
        at -= 1
    return list(frames[at:])


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share))]


def processor_s(pid: int) -> float:
    """User and system time of a process, all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def delays_us(send: Callable[[int], int], log: Log, count: int, pause_s: float = 0.02) -> list[float]:
    """From before each ``send(i)`` to the first setpoint behind it that differs from the last one
    before.

    ``send`` returns when it began (CLOCK_MONOTONIC ns); pauses are uneven, so that no period of
    anybody's is met.
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
