"""The twin's log of the wire: what a safety test reads, instead of the program's opinion of
itself."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec

RUNS = 12
"""Of a story."""


class Entry(NamedTuple):
    t_ns: int  # CLOCK_MONOTONIC, when the bytes were read off the wire
    sender: str  # "host" or "robot"
    kind: str  # setpoint, safe, enable, read, config or other
    data: bytes
    safe_state: str | None = None  # of a safe frame: what it brings the whole robot to; "" none, None: not said


class Tail:
    """Reads a log that grows: each entry once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._first = b""  # line; a log that was emptied and has grown since has another
        self.emptied = False
        """Whether the log was, since this began to read it."""

    def new(self) -> Iterator[Entry]:
        """What was written since the last time. A log that was emptied begins anew."""
        if not self._path.exists():
            return
        with self._path.open("rb") as log:
            self._look_at_the_first_line(log)
            log.seek(self._offset)
            for line in log:
                if not line.endswith(b"\n"):
                    return  # still being written
                self._first = self._first or line
                self._offset += len(line)
                yield _entry(line)

    def _look_at_the_first_line(self, log: BinaryIO) -> None:
        if log.read(len(self._first)) != self._first:
            self._offset, self._first = 0, b""
            self.emptied = True


class _Row(msgspec.Struct):
    """A line of the log."""

    t_ns: int
    sender: str = msgspec.field(name="from")
    kind: str
    hex: str
    safe_state: str | None = None


_decode = msgspec.json.Decoder(_Row).decode


def _entry(line: bytes) -> Entry:
    row = _decode(line)
    return Entry(row.t_ns, row.sender, row.kind, bytes.fromhex(row.hex), row.safe_state)


class WireLog:
    """Reads the NDJSON log of a twin that may still be writing it. Keeps what it has read: who waits
    for a frame looks again and again."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._tail = self.tail()
        self._read: list[Entry] = []
        self._lock = threading.Lock()

    def entries(self, since_ns: int = 0) -> Iterator[Entry]:
        with self._lock:
            new = list(self._tail.new())
            if self._tail.emptied:
                self._tail = self.tail()
                self._read = []  # another: who still looks at what was before keeps that
                new = list(self._tail.new())
            self._read += new
            read = self._read
        return (entry for entry in read if entry.t_ns >= since_ns)

    def tail(self) -> Tail:
        """From its beginning, and then what is new."""
        return Tail(self.path)

    def story(self, since_ns: int) -> str:
        """What the wire shows from then on, for people: each kind with its first time in ms, runs
        of one kind as one, the last ``RUNS`` of them. What a robot answers is left out."""
        runs: list[tuple[str, float, int]] = []
        for entry in self.entries(since_ns):
            if entry.sender == "robot" and entry.kind in ("read", "answer"):
                continue
            what = f"{entry.sender} {entry.kind}" + (f" ({entry.safe_state})" if entry.safe_state else "")
            if runs and runs[-1][0] == what:
                runs[-1] = what, runs[-1][1], runs[-1][2] + 1
            else:
                runs.append((what, (entry.t_ns - since_ns) / 1e6, 1))
        return ", ".join(f"{at_ms:.1f} {what} x {count}" for what, at_ms, count in runs[-RUNS:]) or "nothing"

    def host(self, kind: str, since_ns: int = 0) -> list[Entry]:
        """What the host wrote of one kind."""
        return [entry for entry in self.entries(since_ns) if entry.sender == "host" and entry.kind == kind]

    def first_safe(self, since_ns: int) -> Entry | None:
        return next(iter(self.host("safe", since_ns)), None)

    def safe_within(self, since_ns: int, bound_s: float) -> float:
        """Seconds from ``since_ns`` to the first safe frame. Raise ``AssertionError`` beyond the
        bound."""
        safe = self.first_safe(since_ns)
        assert safe is not None, "no safe frame on the wire"
        took_s = (safe.t_ns - since_ns) / 1e9
        assert took_s <= bound_s, f"safe after {took_s * 1e3:.1f} ms, bound {bound_s * 1e3:.0f} ms"
        return took_s

    def setpoints_after_safe(self, since_ns: int, until_ns: int | None = None) -> int:
        """Setpoints behind the first safe frame after ``since_ns``, in the order of the wire:
        frames that were read at once share their time."""
        seen_safe, count = False, 0
        for entry in self.entries(since_ns):
            if entry.sender != "host" or (until_ns is not None and entry.t_ns >= until_ns):
                continue
            seen_safe = seen_safe or entry.kind == "safe"
            count += seen_safe and entry.kind == "setpoint"
        assert seen_safe, "no safe frame on the wire"
        return count

    def no_setpoint_after_safe(self, since_ns: int, until_ns: int | None = None) -> None:
        """Raise ``AssertionError`` when a setpoint follows the first safe frame, or there is
        none."""
        count = self.setpoints_after_safe(since_ns, until_ns)
        assert count == 0, f"{count} setpoints after the safe frame"

    def silent_after(self, t_ns: int, *kinds: str) -> None:
        """Raise ``AssertionError`` when the host wrote anything from then on; of these kinds, if
        any are given."""
        for entry in self.entries(t_ns):
            if entry.sender == "host" and (not kinds or entry.kind in kinds):
                late_ms = (entry.t_ns - t_ns) / 1e6
                raise AssertionError(f"a {entry.kind} frame {late_ms:.1f} ms later: {entry.data.hex(' ')}")
