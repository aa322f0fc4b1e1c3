"""Encode a picture as JPEG: the baseline process of ITU-T T.81, without a library. Pure.

The Huffman code of a file may be any. This one is short to write down: one bit for the end of a block, nine bits
for each other symbol. Files are therefore larger than those of other encoders.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Picture = NDArray[np.uint8]

_SIDE = 8
_END_OF_BLOCK, _SIXTEEN_ZEROS = 0x00, 0xF0
_LONGEST_RUN = 15
_LARGEST = 1023
"""Largest number of the code, for 10 bits."""
_DC_BITS, _DC_SYMBOLS = 4, bytes(range(12))
_AC_BITS = 9
_AC_SYMBOLS = bytes((_SIXTEEN_ZEROS, *(run << 4 | size for run in range(16) for size in range(1, 11))))


def encode(picture: Picture, quality_percent: float) -> bytes:
    """Return a picture as a JPEG file.

    Args:
        picture: Rows and columns of grey values, or of red, green and blue.
        quality_percent: 0 is the worst, 100 the best.
    """
    import numpy as np

    steps = _steps(quality_percent)
    planes = [picture.astype(np.float64)] if picture.ndim == 2 else _planes(picture)
    blocks = np.stack([_blocks(plane - 128.0, steps) for plane in planes], axis=1)
    changes = np.diff(blocks[:, :, 0], axis=0, prepend=0).reshape(-1)
    scan = _scan(changes.tolist(), blocks.reshape(-1, _SIDE * _SIDE)[:, 1:])
    order = _zigzag()
    quantisation = b"\0" + bytes(int(steps[row, column]) for row, column in order)
    parts = [(number + 1, 0x11, 0) for number in range(len(planes))]
    frame = struct.pack(">BHHB", 8, *picture.shape[:2], len(planes)) + b"".join(map(bytes, parts))
    header = bytes((len(planes), *(byte for number, _, _ in parts for byte in (number, 0)), 0, 63, 0))
    codes = _code_table(0x00, {_DC_BITS: _DC_SYMBOLS})
    codes += _code_table(0x10, {1: bytes((_END_OF_BLOCK,)), _AC_BITS: _AC_SYMBOLS})
    return (
        b"\xff\xd8"
        + _segment(0xE0, b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0")
        + _segment(0xDB, quantisation)
        + _segment(0xC0, frame)
        + _segment(0xC4, codes)
        + _segment(0xDA, header)
        + scan.replace(b"\xff", b"\xff\0")
        + b"\xff\xd9"
    )


def _segment(marker: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content


def _code_table(kind: int, symbols: dict[int, bytes]) -> bytes:
    """Return a table of codes: how many symbols have a code of 1 to 16 bits, then the symbols."""
    counts = bytes(len(symbols.get(bits, b"")) for bits in range(1, 17))
    return bytes((kind,)) + counts + b"".join(symbols[bits] for bits in sorted(symbols))


@cache
def _zigzag() -> list[tuple[int, int]]:
    """Return the places of a block in the order of the file: along its diagonals, to and fro."""
    places = [(row, column) for row in range(_SIDE) for column in range(_SIDE)]
    return sorted(places, key=lambda place: (sum(place), place[0] if sum(place) % 2 else place[1]))


def _steps(quality_percent: float) -> Any:
    """Return the size of one step of each coefficient: larger for finer detail, and for a lower quality."""
    import numpy as np

    quality = min(100.0, max(1.0, quality_percent))
    scale = 50.0 / quality if quality < 50 else 2.0 - quality / 50.0
    index = np.arange(_SIDE)
    return np.clip(np.rint((10.0 + 6.0 * (index[:, None] + index)) * scale), 1, 255)


def _planes(picture: Picture) -> list[Any]:
    """Return brightness and the two differences of colour of a picture (JFIF 1.02)."""
    import numpy as np

    red, green, blue = (picture[:, :, channel].astype(np.float64) for channel in range(3))
    grey = 0.299 * red + 0.587 * green + 0.114 * blue
    return [grey, 128.0 + (blue - grey) / 1.772, 128.0 + (red - grey) / 1.402]


def _blocks(plane: Any, steps: Any) -> Any:
    """Return the coefficients of each block of 8 by 8, in steps, in the order of the file."""
    import numpy as np

    rows, columns = (-size % _SIDE for size in plane.shape)
    plane = np.pad(plane, ((0, rows), (0, columns)), mode="edge")
    high, wide = plane.shape[0] // _SIDE, plane.shape[1] // _SIDE
    blocks = plane.reshape(high, _SIDE, wide, _SIDE).swapaxes(1, 2).reshape(-1, _SIDE, _SIDE)
    index = np.arange(_SIDE)
    waves = np.sqrt(2.0 / _SIDE) * np.cos((2 * index + 1) * index[:, None] * np.pi / (2 * _SIDE))
    waves[0] = np.sqrt(1.0 / _SIDE)
    coefficients = np.rint(waves @ blocks @ waves.T / steps).astype(int)
    order = [row * _SIDE + column for row, column in _zigzag()]
    return np.clip(coefficients.reshape(-1, _SIDE * _SIDE)[:, order], -_LARGEST, _LARGEST)


def _scan(changes: list[int], details: Any) -> bytes:
    """Return the coded blocks.

    Args:
        changes: By how much the mean of each block differs from that of the block before, of the same plane.
        details: The other 63 numbers of each block.
    """
    bits = []
    blocks, places = details.nonzero()
    numbers = iter(zip(blocks.tolist(), places.tolist(), details[blocks, places].tolist(), strict=True))
    following = next(numbers, None)
    for block, change in enumerate(changes):
        size, amount = _amount(change)
        bits.append(f"{size:04b}{amount}")
        before = -1
        while following is not None and following[0] == block:
            _, place, number = following
            zeros = place - before - 1
            while zeros > _LONGEST_RUN:
                bits.append(_ac_codes()[_SIXTEEN_ZEROS])
                zeros -= _LONGEST_RUN + 1
            size, amount = _amount(number)
            bits.append(_ac_codes()[zeros << 4 | size] + amount)
            before, following = place, next(numbers, None)
        if before < details.shape[1] - 1:
            bits.append("0")
    text = "".join(bits)
    text += "1" * (-len(text) % 8)
    return int("1" + text, 2).to_bytes(len(text) // 8 + 1, "big")[1:]


@cache
def _ac_codes() -> dict[int, str]:
    return {symbol: f"{(1 << _AC_BITS - 1) + number:b}" for number, symbol in enumerate(_AC_SYMBOLS)}


def _amount(number: int) -> tuple[int, str]:
    """Return how many bits a number takes, and these bits. A negative number is stored as its complement."""
    size = abs(number).bit_length()
    if not size:
        return 0, ""
    return size, f"{number if number > 0 else number + (1 << size) - 1:0{size}b}"
