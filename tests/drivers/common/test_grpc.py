"""Test both ends of gRPC: calls, messages and statuses in pieces of any size, and invalid bytes."""

from __future__ import annotations

import random
from collections import deque

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.grpc_messages import (
    MAX_MESSAGE,
    WINDOW,
    Called,
    ClientEnd,
    Ended,
    Event,
    HalfClosed,
    MessageDecoder,
    MessageReceived,
    PeerLeft,
    ServerEnd,
    Status,
    framed,
)
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.grpc import CallFailed, Connection, open_grpc
from tests.drivers.common.memory_port import virtual
from tests.drivers.disturbed import DISTURBED


class Pair:
    """A client's end and a server's end, connected."""

    def __init__(self) -> None:
        self.client, self.server = ClientEnd("192.0.2.1:50051"), ServerEnd()
        self.heard: list[Event] = []
        self.said: list[Event] = []
        self.join()

    def join(self) -> None:
        while (there := self.client.outgoing()) or self.server.settled is False:
            self.heard += self.server.feed(there)
            self.said += self.client.feed(self.server.outgoing())
        if back := self.server.outgoing():
            self.said += self.client.feed(back)
            self.join()


# -- messages


@given(st.lists(st.binary(max_size=300), max_size=8), st.integers(1, 50))
def test_messages_come_whole_in_any_pieces(messages: list[bytes], size: int) -> None:
    data = b"".join(map(framed, messages))
    decoder = MessageDecoder()
    found = [m for at in range(0, len(data), size) for m in decoder.feed(data[at : at + size])]
    assert found == messages


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x01\0\0\0\x01x", "compressed"),
        (b"\0" + (MAX_MESSAGE + 1).to_bytes(4, "big"), f"a message of {MAX_MESSAGE + 1} bytes"),
    ],
)
def test_an_invalid_message_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(MalformedFrame, match=says):
        list(MessageDecoder().feed(data))


# -- calls


def test_a_unary_call_and_its_answer() -> None:
    pair = Pair()
    stream = pair.client.call("/a.Service/Do")
    pair.client.send(stream, b"question", last=True)
    pair.join()
    assert pair.heard == [Called(stream, "/a.Service/Do"), MessageReceived(stream, b"question"), HalfClosed(stream)]
    pair.server.send(stream, b"answer")
    pair.server.end(stream)
    pair.join()
    assert pair.said == [MessageReceived(stream, b"answer"), Ended(stream, Status.OK)]


@pytest.mark.parametrize("status", [status for status in Status if status is not Status.OK])
def test_a_status_and_its_text_arrive(status: Status) -> None:
    pair = Pair()
    stream = pair.client.call("/a/B")
    pair.join()
    pair.server.end(stream, status, "nicht möglich: 100 %")
    pair.join()
    assert pair.said == [Ended(stream, status, "nicht möglich: 100 %")]


def test_a_call_that_is_given_up_ends_at_both_ends() -> None:
    pair = Pair()
    stream = pair.client.call("/a/B")
    pair.join()
    pair.client.reset(stream)
    pair.join()
    assert isinstance(pair.heard[-1], Ended) and pair.heard[-1].status is Status.CANCELLED
    pair.server.send(stream, b"late")
    pair.server.end(stream)
    pair.client.reset(stream)
    pair.join()
    assert pair.said == []


def test_a_client_does_not_exceed_the_peers_window() -> None:
    """Messages in the queue would leave late."""
    pair = Pair()
    stream = pair.client.call("/a/B")
    pair.join()
    message = bytes(16_000)
    sent = 0
    with pytest.raises(MalformedFrame, match="has room for"):
        while sent <= 2 * WINDOW:
            pair.client.send(stream, message)
            sent += len(message)
    assert sent <= WINDOW


def test_a_server_queues_for_a_slow_client_and_then_drops_the_client() -> None:
    pair = Pair()
    stream = pair.client.call("/a/B")
    pair.join()
    assert pair.server.has_room(stream)
    with pytest.raises(MalformedFrame, match="does not read"):
        for _ in range(1000):
            pair.server.send(stream, bytes(16_000))
    assert not pair.server.has_room(stream)
    assert len(pair.server.outgoing()) < 2 * WINDOW


