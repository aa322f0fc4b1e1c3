"""One connection that several tasks hear: the first that waits reads for all, and the others wait until
it has."""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import ByteStream


class SharedStream:
    """``on_close`` is called whenever the connection is thrown away."""

    def __init__(self, on_close: Callable[[], None]) -> None:
        self._on_close = on_close
        self._stream: ByteStream | None = None
        self._reader: trio.CancelScope | None = None
        self._heard = trio.Event()

    @property
    def connection(self) -> ByteStream | None:
        """The present one: what was asked on another is not answered any more."""
        return self._stream

    def replace(self, stream: ByteStream) -> None:
        """Use ``stream`` from now on, and throw the one before away."""
        self.close()
        self._stream = stream

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once. Raise ``WireDown``, and close, when that cannot be."""
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
        stream, data = self._stream, b""
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
            if self._reader is reader:  # and not somebody's who reads from the next connection
                self._reader = None
            self._wake()
        return data if self._stream is stream else b""

    def close(self) -> None:
        """Throw the connection away. Harmless when called again."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.cancel()
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        self._on_close()
        self._wake()

    def _wake(self) -> None:
        heard, self._heard = self._heard, trio.Event()
        heard.set()
