"""Pictures of a camera as JPEG, in a thread of its process, while somebody wants them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import trio

from strands_actors.contract.extras import missing
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.frame_ring import FrameRing, Shot

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

QUALITY = 80


class Compressor:
    """One picture at a time: those that come meanwhile are left out. ``problem``: why the newest
    one, or any, was not compressed."""

    def __init__(self, ring: FrameRing) -> None:
        self._ring = ring
        self._busy = False
        self._cannot = False  # whatever the picture is
        self.problem = ""

    def wants(self, now_ns: int) -> bool:
        return not self._busy and not self._cannot and now_ns < self._ring.wanted_until_ns

    async def compress(self, image: NDArray[numpy.uint8], captured_ns: int, number: int) -> None:
        self._busy = True
        try:
            if self._can():
                data = await trio.to_thread.run_sync(jpeg, image)
                height, width, _ = image.shape
                if not self._ring.put_compressed(Shot(number, captured_ns, height, width, data)):
                    self.problem = f"a picture of {width} x {height} is too large as JPEG: {len(data)} bytes"
        except Exception as failure:  # of OpenCV, or of the memory: who reads the pictures themselves has them
            self.problem = describe(failure)
        finally:
            self._busy = False

    def _can(self) -> bool:
        self.problem = missing("cameras", "JPEG")
        self._cannot = bool(self.problem)
        return not self._cannot


def jpeg(image: NDArray[numpy.uint8]) -> bytes:
    """Raise ``ValueError`` for what OpenCV cannot compress."""
    import cv2

    there, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not there:
        raise ValueError("it cannot be compressed as JPEG")
    return bytes(data)
