"""A connection from which several tasks read. The first task that waits reads for all; the others wait for it.

If received data cannot be decoded, the connection is *deaf*: nothing more is read from it, and only a stop can be
written to it. It is kept until it is replaced or closed, because a stop must not wait for a new connection.
"""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import OrderlyStream


class SharedStream:
    """A connection that several tasks use, and that can be replaced by a new one.

    Args:
        on_close: Called whenever the connection is closed or replaced.
    """

    def __init__(self, on_close: Callable[[], None]) -> None:
        self._on_close = on_close
        self._stream: OrderlyStream | None = None
        self._reader: trio.CancelScope | None = None
        self._news = trio.Event()
        self._deaf_reason = ""

    @property
    def connection(self) -> OrderlyStream | None:
        """The present connection; None if there is no connection, or if it is deaf (received data could not be
        decoded)."""
        return None if self._deaf_reason else self._stream

    @property
    def is_connected(self) -> bool:
        """True if there is a connection, even if its received data could not be decoded."""
        return self._stream is not None

    def replace(self, stream: OrderlyStream) -> None:
        """Use ``stream`` as the connection from now on, and close the previous one."""
        self.close()
        self._stream = stream

    def write(self, data: bytes) -> None:
        """Send all of ``data`` now. If that fails, close the connection and raise ``WireDown``."""
        if self._deaf_reason:
            raise WireDown(f"received data could not be decoded ({self._deaf_reason}). Reconnect")
        self.write_stop(data)

    def write_stop(self, data: bytes) -> None:
        """Send the bytes of a stop command now. Unlike ``write``, it does not fail if received data could not be
        decoded."""
        if self._stream is None:
            raise WireDown("not connected. Reconnect")
        try:
            self._stream.write(data)
        except WireDown:
            self.close()
            raise

    async def read(self) -> bytes:
        """Wait for data, and return it.

        The result is empty if another task has read the data, or if the connection was closed meanwhile.

        Raises:
            WireDown: The connection is lost, or there is no connection.
        """
        stream, data = self.connection, b""
        if stream is None:
            raise WireDown("not connected. Reconnect")
        if self._reader is not None:
            await self._news.wait()
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
            # After a reconnect, another task may already be the reader of the new connection.
            if self._reader is reader:
                self._reader = None
            self._wake()
        return data if self._stream is stream else b""

    def deafen(self, reason: str) -> None:
        """Stop reading, because received data cannot be decoded. ``reason`` is the reason, for messages."""
        if self._stream is not None:
            self._deaf_reason = reason
            self._wake()

    def close(self, in_order: bool = False) -> None:
        """Reset the connection. A second call does nothing.

        Args:
            in_order: Close in order instead, so that written data (a stop command) still arrives. A connection
                with received data that could not be decoded is always closed in order.
        """
        self._close(in_order or bool(self._deaf_reason))

    def reset(self) -> None:
        """Reset the connection even if received data could not be decoded. Written data that has not arrived is
        dropped. Use it after a stop was confirmed on another connection."""
        self._close(in_order=False)

    def _close(self, in_order: bool) -> None:
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.cancel()
        if self._stream is not None:
            if in_order:
                self._stream.close_in_order()
            else:
                self._stream.close()
        self._stream, self._deaf_reason = None, ""
        self._on_close()
        self._wake()

    def _wake(self) -> None:
        news, self._news = self._news, trio.Event()
        news.set()
