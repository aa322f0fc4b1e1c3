"""Test WebSockets: messages as bytes, our client with other servers, other clients with our server."""

from __future__ import annotations

import asyncio
import random
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial

import pytest
import trio
import trio.testing
import websockets.exceptions
import websockets.sync.client
import websockets.sync.server
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.codecs.websocket_messages import Accepted, ClientEnd, Closed, Opened, ServerEnd
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.ports.websocket import WebSocket, open_websocket
from strands_actors.drivers.common.twin import Fault, Faults, TcpServer, WireLog
from strands_actors.drivers.common.twin.http import Answer, HttpSession
from strands_actors.drivers.common.twin.websocket import (
    WebSocketClient,
    WebSocketHandler,
    serving_both,
    serving_websocket,
)

Served = Callable[[], Awaitable[WebSocket]]


class Robot:
    """An HTTP service with one short answer, for requests outside the WebSockets."""

    def __init__(self) -> None:
        self.faults = Faults()

    def answer(self, request: Request) -> Answer:
        return Answer(200, request.target.encode())

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        self.faults.set(fault, unit)

    def power_cycle(self) -> None:
        self.faults.set(Fault.OK)


async def echo(client: WebSocketClient) -> None:
    while True:
        t_ns, message = await client.receive()
        client.log_received(t_ns, "echo", message)
        client.send_logged("echo", message)


@asynccontextmanager
async def twin(handler: WebSocketHandler = echo, **options: int) -> AsyncIterator[TcpServer]:
    """Yield a server at ``/ws``, on its own port."""
    choose = {"/ws": handler}.get
    robot = Robot()
    server = TcpServer(robot, {0: serving_both(lambda: HttpSession(robot), choose, **options)}, WireLog(None))
    async with trio.open_nursery() as nursery:
        server.plug()
        nursery.start_soon(server.serve)
        with trio.fail_after(20):
            yield server
        nursery.cancel_scope.cancel()
    server.close()


def connect(server: TcpServer, target: str = "/ws", **options: int) -> Awaitable[WebSocket]:
    host, _, port = server.address.partition(":")
    return open_websocket(host, int(port), target, within_s=5.0, **options)


