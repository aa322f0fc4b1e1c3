"""Write an animated GIF, without another package.

All pictures share 255 colours, those that are most frequent in them. A pixel that has not changed since the picture
before is transparent, so that a still background takes no space.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

CLEAR = 255
"""Index of the transparent colour."""
_BITS = 8
_MOST_CODES = 4096
_SEEN_FOR_COLOURS = 24
"""Number of pictures from which the colours are chosen."""


def write_gif(path: Path, pictures: Sequence[Pixels], fps: int) -> None:
    """Write pictures of the same size as a GIF that is repeated for ever.

    Args:
        path: The file.
        pictures: One or more arrays of shape (height, width, 3).
        fps: Pictures per second. A GIF counts hundredths of a second, so the rate is rounded.
    """
    height, width, _ = pictures[0].shape
    palette, index_of = colours(pictures[:: max(1, len(pictures) // _SEEN_FOR_COLOURS)])
    size = width.to_bytes(2, "little") + height.to_bytes(2, "little")
    delay = max(2, round(100 / fps)).to_bytes(2, "little")
    with path.open("wb") as file:
        file.write(b"GIF89a" + size + b"\xf7\0\0" + palette.tobytes())
        file.write(b"!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0")
        before: Pixels | None = None
        for picture in pictures:
            indices = index_of[_coarse(picture)]
            shown = indices if before is None else np.where(indices == before, np.uint8(CLEAR), indices)
            before = indices
            file.write(b"!\xf9\x04\x05" + delay + bytes([CLEAR]) + b"\0")
            file.write(b"," + b"\0" * 4 + size + b"\0" + bytes([_BITS]))
            file.write(_blocks(_compressed(shown.tobytes())))
        file.write(b";")


def _coarse(picture: Pixels) -> NDArray[np.int32]:
    """Return a number for the colour of each pixel, with five bits for red, six for green and five for blue."""
    red, green, blue = (picture[..., channel].astype(np.int32) for channel in range(3))
    return (red >> 3) << 11 | (green >> 2) << 5 | blue >> 3


def colours(pictures: Sequence[Pixels]) -> tuple[Pixels, Pixels]:
    """Return a palette of 256 colours of pictures, and the index in the palette of each coarse colour.

    The last colour, ``CLEAR``, is left free.
    """
    counts, sums = np.zeros(1 << 16), np.zeros((1 << 16, 3))
    for picture in pictures:
        coarse = _coarse(picture).ravel()
        counts += np.bincount(coarse, minlength=1 << 16)
        for channel in range(3):
            sums[:, channel] += np.bincount(coarse, picture[..., channel].ravel(), 1 << 16)
    numbers = np.arange(1 << 16)
    centres = np.column_stack([numbers >> 11 << 3 | 4, (numbers >> 5 & 63) << 2 | 2, (numbers & 31) << 3 | 4])
    levels = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
    chosen = _spread(levels, counts, CLEAR)
    palette = np.zeros((256, 3), np.uint8)
    palette[: len(chosen)] = levels[chosen].round()
    index_of = np.zeros(1 << 16, np.uint8)
    distances = np.full(1 << 16, np.inf)
    for index, number in enumerate(chosen):
        distance = ((levels - levels[number]) ** 2).sum(axis=1)
        nearer = distance < distances
        index_of[nearer], distances[nearer] = index, distance[nearer]
    return palette, index_of


def _spread(levels: NDArray[np.float64], counts: NDArray[np.float64], most: int) -> list[int]:
    """Return the numbers of at most ``most`` colours: frequent ones, and far from those already chosen."""
    used = np.flatnonzero(counts)
    if len(used) <= most:
        return [int(number) for number in used]
    weights = counts[used] ** 0.35
    distances = np.full(len(used), 1e9)
    chosen: list[int] = []
    for _ in range(most):
        best = int(np.argmax(weights * distances))
        chosen.append(int(used[best]))
        distances = np.minimum(distances, ((levels[used] - levels[used[best]]) ** 2).sum(axis=1))
    return chosen


def _compressed(indices: bytes) -> bytes:
    """Compress the pixels of a picture by LZW, as a GIF has it."""
    clear = 1 << _BITS
    table: dict[tuple[int, int], int] = {}
    packed = bytearray()
    bits, held = 0, 0
    width, following = _BITS + 1, clear + 2

    def put(code: int) -> None:
        nonlocal bits, held
        bits |= code << held
        held += width
        while held >= 8:
            packed.append(bits & 255)
            bits >>= 8
            held -= 8

    put(clear)
    prefix = indices[0]
    for pixel in indices[1:]:
        code = table.get((prefix, pixel))
        if code is not None:
            prefix = code
            continue
        put(prefix)
        if following < _MOST_CODES:
            table[prefix, pixel] = following
            if following == 1 << width:
                width += 1
            following += 1
        else:
            put(clear)
            table.clear()
            width, following = _BITS + 1, clear + 2
        prefix = pixel
    put(prefix)
    put(clear + 1)
    if held:
        packed.append(bits & 255)
    return bytes(packed)


def _blocks(data: bytes) -> bytes:
    """Return data in blocks of at most 255 bytes, each behind its length."""
    pieces: Iterable[bytes] = (data[start : start + 255] for start in range(0, len(data), 255))
    return b"".join(bytes([len(piece)]) + piece for piece in pieces) + b"\0"
