"""One connection that several tasks read: the first that waits reads for all, and the others wait until
it has.

A connection whose peer cannot be understood any more is *deaf*: nothing is read from it, and nothing
but a stop is written to it. It is kept until it is replaced or closed, because a stop must not wait
for another connection.
"""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import OrderlyStream


class SharedStream:
    """``on_close`` is called whenever the connection is closed or replaced."""

    def __init__(self, on_close: Callable[[], None]) -> None:
        self._on_close = on_close
        self._stream: OrderlyStream | None = None
        self._reader: trio.CancelScope | None = None
        self._heard = trio.Event()
        self._why_deaf = ""

    @property
    def connection(self) -> OrderlyStream | None:
        """The present one, unless it is deaf: what was asked on another is not answered any
        more."""
        return None if self._why_deaf else self._stream

    @property
    def is_connected(self) -> bool:
        """Return whether there is a connection, a deaf one included."""
        return self._stream is not None

    def replace(self, stream: OrderlyStream) -> None:
        """Use ``stream`` from now on, and close the one before."""
        self.close()
        self._stream = stream

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once. Raise ``WireDown``, and close, when that cannot be."""
        if self._why_deaf:
            raise WireDown(f"the connection is not understood any more ({self._why_deaf}). Reconnect")
        self.write_stop(data)

    def write_stop(self, data: bytes) -> None:
        """As ``write``, on a deaf connection, too."""
        if self._stream is None:
            raise WireDown("not connected. Reconnect")
        try:
            self._stream.write(data)
        except WireDown:
            self.close()
            raise

    async def read(self) -> bytes:
        """Return what comes next; nothing, when another task has read it, or the connection was
        closed meanwhile. Raise ``WireDown`` when it is lost, or there is none."""
        stream, data = self.connection, b""
        if stream is None:
            raise WireDown("not connected. Reconnect")
        if self._reader is not None:
            await self._heard.wait()
            return b""
        self._reader = reader = trio.CancelScope()
        try:
            with reader:
                data = await stream.read()
        except WireDown:
            if self._stream is stream:
                self.close()
            raise
        finally:
            if self._reader is reader:  # and not that of a task that reads from the next connection
                self._reader = None
            self._wake()
        return data if self._stream is stream else b""

    def deafen(self, why: str) -> None:
        """Read nothing any more: what came is not understood."""
        if self._stream is not None:
            self._why_deaf = why
            self._wake()

    def close(self, in_order: bool = False) -> None:
        """Throw the connection away. Harmless when called again. ``in_order``: what was written on
        it, a stop, still arrives; so it does on a deaf one."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.cancel()
        if self._stream is not None:
            if in_order or self._why_deaf:
                self._stream.close_in_order()
            else:
                self._stream.close()
        self._stream, self._why_deaf = None, ""
        self._on_close()
        self._wake()

    def _wake(self) -> None:
        heard, self._heard = self._heard, trio.Event()
        heard.set()
