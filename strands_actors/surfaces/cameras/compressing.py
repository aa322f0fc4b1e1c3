"""Compress pictures of a camera as JPEG while they are requested, in a thread of the camera's process."""

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
    """Compress one picture at a time. Pictures that come in the meantime are skipped.

    Attributes:
        problem: Why the newest picture was not compressed, or why no picture can be compressed. Empty without a
            problem.
    """

    def __init__(self, ring: FrameRing) -> None:
        self._ring = ring
        self._busy = False
        self._cannot = False  # OpenCV is missing, so no picture can be compressed.
        self.problem = ""

    def wants(self, now_ns: int) -> bool:
        """Return True if a picture that arrives now should be compressed, because JPEG pictures are requested
        and the compressor is idle."""
        return not self._busy and not self._cannot and now_ns < self._ring.requested_until_ns

    async def compress(self, image: NDArray[numpy.uint8], captured_ns: int, number: int) -> None:
        """Compress a picture and put it into the ring buffer in shared memory. A failure is kept in ``problem``."""
        self._busy = True
        try:
            if self._can():
                data = await trio.to_thread.run_sync(jpeg, image)
                height, width, _ = image.shape
                if not self._ring.put_compressed(Shot(number, captured_ns, height, width, data)):
                    self.problem = f"a picture of {width} x {height} is too large as JPEG: {len(data)} bytes"
        # OpenCV may fail, or memory may run out. Readers still get uncompressed pictures.
        except Exception as failure:
            self.problem = describe(failure)
        finally:
            self._busy = False

    def _can(self) -> bool:
        self.problem = missing("cameras", "JPEG")
        self._cannot = bool(self.problem)
        return not self._cannot


def jpeg(image: NDArray[numpy.uint8]) -> bytes:
    """Return an RGB image as JPEG. Raise ``ValueError`` if OpenCV cannot compress it."""
    import cv2

    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise ValueError("OpenCV cannot compress the picture as JPEG")
    return bytes(data)
