"""One connection that several tasks read. The first task that waits reads for all; the others wait until it
has.

If received data cannot be decoded, the connection is *deaf*: nothing is read from it, and only a stop is
written to it. It is kept until it is replaced or closed, because a stop must not wait for another
connection.
"""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import OrderlyStream


class SharedStream:
    """A connection that can be replaced.

    Args:
        on_close: Called whenever the connection is closed or replaced.
    """

    def __init__(self, on_close: Callable[[], None]) -> None:
        self._on_close = on_close
        self._stream: OrderlyStream | None = None
        self._reader: trio.CancelScope | None = None
        self._heard = trio.Event()
        self._why_deaf = ""

    @property
    def connection(self) -> OrderlyStream | None:
        """The present connection; None if there is no connection, or it is deaf. A request on an earlier
        one is never answered."""
        return None if self._why_deaf else self._stream

    @property
    def is_connected(self) -> bool:
        """True if there is a connection, even a deaf one."""
        return self._stream is not None

    def replace(self, stream: OrderlyStream) -> None:
        """Use ``stream`` from now on, and close the previous connection."""
        self.close()
        self._stream = stream

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once. Raise ``WireDown`` and close if it cannot leave."""
        if self._why_deaf:
            raise WireDown(f"the connection is not understood any more ({self._why_deaf}). Reconnect")
        self.write_stop(data)

    def write_stop(self, data: bytes) -> None:
        """As ``write``, also on a deaf connection."""
        if self._stream is None:
            raise WireDown("not connected. Reconnect")
        try:
            self._stream.write(data)
        except WireDown:
            self.close()
            raise

    async def read(self) -> bytes:
        """Return the next data.

        It is empty if another task has read, or the connection was closed meanwhile.

        Raises:
            WireDown: The connection is lost, or there is no connection.
        """
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
            if self._reader is reader:  # Another task may read from the next connection already.
                self._reader = None
            self._wake()
        return data if self._stream is stream else b""

    def deafen(self, why: str) -> None:
        """Stop reading, because received data cannot be decoded. ``why`` is for messages."""
        if self._stream is not None:
            self._why_deaf = why
            self._wake()

    def close(self, in_order: bool = False) -> None:
        """Reset the connection. Another call does nothing.

        Args:
            in_order: Close in order instead, so that written data (a stop) still arrives. A deaf
                connection is always closed in order.
        """
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
