"""Test both ends of TLS over bytes: pieces of any size, any peer, any input."""

from __future__ import annotations

import random
import socket
import ssl
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.tls_port import TlsPort, TlsRecords, open_tls
from strands_actors.drivers.common.twin import Connection, WireLog
from strands_actors.drivers.common.twin.server import Frost
from strands_actors.drivers.spot.twin.tls import TlsConnection, certificate, server_context

NAME = "api.spot.robot"
DISTURBED = 2_000


def client_context(ca: str | None = None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.set_alpn_protocols(["h2"])
    context.load_verify_locations(ca or certificate("ca.pem"))
    return context


def shaken(name: str = NAME) -> tuple[TlsRecords, TlsRecords]:
    """Return both ends of an established connection."""
    client, server = TlsRecords(client_context(), name), TlsRecords(server_context())
    client.decrypt(b"")
    while not (client.is_up and server.is_up):
        server.decrypt(client.outgoing())
        client.decrypt(server.outgoing())
    client.decrypt(server.outgoing())  # bytes behind the handshake
    return client, server


def test_bytes_arrive_at_the_other_end_in_any_pieces() -> None:
    client, server = shaken()
    said = random.Random(1).randbytes(100_000)
    client.encrypt(said)
    records, received = client.outgoing(), b""
    for at in range(0, len(records), 777):
        received += server.decrypt(records[at : at + 777])
    assert received == said
    server.encrypt(b"yes")
    assert client.decrypt(server.outgoing()) == b"yes"
    assert said[:100] not in records


class Below(Connection):
    """The connection below a twin's TLS. Its pieces arrive at 1, 2, 3 ns and so on."""

    def __init__(self, sock: socket.socket, client: TlsRecords, said: bytes) -> None:
        super().__init__(sock, WireLog(None), Frost())
        self._client = client
        self._said = said
        self.t_ns = 0
        client.decrypt(b"")

    async def receive(self) -> tuple[int, bytes]:
        self.t_ns += 1
        if self._client.is_up and self._said:
            self._client.encrypt(self._said)
            self._said = b""
        return self.t_ns, self._client.outgoing()

    def send_part(self, data: bytes) -> int:
        self._client.decrypt(data)
        return len(data)


def test_data_in_the_same_piece_as_the_handshake_has_its_time_in_a_twins_log() -> None:
    async def run() -> None:
        with socket.socket() as unused:
            below = Below(unused, TlsRecords(client_context(), NAME), b"a stop")
            twin = TlsConnection(below, server_context())
            await twin.shake_hands()
            assert await twin.receive() == (2, b"a stop")
            assert below.t_ns == 2, "the data has the time of the piece that ends the handshake"

    trio.run(run)


def test_saf_017_a_peer_with_another_name_or_certificate_is_refused() -> None:
    with pytest.raises(ssl.SSLCertVerificationError, match=r"not valid for 'robot\.example'"):
        shaken("robot.example")
    stranger = TlsRecords(client_context_that_knows_nobody(), NAME)
    server = TlsRecords(server_context())
    stranger.decrypt(b"")
    server.decrypt(stranger.outgoing())
    with pytest.raises(ssl.SSLCertVerificationError):
        stranger.decrypt(server.outgoing())


def client_context_that_knows_nobody() -> ssl.SSLContext:
    return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


def test_nothing_is_sent_before_the_peer_is_authenticated() -> None:
    with pytest.raises(ssl.SSLError):
        TlsRecords(client_context(), NAME).encrypt(b"a password")


def test_any_bytes_are_accepted_or_refused() -> None:
    chance = random.Random(3)
    client, server = shaken()
    server.encrypt(b"x" * 300)
    good, refused = server.outgoing(), 0
    for _ in range(DISTURBED):
        end = TlsRecords(client_context_that_knows_nobody(), NAME) if chance.random() < 0.5 else TlsRecords(SERVER)
        at = chance.randrange(len(good))
        noise = good[:at] + chance.randbytes(chance.randrange(1, 60)) + good[at:]
        try:
            assert end.decrypt(chance.choice((noise, chance.randbytes(200), good))) == b""
        except ssl.SSLError:
            refused += 1
    assert refused > DISTURBED / 2
    with pytest.raises(ssl.SSLError):
        client.decrypt(good[:-1] + bytes([good[-1] ^ 1]))


SERVER = server_context()


# -- on sockets


async def against(serve: Callable[[trio.SocketStream], Any], test: Callable[[int], Any]) -> None:
    """Run a client against a server on its own port."""
    async with trio.open_nursery() as nursery:
        listeners = await nursery.start(partial(trio.serve_tcp, serve, 0, host="127.0.0.1"))
        await test(listeners[0].socket.getsockname()[1])
        nursery.cancel_scope.cancel()


async def echo(stream: trio.SocketStream) -> None:
    tls = trio.SSLStream(stream, server_context(), server_side=True)
    try:
        async for data in tls:
            await tls.send_all(data)
    except trio.BrokenResourceError:
        return  # the client was closed with a reset


def test_a_port_writes_at_once_and_reads_new_bytes() -> None:
    async def test(port: int) -> None:
        tls = await open_tls("127.0.0.1", port, client_context(), NAME, within_s=5.0)
        assert isinstance(tls, TlsPort) and tls.read_waiting() is None
        tls.write(b"hello")
        received = b""
        while len(received) < 5:
            received += await tls.read()
        assert received == b"hello"
        tls.close()
        with pytest.raises(WireDown):
            tls.write(b"more")

    trio.run(against, echo, test)


def test_a_peer_that_accepts_the_connection_and_sends_nothing_is_given_up() -> None:
    async def silent(stream: trio.SocketStream) -> None:
        await trio.sleep_forever()

    async def test(port: int) -> None:
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="no TLS handshake within 200 ms"):
            await open_tls("127.0.0.1", port, client_context(), NAME, within_s=0.2)
        assert trio.current_time() - began_s < 2.0

    trio.run(against, silent, test)


def test_a_peer_without_tls_is_named() -> None:
    async def plain(stream: trio.SocketStream) -> None:
        await stream.send_all(b"SSH-2.0-OpenSSH\r\n")
        await trio.sleep_forever()

    async def test(port: int) -> None:
        with pytest.raises(WireDown, match="TLS failed"):
            await open_tls("127.0.0.1", port, client_context(), NAME, within_s=5.0)

    trio.run(against, plain, test)


def test_a_peer_whose_certificate_is_not_accepted_is_named() -> None:
    async def test(port: int) -> None:
        with pytest.raises(WireDown, match="its certificate is not accepted"):
            await open_tls("127.0.0.1", port, client_context_that_knows_nobody(), NAME, within_s=5.0)

    async def serve(stream: trio.SocketStream) -> None:
        with pytest.raises(trio.BrokenResourceError):
            await echo_to_the_end(stream)

    trio.run(against, serve, test)


async def echo_to_the_end(stream: trio.SocketStream) -> None:
    tls = trio.SSLStream(stream, server_context(), server_side=True)
    await tls.do_handshake()
    await tls.receive_some()


def test_a_missing_peer_is_named() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    async def test() -> None:
        with pytest.raises(WireDown, match="cannot connect"):
            await open_tls("127.0.0.1", port, client_context(), NAME, within_s=1.0)

    trio.run(test)
