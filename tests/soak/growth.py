"""Measure the files, threads and memory of a process, and decide whether they grow.

Memory is noisy: an allocator takes an arena of 256 kB at once, and gives some back. So the time is
divided into ``PARTS``, and a line is fitted to the smallest reading of each part. Memory that a process
takes only for a moment does not count, memory that it never gives back does.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

PARTS = 10
GROWTH_KB_H = 1024.0
"""By how much the memory of a process may grow in an hour."""
ARENA_KB = 256.0
"""Growth that is allowed in any time. In runs of more than a quarter of an hour the rate allows more."""


class Sample(NamedTuple):
    """One reading of a process.

    Attributes:
        t_s: The time.
        files: Open descriptors.
        threads: Threads.
        memory_kb: Resident anonymous memory, without mapped files.
    """

    t_s: float
    files: int
    threads: int
    memory_kb: int


def sample(pid: int, t_s: float) -> Sample | None:
    """Return a reading of a process; None if it has ended."""
    try:
        status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        files = len(os.listdir(f"/proc/{pid}/fd"))
        return Sample(t_s, files, int(status["Threads"]), int(status["RssAnon"].split()[0]))
    except (OSError, KeyError):  # a zombie has no memory
        return None


def descendants(pid: int) -> dict[int, str]:
    """Return the names of ``pid`` and all its descendants, by process id."""
    parents: dict[int, tuple[int, str]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                head, _, rest = (entry / "stat").read_text().rpartition(")")
            except OSError:
                continue
            parents[int(entry.name)] = int(rest.split()[1]), head.partition("(")[2]
    found, new = dict[int, str](), {pid}
    while new:
        found |= {each: parents[each][1] for each in new if each in parents}
        new = {each for each, (parent, _) in parents.items() if parent in new} - found.keys()
    return found


def growth_of(samples: Sequence[Sample]) -> list[str]:
    """Return a text for each quantity that grew; empty if none did.

    Args:
        samples: Readings of one process, in order of time.
    """
    found = []
    half = len(samples) // 2
    for name in ("files", "threads"):
        before, after = (max(getattr(each, name) for each in part) for part in (samples[:half], samples[half:]))
        least = min(getattr(each, name) for each in samples[:half])
        if after > before and min(getattr(each, name) for each in samples[half:]) > least:
            found.append(f"{name}: {before} at most, then {after}")
    hours = (samples[-1].t_s - samples[0].t_s) / 3600
    rate_kb_h = slope(_least(samples)) * 3600
    if rate_kb_h * hours > max(ARENA_KB, GROWTH_KB_H * hours):
        first, last = samples[0].memory_kb, samples[-1].memory_kb
        found.append(f"memory: {rate_kb_h / 1024:.1f} MB an hour ({first} kB, then {last} kB)")
    return found


def _least(samples: Sequence[Sample]) -> list[tuple[float, float]]:
    """Return time and value of the smallest memory reading of each part."""
    size = max(1, len(samples) // PARTS)
    parts = [samples[index : index + size] for index in range(0, len(samples), size)]
    least = [min(part, key=lambda each: each.memory_kb) for part in parts]
    return [(each.t_s, float(each.memory_kb)) for each in least]


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Return the slope of the least-squares line."""
    middle_x = sum(x for x, _ in points) / len(points)
    middle_y = sum(y for _, y in points) / len(points)
    spread = sum((x - middle_x) ** 2 for x, _ in points)
    return sum((x - middle_x) * (y - middle_y) for x, y in points) / spread if spread else 0.0
