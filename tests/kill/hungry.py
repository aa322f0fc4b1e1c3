"""A policy that moves a little, and then requests more memory than its process may have."""

from __future__ import annotations

import resource
from collections.abc import Mapping, Sequence
from pathlib import Path

MORE = 64 << 20


class Hungry:
    def __init__(self, axes: Sequence[str], steps: int) -> None:
        self._remaining_steps = steps

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        self._remaining_steps -= 1
        if self._remaining_steps < 0:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + MORE, used + MORE))
            blocks = [bytearray(MORE) for _ in range(1000)]
            raise AssertionError(f"{len(blocks)} pieces of memory past the limit")
        return dict(observation)