@contextmanager
def foreign_server(handler: Callable[[websockets.sync.server.ServerConnection], None]) -> Iterator[int]:
    """Yield the port of a server from another library."""
    with websockets.sync.server.serve(handler, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.socket.getsockname()[1]
        finally:
            server.shutdown()
            thread.join()


# -- bytes


def upgraded(max_message: int = 1000) -> tuple[ClientEnd, ServerEnd]:
    client, server = ClientEnd("robot:8000", "/ws?x=1", [(b"X-Who", b"me")], max_message), ServerEnd(max_message)
    (opened,) = server.feed(client.request)
    assert isinstance(opened, Opened) and opened.target == "/ws?x=1" and opened.headers["x-who"] == "me"
    assert list(client.feed(server.accept())) == [Accepted()]
    return client, server


@given(messages=st.lists(st.text(max_size=300) | st.binary(max_size=300), max_size=8), step=st.integers(1, 50))
def test_messages_arrive_whole_in_any_pieces_both_ways(messages: list[str | bytes], step: int) -> None:
    client, server = upgraded(1300)
    for sender, receiver in ((client, server), (server, client)):
        wire = b"".join(sender.message(message) for message in messages)
        received = [found for at in range(0, len(wire), step) for found in receiver.feed(wire[at : at + step])]
        assert received == messages


@given(seed=st.integers(0, 1 << 32), cut=st.integers(0, 3))
def test_disturbed_frames_raise_nothing_else_and_yield_no_more_than_the_bound(seed: int, cut: int) -> None:
    chance = random.Random(seed)
    client, server = upgraded(200)
    for receiver, sender in ((server, client), (client, server)):
        for _ in range(20):
            frame = bytearray(sender.message(chance.choice(["text", b"bytes" * 30, "x" * 150])))
            for _ in range(cut):
                frame[chance.randrange(len(frame))] = chance.randrange(256)
            data = bytes(frame) + chance.randbytes(chance.randrange(0, 20) if cut else 0)
            try:
                for received in receiver.feed(data):
                    assert not isinstance(received, str | bytes) or len(received) <= 200
            except MalformedFrame:
                break
            receiver.replies()


@given(data=st.binary(max_size=600))
def test_an_invalid_upgrade_is_malformed(data: bytes) -> None:
    for end in (ServerEnd(), ClientEnd("robot:1", "/")):
        try:
            received = list(end.feed(data + b"\r\n\r\n"))
        except MalformedFrame:
            continue
        assert not any(isinstance(one, Accepted | Opened) for one in received)


def test_a_message_longer_than_the_bound_is_refused_before_it_is_whole() -> None:
    client, _ = upgraded(100)
    _, big = upgraded(1000)
    frame = big.message(b"x" * 150)
    with pytest.raises(MalformedFrame, match="more than 100"):
        list(client.feed(frame[:-1]))
    with pytest.raises(MalformedFrame, match="after the end"):
        list(client.feed(b""))
    with pytest.raises(MalformedFrame, match="more than 100"):
        client.message("y" * 101)


def test_a_ping_is_answered_and_a_server_answers_a_close_too() -> None:
    client, server = upgraded()
    assert list(client.feed(server.ping(b"here?"))) == []
    (pong,) = server.feed(client.replies())
    assert pong == (b"here?",) and client.replies() == b""
    assert list(server.feed(client.close(1001))) == [Closed(1001, "")]
    assert list(client.feed(server.replies())) == [Closed(1001, "")]
    with pytest.raises(MalformedFrame, match="not open"):
        client.message("late")


def test_saf_022_a_client_answers_no_close_so_that_a_stop_counts_behind_it() -> None:
    client, server = upgraded()
    assert list(client.feed(server.close(1001))) == [Closed(1001, "")]
    assert client.replies() == b""
    with pytest.raises(MalformedFrame, match="not open"):
        client.message("late")
    assert client.stop(["stop"])


# -- our client


def test_text_and_binary_at_our_server_and_http_on_the_same_port() -> None:
    async def main() -> None:
        async with twin() as server:
            socket_ = await connect(server)
            for message in ("text", b"bytes", "", b"", "ü" * 5000):
                socket_.send(message)
                assert await socket_.receive() == message
            host, _, port = server.address.partition(":")
            http = HttpPort(host, int(port))
            assert (await http.ask("GET", "/word", within_s=5.0)).body == b"/word"
            http.close()
            socket_.close()

    trio.run(main)


def test_a_server_of_another_make() -> None:
    def handler(connection: websockets.sync.server.ServerConnection) -> None:
        for message in connection:
            connection.send([message[:3], message[3:]])  # in fragments
            connection.ping()

    async def main(port: int) -> None:
        socket_ = await open_websocket("127.0.0.1", port, within_s=5.0)
        for message in ("text of a kind", b"binary too"):
            socket_.send(message)
            assert await socket_.receive_within(5.0) == message
        async with trio.open_nursery() as nursery:
            nursery.start_soon(drain, socket_)
            await socket_.ponged(socket_.ping(), 5.0)
            socket_.close_in_order()

    with foreign_server(handler) as port:
        trio.run(main, port)


async def drain(socket_: WebSocket) -> None:
    with pytest.raises(WireDown):
        while True:
            await socket_.receive()


def test_a_close_has_the_reason_and_nothing_is_sent_after_it() -> None:
    def handler(connection: websockets.sync.server.ServerConnection) -> None:
        connection.close(1008, "not you")

    async def main(port: int) -> None:
        socket_ = await open_websocket("127.0.0.1", port, within_s=5.0)
        with pytest.raises(WireDown, match="1008 not you"):
            await socket_.receive_within(5.0)
        assert not socket_.is_open
        with pytest.raises(WireDown, match="not you"):
            socket_.send("late")
        socket_.close()

    with foreign_server(handler) as port:
        trio.run(main, port)


def test_a_service_without_websockets_is_named_within_the_deadline() -> None:
    async def main() -> None:
        async with twin() as server:
            with pytest.raises(WireDown, match=r"/other: no WebSocket there .*status 404"):
                await connect(server, "/other")
            server.freeze(60)
            host, _, port = server.address.partition(":")
            with pytest.raises(WireDown, match="no WebSocket within 200 ms"):
                await open_websocket(host, int(port), "/ws", within_s=0.2)

    trio.run(main)


def test_a_peer_without_websockets() -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:

            def serve() -> None:
                sock, _ = listener.accept()
                with sock:
                    sock.recv(1000)
                    sock.sendall(b"HTTP/1.1 101 Sure\r\nUpgrade: websocket\r\n\r\n")
                    with pytest.raises(ConnectionResetError):
                        sock.recv(1000)

            async with trio.open_nursery() as nursery:
                nursery.start_soon(trio.to_thread.run_sync, serve)
                with pytest.raises(WireDown, match="no WebSocket there"):
                    await open_websocket("127.0.0.1", listener.getsockname()[1], within_s=5.0)

    trio.run(main)


def test_a_message_that_is_too_long_ends_it() -> None:
    async def main() -> None:
        async with twin() as server:
            socket_ = await connect(server, max_message=1000)
            with pytest.raises(ValueError, match="more than 1000"):
                socket_.send("x" * 1001)
            assert socket_.is_open
            socket_.close()

        async def shout(client: WebSocketClient) -> None:
            await client.receive()
            client.send_logged("shout", "x" * 1001)
            await client.receive()

        async with twin(shout) as server:
            socket_ = await connect(server, max_message=1000)
            with pytest.raises(WireDown, match="more than 1000"):
                socket_.send("go on")
                await socket_.receive()
            assert not socket_.is_open
            socket_.close()

    trio.run(main)


def taker() -> tuple[trio.MemoryReceiveChannel[str | bytes], WebSocketHandler]:
    """Return the clients' messages, and the handler that receives them."""
    send, receive = trio.open_memory_channel[str | bytes](100)

    async def take(client: WebSocketClient) -> None:
        while True:
            send.send_nowait((await client.receive())[1])

    return receive, take


def test_messages_lost_in_a_pulled_cable_are_not_sent_again() -> None:
    async def main() -> None:
        taken, take = taker()
        async with twin(take) as server:
            socket_ = await connect(server)
            socket_.send("before")
            assert await taken.receive() == "before"
            server.unplug()
            with pytest.raises(WireDown):
                for number in range(1000):
                    socket_.send(f"lost {number}")
            server.plug()
            again = await connect(server)
            with pytest.raises(WireDown, match="closed"):
                socket_.send("lost as well")
            again.send("anew")
            assert await taken.receive() == "anew"
            again.close()
            await trio.sleep(0.1)
            with pytest.raises(trio.WouldBlock):
                taken.receive_nowait()

    trio.run(main)


def test_a_stop_is_delivered_although_it_is_closed_at_once() -> None:
    async def main() -> None:
        taken, take = taker()
        async with twin(take) as server:
            socket_ = await connect(server)
            server.freeze(0.2)
            socket_.send("stop")
            socket_.close_in_order()
            assert await taken.receive() == "stop"

    trio.run(main)


def test_output_that_is_blocked_ends_it_and_nothing_waits() -> None:
    async def main() -> None:
        async with twin() as server:
            socket_ = await connect(server)
            server.freeze(60)
            with pytest.raises(WireDown, match="blocked"):
                while True:
                    socket_.send(b"x" * 100_000)
            assert not socket_.is_open

    trio.run(main)


def test_a_close_or_a_pulled_cable_ends_every_wait() -> None:
    async def main() -> None:
        async with twin() as server:
            for end in (WebSocket.close, lambda _: server.unplug()):
                socket_ = await connect(server)
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(drain, socket_)
                    await trio.testing.wait_all_tasks_blocked()
                    end(socket_)
                assert not socket_.is_open

    trio.run(main)


def test_a_cancelled_receive_loses_nothing_and_silence_has_a_deadline() -> None:
    async def main() -> None:
        async with twin() as server:
            socket_ = await connect(server)
            with pytest.raises(WireDown, match="no message within 50 ms"):
                await socket_.receive_within(0.05)
            socket_.send("one")
            socket_.send("two")
            assert [await socket_.receive_within(5), await socket_.receive_within(5)] == ["one", "two"]
            server.freeze(60)
            with pytest.raises(WireDown, match="no pong within 50 ms"):
                await socket_.ponged(socket_.ping(), 0.05)
            socket_.close()

    trio.run(main)


# -- clients of other libraries


def test_clients_of_another_make_at_our_server() -> None:
    def blocking(address: str) -> None:
        with websockets.sync.client.connect(f"ws://{address}/ws") as client:
            client.send("text")
            assert client.recv(5) == "text"
            client.send([b"in ", b"fragments"])
            assert client.recv(5) == b"in fragments"
            assert client.ping().wait(5)
        with pytest.raises(websockets.exceptions.InvalidStatus, match="404"):
            websockets.sync.client.connect(f"ws://{address}/other")

    def on_asyncio(address: str) -> None:
        async def main() -> None:
            async with websockets.connect(f"ws://{address}/ws", compression="deflate") as client:
                await client.send("{}" * 1000)
                assert await client.recv() == "{}" * 1000

        asyncio.run(main())

    async def main() -> None:
        async with twin() as server:
            for client in (blocking, on_asyncio):
                await trio.to_thread.run_sync(partial(client, server.address))

    trio.run(main)


def test_a_port_with_websockets_only_refuses_other_requests() -> None:
    async def main() -> None:
        server = TcpServer(Robot(), {0: serving_websocket({"/": echo}.get)}, WireLog(None))
        async with trio.open_nursery() as nursery:
            server.plug()
            nursery.start_soon(server.serve)
            host, _, port = server.address.partition(":")
            socket_ = await open_websocket(host, int(port), within_s=5.0)
            socket_.send("x")
            assert await socket_.receive_within(5.0) == "x"
            socket_.close()
            stream = await trio.open_tcp_stream(host, int(port))
            await stream.send_all(b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n")
            with trio.fail_after(5), pytest.raises(trio.BrokenResourceError):
                await stream.receive_some(100)
            await stream.aclose()
            nursery.cancel_scope.cancel()
        server.close()

    trio.run(main)
