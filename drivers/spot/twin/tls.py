"""The TLS server of the simulated Spot.

Its private key is published. Only clients that were given ``?ca=`` should trust it. The key of the
certificate authority was deleted.
"""

from __future__ import annotations

import ssl
from importlib import resources

from strands_actors.drivers.common.ports.tls_port import TlsRecords
from strands_actors.drivers.common.twin import ClientGone, Connection

MOST_WAITING = 16 << 20
"""Most bytes that wait for a client. A client that reads more slowly loses the connection."""


def certificate(name: str) -> str:
    """Return the path of a file in this package: ``ca.pem`` (certificate of the authority), or
    ``twin.pem`` (certificate and key of the simulated Spot)."""
    return str(resources.files(__package__).joinpath(name))


def server_context() -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate("twin.pem"))
    context.set_alpn_protocols(["h2"])
    return context


class TlsConnection(Connection):
    """A TLS connection to a client. It returns decrypted data."""

    def __init__(self, below: Connection, context: ssl.SSLContext) -> None:
        self._below = below
        self._records = TlsRecords(context)
        self._queue = b""
        self.log = below.log
        self.frost = below.frost

    async def shake_hands(self) -> None:
        """Complete the handshake. Raise ``ClientGone``."""
        # Data that arrived together with the handshake, and its time.
        self._early = 0, b""
        while not self._records.is_up:
            t_ns, data = await self._below.receive()
            self._early = t_ns, self._hear(data)

    async def receive(self) -> tuple[int, bytes]:
        """Return the next bytes and the time of reading. Raise ``ClientGone``."""
        t_ns, early = self._early
        if early:
            self._early = 0, b""
            return t_ns, early
        while True:
            t_ns, data = await self._below.receive()
            plain = self._hear(data)
            if plain:
                return t_ns, plain

    def send(self, data: bytes) -> None:
        try:
            self._records.encrypt(data)
        except ssl.SSLError:
            self.abort()
            return
        self._queue += self._records.outgoing()
        self.push()

    def push(self) -> None:
        """Send the waiting bytes, as far as they fit into the client's buffer. A picture does not fit at once."""
        while self._queue and (sent := self._below.send_part(self._queue)):
            self._queue = self._queue[sent:]
        if len(self._queue) > MOST_WAITING:
            self.abort()

    def abort(self) -> None:
        self._below.abort()

    def _hear(self, data: bytes) -> bytes:
        try:
            plain = self._records.decrypt(data)
        except ssl.SSLError:
            raise ClientGone from None
        self._queue += self._records.outgoing()
        self.push()
        return plain
