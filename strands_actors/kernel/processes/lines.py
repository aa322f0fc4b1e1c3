"""Read the lines that a process writes."""

from __future__ import annotations

from collections.abc import AsyncIterator

import trio


async def lines_of(stream: trio.abc.ReceiveStream, longest: int | None = None) -> AsyncIterator[bytes]:
    """Yield each complete line, without its end, as the bytes arrive. A rest without a line's end is dropped.

    Args:
        stream: Such as the standard output of a ``trio.Process``.
        longest: End at a line that is longer than this, in bytes; None for any length.
    """
    rest = b""
    async for piece in stream:
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            yield line
        if longest is not None and len(rest) > longest:
            return
