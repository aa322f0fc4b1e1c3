"""What a process needs while it runs, and whether that grows.

Memory is noisy: an allocator takes an arena of 256 kB at once, and gives some back. So the time is cut
into ``PARTS``, each gives its smallest reading, and a line is fitted to these: what a process takes for
a moment does not count, what it never gives back does.
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
"""By so much it may have grown in any time: over a quarter of an hour it is less than that rate."""


class Sample(NamedTuple):
    """``files``: open descriptors; ``memory_kb``: resident, of its own and not of a file."""

    t_s: float
    files: int
    threads: int
    memory_kb: int


def sample(pid: int, t_s: float) -> Sample | None:
    """Read it. None: the process has ended."""
    try:
        status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        files = len(os.listdir(f"/proc/{pid}/fd"))
        return Sample(t_s, files, int(status["Threads"]), int(status["RssAnon"].split()[0]))
    except (OSError, KeyError):  # a zombie has no memory
        return None


def descendants(pid: int) -> dict[int, str]:
    """Return the processes that were started by ``pid``, and itself, each with its name."""
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
    """Return what grew, for people; empty: nothing did. ``samples``: of one process, in order."""
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
    """Return the smallest reading of each part, and when it was."""
    size = max(1, len(samples) // PARTS)
    parts = [samples[at : at + size] for at in range(0, len(samples), size)]
    least = [min(part, key=lambda each: each.memory_kb) for part in parts]
    return [(each.t_s, float(each.memory_kb)) for each in least]


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Return that of the line with the least squares."""
    middle_x = sum(x for x, _ in points) / len(points)
    middle_y = sum(y for _, y in points) / len(points)
    spread = sum((x - middle_x) ** 2 for x, _ in points)
    return sum((x - middle_x) * (y - middle_y) for x, y in points) / spread if spread else 0.0
