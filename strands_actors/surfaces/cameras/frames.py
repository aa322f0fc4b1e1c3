"""What who reads a camera is given: a picture, or why there is none that is new enough."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture. ``image``: (height, width, 3), RGB, the first row on top, its own memory.
    ``captured_ns``: when, on the host's monotonic clock (``time.monotonic_ns()``). ``sequence``
    counts the pictures of a camera: two readings with one number are one picture."""

    image: NDArray[numpy.uint8]
    captured_ns: int
    sequence: int

    @property
    def age_s(self) -> float:
        return (time.monotonic_ns() - self.captured_ns) / 1e9


@dataclass(frozen=True)
class Stale:
    """There is no picture that is new enough. ``why`` says what is known; ``age_s`` and ``sequence``
    are those of the newest one there was (None and 0: there was none)."""

    why: str
    age_s: float | None = None
    sequence: int = 0


class StaleFrame(RuntimeError):
    """``read_camera`` has no picture that is new enough. ``stale``: what is known."""

    def __init__(self, camera: str, stale: Stale) -> None:
        super().__init__(f"camera {camera!r}: {stale.why}")
        self.camera = camera
        self.stale = stale
