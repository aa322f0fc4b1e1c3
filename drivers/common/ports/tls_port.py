"""TLS over a TCP connection, as client or as server. As on plain TCP, a write is complete or raises."""

from __future__ import annotations

import ssl

import trio

from strands_actors.contract.wire import WireDown

from .tcp_port import TcpPort, open_tcp

_CHUNK = 1 << 16

MOST_SILENT_READS = 16
"""Most reads in one ``read_waiting`` that may carry no content, since TLS has such records."""


class TlsRecords:
    """Encrypt and decrypt the data of one TLS connection, as client or as server. Pure: no socket, no clock."""

    def __init__(self, context: ssl.SSLContext, server_hostname: str | None = None) -> None:
        """Prepare the client or the server side.

        Args:
            context: The TLS settings.
            server_hostname: The name that the server's certificate must prove. None makes the server side.
        """
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(
            self._incoming, self._outgoing, server_side=server_hostname is None, server_hostname=server_hostname
        )
        self.is_up = False
        """True once the handshake is complete."""

    def decrypt(self, data: bytes) -> bytes:
        """Decrypt received TLS records, and return their content. Raise ``ssl.SSLError``."""
        self._incoming.write(data)
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

    def encrypt(self, data: bytes) -> None:
        """Encrypt bytes. ``outgoing`` returns the resulting TLS records. Raise ``ssl.SSLError``."""
        self._tls.write(data)

    def outgoing(self) -> bytes:
        """Return the TLS records that must be sent now."""
        return self._outgoing.read()


class TlsPort:
    """A ``ByteStream`` with TLS over a TCP connection. ``open_tls`` makes it."""

    def __init__(self, port: TcpPort, records: TlsRecords) -> None:
        self._port = port
        self._records = records
        self._decrypted = b""
        self.name = port.name

    async def shake_hands(self) -> None:
        """Do the TLS handshake.

        Raises:
            WireDown: The peer cannot prove its name, or does not support TLS.
        """
        self._hear(b"")
        while not self._records.is_up:
            self._hear(await self._port.read())

    def write(self, data: bytes) -> None:
        try:
            self._records.encrypt(data)
        except ssl.SSLError as error:
            raise self._wire_down(error) from None
        self._flush()

    async def read(self) -> bytes:
        while not self._decrypted:
            self._hear(await self._port.read())
        return self._take()

    def read_waiting(self) -> bytes | None:
        """Return bytes that have arrived; None if there are no bytes. Never waits.

        Raises:
            WireDown: The connection is lost.
        """
        for _ in range(MOST_SILENT_READS):
            if self._decrypted or (data := self._port.read_waiting()) is None:
                break
            self._hear(data)
        return self._take() or None

    def close(self) -> None:
        self._port.close()

    def close_in_order(self) -> None:
        """Close the connection, but let the written data still arrive."""
        self._port.close_in_order()

    def _take(self) -> bytes:
        data, self._decrypted = self._decrypted, b""
        return data

    def _hear(self, data: bytes) -> None:
        try:
            self._decrypted += self._records.decrypt(data)
        except ssl.SSLError as error:
            raise self._wire_down(error) from None
        self._flush()

    def _flush(self) -> None:
        data = self._records.outgoing()
        if data:
            self._port.write(data)

    def _wire_down(self, error: ssl.SSLError) -> WireDown:
        if isinstance(error, ssl.SSLCertVerificationError):
            reason = f"its certificate is not accepted ({error.verify_message})"
        else:
            reason = f"TLS failed ({error.reason or error})"
        return WireDown(f"{self.name}: {reason}. Check that this is the robot, and that no proxy is in between")


async def open_tls(
    host: str, port: int, context: ssl.SSLContext, server_hostname: str, *, within_s: float
) -> TlsPort:
    """Connect, and verify the peer's certificate, within ``within_s``.

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
    raise WireDown(f"{host}:{port}: no TLS handshake within {within_s * 1e3:.0f} ms. Check port=, and the robot")
