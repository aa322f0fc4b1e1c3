"""A policy that sweeps an SO-101 over the table, to try ``strands-actors eval`` with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

LOW = {"shoulder_lift": 40.0, "elbow_flex": 10.0, "wrist_flex": 30.0}
"""The gripper is 1 cm above the table, 36 cm in front of the base."""
SIDE_DEG, LOWERED, STEP_DEG, CHUNK = -50.0, 60, 1.0, 10


class Sweep:
    """Lower the arm at one side, then sweep to the other side. Ten actions a chunk."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._count = 0

    def reset(self, seed: int | None = None) -> None:
        self._count = 0

    def get_actions_sync(self, seen: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        return [self._next() for _ in range(CHUNK)]

    def _next(self) -> dict[str, float]:
        self._count += 1
        turned = max(0, self._count - LOWERED) * STEP_DEG
        return {"shoulder_pan": min(SIDE_DEG + turned, -SIDE_DEG), **(LOW if self._count > LOWERED // 2 else {})}
