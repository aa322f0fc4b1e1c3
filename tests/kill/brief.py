"""A policy that raises an exception at its first step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


class Brief:
    def __init__(self, axes: Sequence[str]) -> None:
        pass

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        raise RuntimeError("a fault was asked for")
