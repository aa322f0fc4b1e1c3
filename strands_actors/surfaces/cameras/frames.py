"""The results of reading a camera: a picture, or the reason why no picture is new enough."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture.

    Attributes:
        image: Shape (height, width, 3), RGB, with the first row on top. The array is a copy, so later
            pictures do not change it.
        captured_ns: When the picture was taken, on the host's monotonic clock (``time.monotonic_ns()``).
        sequence: The number of the picture. Two readings with the same number are the same picture.
    """

    image: NDArray[numpy.uint8]
    captured_ns: int
    sequence: int

    @property
    def age_s(self) -> float:
        return (time.monotonic_ns() - self.captured_ns) / 1e9


@dataclass(frozen=True)
class Stale:
    """The result if no picture is new enough.

    Attributes:
        why: The reason.
        age_s: The age of the newest picture in seconds; None without any picture.
        sequence: The number of the newest picture; 0 without any picture.
    """

    why: str
    age_s: float | None = None
    sequence: int = 0


class StaleFrame(RuntimeError):
    """``read_camera`` has no picture that is new enough.

    Attributes:
        camera: The name of the camera.
        stale: The reason, and the age of the newest picture.
    """

    def __init__(self, camera: str, stale: Stale) -> None:
        super().__init__(f"camera {camera!r}: {stale.why}")
        self.camera = camera
        self.stale = stale
