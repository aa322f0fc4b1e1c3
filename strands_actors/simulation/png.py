"""Encode pictures as PNG files."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

_HEAD = b"\x89PNG\r\n\x1a\n"
_EIGHT_BITS_RGB = (8, 2, 0, 0, 0)


def encode_png(picture: NDArray[numpy.uint8]) -> bytes:
    """Return the PNG file of a picture of shape (height, width, 3)."""
    height, width, _ = picture.shape
    # Each row begins with its PNG filter type: 0, unfiltered.
    rows = b"".join(b"\0" + row.tobytes() for row in picture)
    size = struct.pack(">II5B", width, height, *_EIGHT_BITS_RGB)
    return _HEAD + _chunk(b"IHDR", size) + _chunk(b"IDAT", zlib.compress(rows, 6)) + _chunk(b"IEND", b"")


def _chunk(chunk_type: bytes, data: bytes) -> bytes:
    body = chunk_type + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))
