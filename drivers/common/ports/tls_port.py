"""TLS over a byte stream, for either end: records in, plain bytes out. Writes behave as on the stream
below: all at once, or not at all.
"""

from __future__ import annotations

import ssl

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import TcpPort, open_tcp

_CHUNK = 1 << 16

MOST_SILENT_READS = 16
"""Most reads in one ``read_waiting`` that may carry no content, since TLS has such records."""


class TlsRecords:
    """One end of a connection. Pure: no socket, no clock."""

    def __init__(self, context: ssl.SSLContext, server_hostname: str | None = None) -> None:
        """Make one end.

        Args:
            context: The settings of TLS.
            server_hostname: The name that the peer must prove. None makes the server's end.
        """
        self._heard, self._said = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(
            self._heard, self._said, server_side=server_hostname is None, server_hostname=server_hostname
        )
        self.is_up = False
        """True once the handshake is complete."""

    def hear(self, data: bytes) -> bytes:
        """Take in records and return their content. Raise ``ssl.SSLError``."""
        self._heard.write(data)
        content = b""
        try:
            if not self.is_up:
                self._tls.do_handshake()
                self.is_up = True
            while part := self._tls.read(_CHUNK):
                content += part
        except ssl.SSLWantReadError:
            pass
        return content

    def say(self, data: bytes) -> None:
        """Put bytes into records, which ``outgoing`` returns. Raise ``ssl.SSLError``."""
        self._tls.write(data)

    def outgoing(self) -> bytes:
        """Return the records to send now."""
        return self._said.read()


class TlsPort:
    """A ``ByteStream`` over another. ``open_tls`` makes it."""

    def __init__(self, port: TcpPort, records: TlsRecords) -> None:
        self._port = port
        self._records = records
        self._told = b""
        self.name = port.name

    async def shake_hands(self) -> None:
        """Do the handshake.

        Raises:
            WireDown: The peer cannot prove its name, or speaks no TLS.
        """
        self._hear(b"")
        while not self._records.is_up:
            self._hear(await self._port.read())

    def write(self, data: bytes) -> None:
        try:
            self._records.say(data)
        except ssl.SSLError as error:
            raise self._gone(error) from None
        self._flush()

    async def read(self) -> bytes:
        while not self._told:
            self._hear(await self._port.read())
        return self._take()

    def read_waiting(self) -> bytes | None:
        """Return bytes that have arrived; None if there are no bytes. Never waits.

        Raises:
            WireDown: The connection is gone.
        """
        for _ in range(MOST_SILENT_READS):
            if self._told or (data := self._port.read_waiting()) is None:
                break
            self._hear(data)
        return self._take() or None

    def close(self) -> None:
        self._port.close()

    def close_in_order(self) -> None:
        """As ``close``, but written data is still delivered."""
        self._port.close_in_order()

    def _take(self) -> bytes:
        data, self._told = self._told, b""
        return data

    def _hear(self, data: bytes) -> None:
        try:
            self._told += self._records.hear(data)
        except ssl.SSLError as error:
            raise self._gone(error) from None
        self._flush()

    def _flush(self) -> None:
        data = self._records.outgoing()
        if data:
            self._port.write(data)

    def _gone(self, error: ssl.SSLError) -> WireDown:
        if isinstance(error, ssl.SSLCertVerificationError):
            why = f"its certificate is not accepted ({error.verify_message})"
        else:
            why = f"TLS failed ({error.reason or error})"
        return WireDown(f"{self.name}: {why}. Check that this is the robot, and that nobody is in between")


async def open_tls(
    host: str, port: int, context: ssl.SSLContext, server_hostname: str, *, within_s: float
) -> TlsPort:
    """Connect and verify the peer within ``within_s``.

    Raises:
        WireDown: It failed, or took longer.
    """
    below: TcpPort | None = None
    done = False
    try:
        with trio.move_on_after(within_s):
            below = await open_tcp(host, port)
            tls = TlsPort(below, TlsRecords(context, server_hostname))
            await tls.shake_hands()
            done = True
            return tls
    finally:
        if below is not None and not done:
            below.close()
    raise WireDown(f"{host}:{port}: no TLS within {within_s * 1e3:.0f} ms. Check port=, and the robot")