def test_long_answers_come_in_pieces_and_before_the_status() -> None:
    pair = Pair()
    stream = pair.client.call("/a/B")
    pair.join()
    long = random.Random(5).randbytes(700_000)
    for _ in range(3):
        pair.server.send(stream, long)
        pair.join()
    pair.server.end(stream)
    pair.join()
    assert pair.said == [MessageReceived(stream, long)] * 3 + [Ended(stream, Status.OK)]


# -- invalid input


def conversation() -> tuple[bytes, bytes]:
    """Return all bytes of a client and of a server in a few calls."""
    client, server = ClientEnd("h:1"), ServerEnd()
    there, back = b"", b""
    for number in range(4):
        stream = client.call(f"/a.B/C{number}")
        client.send(stream, bytes(range(50)), last=True)
        data = client.outgoing()
        there += data
        for event in server.feed(data):
            if isinstance(event, HalfClosed):
                server.send(stream, b"answer" * number)
                server.end(stream, Status(number), "why")
        data = server.outgoing()
        back += data
        client.feed(data)
    return there, back


def disturbed(data: bytes, chance: random.Random) -> bytes:
    copy = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        match chance.randrange(4):
            case 0:
                copy[chance.randrange(len(copy))] ^= 1 << chance.randrange(8)
            case 1:
                at = chance.randrange(len(copy))
                del copy[at : at + chance.randint(1, 20)]
            case 2:
                at = chance.randrange(len(copy))
                copy[at:at] = chance.randbytes(chance.randint(1, 20))
            case _:
                copy = copy[: chance.randint(1, len(copy))]
        if not copy:
            return b"\0"
    return bytes(copy)


