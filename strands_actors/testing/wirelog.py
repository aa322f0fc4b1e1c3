"""Read the log of all frames that a simulated robot exchanges.

Safety tests check this log, and not the statements of the program that commands the robot.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec

RUNS = 12
"""The most runs in a story."""


class Entry(NamedTuple):
    """One frame of the log, with its time and sender."""

    t_ns: int  # time at which the robot read the bytes (CLOCK_MONOTONIC, ns)
    sender: str  # "host" (the computer that commands) or "robot"
    kind: str  # kind of the frame: setpoint, safe, enable, read, config or other
    data: bytes
    # For a safe frame: the safe state of the whole robot. "" if the frame is only for some motors, None if the
    # state is not known.
    safe_state: str | None = None


class Tail:
    """Read a log that still grows. Each entry is yielded once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        # The first line of the log. It changes if the log was emptied and written again.
        self._first = b""
        self.emptied = False
        """True if the log was emptied after the first read."""

    def new(self) -> Iterator[Entry]:
        """Yield the entries that were written since the last call.

        If the log was emptied, start again at its beginning.
        """
        if not self._path.exists():
            return
        with self._path.open("rb") as log:
            self._check_first_line(log)
            log.seek(self._offset)
            for line in log:
                if not line.endswith(b"\n"):
                    return  # the last line is not complete yet, so it is read later
                self._first = self._first or line
                self._offset += len(line)
                yield _entry(line)

    def _check_first_line(self, log: BinaryIO) -> None:
        if log.read(len(self._first)) != self._first:
            self._offset, self._first = 0, b""
            self.emptied = True


class _Row(msgspec.Struct):
    """A line of the log, as it is stored."""

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
    """Read the log of a simulated robot (NDJSON), which may still be growing.

    Entries are kept in memory, since a test that waits for a frame reads often.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._tail = self.tail()
        self._read: list[Entry] = []
        self._lock = threading.Lock()

    def entries(self, since_ns: int = 0) -> Iterator[Entry]:
        """Read the log, and return the entries since a time (CLOCK_MONOTONIC, ns)."""
        with self._lock:
            new = list(self._tail.new())
            if self._tail.emptied:
                self._tail = self.tail()
                # Make a new list. Iterators that still run keep the old one.
                self._read = []
                new = list(self._tail.new())
            self._read += new
            read = self._read
        return (entry for entry in read if entry.t_ns >= since_ns)

    def tail(self) -> Tail:
        """Return a reader that starts at the beginning of the log."""
        return Tail(self.path)

    def story(self, since_ns: int) -> str:
        """Describe the frames since a time as text, for people.

        Successive frames of the same kind are one group, with the time of the first frame in ms. The last ``RUNS``
        groups are returned. Readings, and answers of the robot, are left out.
        """
        runs: list[tuple[str, float, int]] = []
        for entry in self.entries(since_ns):
            if entry.sender == "robot" and entry.kind in ("read", "answer"):
                continue
            label = f"{entry.sender} {entry.kind}" + (f" ({entry.safe_state})" if entry.safe_state else "")
            if runs and runs[-1][0] == label:
                runs[-1] = label, runs[-1][1], runs[-1][2] + 1
            else:
                runs.append((label, (entry.t_ns - since_ns) / 1e6, 1))
        return ", ".join(f"{at_ms:.1f} {label} x {count}" for label, at_ms, count in runs[-RUNS:]) or "nothing"

    def host(self, kind: str, since_ns: int = 0) -> list[Entry]:
        """Return the frames of one kind that were sent to the robot since ``since_ns``."""
        return [entry for entry in self.entries(since_ns) if entry.sender == "host" and entry.kind == kind]

    def first_safe(self, since_ns: int) -> Entry | None:
        """Return the first safe frame (stop command) that was sent to the robot since this time (ns), or None."""
        return next(iter(self.host("safe", since_ns)), None)

    def safe_within(self, since_ns: int, bound_s: float) -> float:
        """Return the seconds from ``since_ns`` to the first safe frame (stop command).

        Raises:
            AssertionError: The safe frame came later than the bound, or there is no safe frame.
        """
        safe = self.first_safe(since_ns)
        assert safe is not None, "no safe frame on the wire"
        took_s = (safe.t_ns - since_ns) / 1e9
        assert took_s <= bound_s, f"safe after {took_s * 1e3:.1f} ms, bound {bound_s * 1e3:.0f} ms"
        return took_s

    def setpoints_after_safe(self, since_ns: int, until_ns: int | None = None) -> int:
        """Count the setpoints after the first safe frame (stop command) since ``since_ns``.

        The order in the log decides, because frames that were read together have the same time.
        """
        had_safe, count = False, 0
        for entry in self.entries(since_ns):
            if entry.sender != "host" or (until_ns is not None and entry.t_ns >= until_ns):
                continue
            had_safe = had_safe or entry.kind == "safe"
            count += had_safe and entry.kind == "setpoint"
        assert had_safe, "no safe frame on the wire"
        return count

    def no_setpoint_after_safe(self, since_ns: int, until_ns: int | None = None) -> None:
        """Raise ``AssertionError`` unless a safe frame (stop command) came, and no setpoint after it."""
        count = self.setpoints_after_safe(since_ns, until_ns)
        assert count == 0, f"{count} setpoints after the safe frame"

    def silent_after(self, t_ns: int, *kinds: str) -> None:
        """Raise ``AssertionError`` if a frame was sent to the robot since this time.

        Args:
            t_ns: The time (CLOCK_MONOTONIC, ns).
            kinds: The kinds of frames that must not occur. If no kind is given, no frame may occur.
        """
        for entry in self.entries(t_ns):
            if entry.sender == "host" and (not kinds or entry.kind in kinds):
                late_ms = (entry.t_ns - t_ns) / 1e6
                raise AssertionError(f"a {entry.kind} frame {late_ms:.1f} ms later: {entry.data.hex(' ')}")