def test_disturbed_bytes_raise_only_the_codecs_error() -> None:
    there, back = conversation()
    chance = random.Random(20251)
    ended = {"client": 0, "server": 0}
    for _ in range(DISTURBED // 20):  # one conversation has about twenty frames
        client, server = ClientEnd("h:1"), ServerEnd()
        for number in range(4):
            client.send(client.call(f"/a.B/C{number}"), bytes(50), last=True)
        for name, end, data in (("client", client, back), ("server", server, there)):
            bad = disturbed(data, chance)
            try:
                for at in range(0, len(bad), 37):
                    end.feed(bad[at : at + 37])
                    assert len(end.outgoing()) < 1 << 16
            except MalformedFrame:
                ended[name] += 1
    assert min(ended.values()) > DISTURBED // 200, ended


def test_noise_is_no_http2() -> None:
    for end in (ClientEnd("h:1"), ServerEnd()):
        with pytest.raises(MalformedFrame):
            end.feed(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n" * 400)


# -- the connection


class Peer:
    """A stream in memory with a server's end behind it, which the test controls."""

    def __init__(self) -> None:
        self.end = ServerEnd()
        self.events: list[Event] = []
        self.closed = ""
        self.deaf = False
        self._coming: deque[bytes] = deque()
        self._news = trio.Event()
        self.flush()

    def flush(self) -> None:
        if data := self.end.outgoing():
            self.say(data)

    def say(self, data: bytes) -> None:
        self._coming.append(data)
        self._news.set()

    def write(self, data: bytes) -> None:
        if self.closed:
            raise WireDown("closed")
        if not self.deaf:
            self.events += self.end.feed(data)
            self.flush()

    async def read(self) -> bytes:
        while True:
            if (data := self.read_waiting()) is not None:
                await trio.lowlevel.checkpoint()
                return data
            self._news = trio.Event()
            await self._news.wait()

    def read_waiting(self) -> bytes | None:
        if self.closed:
            raise WireDown("closed")
        return self._coming.popleft() if self._coming else None

    def close(self) -> None:
        self.closed = self.closed or "reset"
        self._news.set()

    def close_in_order(self) -> None:
        self.closed = "in order"


async def opened(peer: Peer) -> Connection:
    async def open_stream(host: str, port: int) -> Peer:
        await trio.lowlevel.checkpoint()
        return peer

    return await open_grpc("192.0.2.1", 50051, within_s=0.5, open_stream=open_stream)


def test_a_peer_without_http2_is_named() -> None:
    async def main() -> None:
        peer = Peer()
        peer._coming.clear()
        peer.deaf = True
        with pytest.raises(WireDown, match="no gRPC service answers within 500 ms"):
            await opened(peer)
        assert peer.closed

    virtual(main)


def test_an_answer_that_does_not_come_ends_the_wait_and_the_question() -> None:
    async def main() -> None:
        peer = Peer()
        connection = await opened(peer)
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="Do: no answer within 300 ms"):
            await connection.unary("/a.B/Do", b"", 0.3)
        assert trio.current_time() - began_s == pytest.approx(0.3)
        assert isinstance(peer.events[-1], Ended), "the client withdraws the call"
        peer.end.end(1)
        peer.flush()
        assert connection.is_open

    virtual(main)


def test_an_unanswered_stop_is_not_withdrawn() -> None:
    async def main() -> None:
        peer = Peer()
        connection = await opened(peer)
        call = connection.ask("/a.B/Stop", b"")
        assert await connection.answer(call, 0.3) is None
        assert not any(isinstance(event, Ended) for event in peer.events)
        peer.end.send(call.stream, b"late")
        peer.flush()
        assert await connection.answer(call, 0.3) == b"late"

    virtual(main)


def test_several_tasks_wait_on_one_connection() -> None:
    async def main() -> None:
        peer = Peer()
        connection = await opened(peer)
        answers: dict[str, bytes] = {}

        async def ask(name: str) -> None:
            answers[name] = await connection.unary(f"/a.B/{name}", name.encode(), 1.0)

        async with trio.open_nursery() as nursery:
            for name in ("x", "y", "z"):
                nursery.start_soon(ask, name)
            given_up = trio.CancelScope()

            async def give_up() -> None:
                with given_up:
                    await connection.unary("/a.B/never", b"", 9.0)

            nursery.start_soon(give_up)
            await trio.sleep(0.1)
            given_up.cancel()  # the cancelled task may be the one that reads for all
            await trio.sleep(0.1)
            for event in [event for event in peer.events if isinstance(event, MessageReceived)]:
                if event.message:
                    peer.end.send(event.stream, event.message * 2)
                    peer.end.end(event.stream)
            peer.flush()
        assert answers == {"x": b"xx", "y": b"yy", "z": b"zz"}

    virtual(main)


def test_a_failed_call_gives_the_reason() -> None:
    async def main() -> None:
        peer = Peer()
        connection = await opened(peer)
        call = connection.ask("/a.B/Do", b"")
        peer.end.end(call.stream, Status.UNIMPLEMENTED, "no method")
        peer.flush()
        with pytest.raises(CallFailed, match=r"Do: UNIMPLEMENTED \(no method\)") as caught:
            await connection.answer(call, 1.0)
        assert caught.value.status is Status.UNIMPLEMENTED
        assert connection.is_open

    virtual(main)


@pytest.mark.parametrize("how", ["noise", "goodbye", "gone"])
def test_a_lost_connection_ends_every_wait_with_the_reason(how: str) -> None:
    async def main() -> None:
        peer = Peer()
        connection = await opened(peer)

        async def lose() -> None:
            await trio.sleep(0.1)
            if how == "noise":
                peer.say(b"\xff" * 100)
            elif how == "goodbye":
                peer.end._http.close_connection()
                peer.flush()
            else:
                peer.close()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(lose)
            with pytest.raises(WireDown, match=r"192\.0\.2\.1:50051"):
                await connection.unary("/a.B/Do", b"", 5.0)
        assert trio.current_time() < 1.0
        assert not connection.is_open
        with pytest.raises(WireDown, match="the connection is closed"):
            connection.ask("/a.B/Do", b"")
        connection.close()

    virtual(main)


def test_a_goodbye_is_an_event() -> None:
    pair = Pair()
    pair.server._http.close_connection()
    pair.join()
    assert pair.said == [PeerLeft("it said goodbye")]
