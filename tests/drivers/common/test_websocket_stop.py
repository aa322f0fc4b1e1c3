"""Test that a stop is sent at once on a WebSocket, whatever data the service sends, and that no other task is
delayed. The tests run in virtual time, on streams in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable

import pytest
import trio
from wsproto.frame_protocol import FrameProtocol, Opcode

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs import websocket_messages as messages
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.codecs.websocket_messages import ClientEnd, Opened, Received, ServerEnd
from strands_actors.drivers.common.ports.tcp_port import READ_SIZE
from strands_actors.drivers.common.ports.websocket import WebSocket, begin_websocket, open_websocket
from strands_actors.testing import run_virtual

STOP = ('{"stop":1}', '{"stop":2}')
WITHIN_S = 0.4


class Service:
    """The other end. ``answers`` is True if it answers an upgrade. The test supplies all other messages."""

    def __init__(self, answers: bool = True) -> None:
        self.answers = answers
        self.streams: list[Stream] = []

    async def open_stream(self, host: str, port: int) -> Stream:
        await trio.lowlevel.checkpoint()
        self.streams.append(Stream(self))
        return self.streams[-1]

    def begin(self, *stop: str) -> Awaitable[WebSocket]:
        return begin_websocket("h", 1, "/ws", within_s=WITHIN_S, stop=stop, open_stream=self.open_stream)

    def open(self) -> Awaitable[WebSocket]:
        return open_websocket("h", 1, "/ws", within_s=WITHIN_S, open_stream=self.open_stream)


class Stream:
    """``heard`` has the received messages with their times. ``writes`` counts the writes."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._end = ServerEnd()
        self._coming: deque[bytes] = deque()
        self._news = trio.Event()
        self._lost = False
        self.heard: list[tuple[float, str]] = []
        self.writes = self.reads = 0
        self.ended = ""
        self.accepted = b""

    def write(self, data: bytes) -> None:
        if self._lost:
            raise WireDown("reset by the peer")
        self.writes += 1
        self._take(list(self._end.feed(data)))

    def _take(self, heard: list[Received]) -> None:
        for one in heard:
            if isinstance(one, Opened):
                self.accepted = self._end.accept()
                if self._service.answers:
                    self.say(self.accepted)
                self._take(list(self._end.feed(b"")))
            elif isinstance(one, str):
                self.heard.append((trio.current_time(), one))

    def say(self, data: bytes, piece: int = READ_SIZE) -> None:
        self._coming.extend(data[at : at + piece] for at in range(0, len(data), piece))
        self._news.set()

    def lose(self) -> None:
        self._lost = True
        self._news.set()

    async def read(self) -> bytes:
        await trio.lowlevel.checkpoint()
        while not self._coming:
            if self._lost:
                raise WireDown("reset by the peer")
            self._news = trio.Event()
            await self._news.wait()
        self.reads += 1
        return self._coming.popleft()

    def close(self) -> None:
        self.ended = self.ended or "reset"

    def close_in_order(self) -> None:
        self.ended = self.ended or "in order"


def upgrade() -> bytes:
    """Return an answer to an upgrade that was not requested, so its key is wrong."""
    end = ServerEnd()
    list(end.feed(ClientEnd("h", "/ws").request))
    return end.accept()


ANSWERS = {
    "nothing": b"",
    "half an answer": upgrade()[:40],
    "the answer to another upgrade": upgrade(),
    "garbage": b"\x00\xff\r\n\r\n" * 20,
    "an endless head": b"x" * 100_000,
    "404": b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n",
    "a redirect": b"HTTP/1.1 302 Found\r\nLocation: /\r\nContent-Length: 0\r\n\r\n",
    "interim answers": b"HTTP/1.1 100 Continue\r\n\r\n" * 2000,
}


@pytest.mark.parametrize("said", ANSWERS.values(), ids=ANSWERS.keys())
def test_saf_022_a_stop_is_sent_with_the_upgrade_and_again_with_any_answer(said: bytes) -> None:
    service = Service(answers=False)

    async def run() -> None:
        began_s = trio.current_time()
        socket = await service.begin(*STOP)
        (stream,) = service.streams
        assert stream.heard == [(began_s, message) for message in STOP] and stream.writes == 1
        stream.say(said)
        accepted = False
        try:
            accepted = await socket.accepted(0.01)
        except WireDown as down:
            assert "no WebSocket there" in str(down)
        assert not accepted and not socket.is_open
        again_s = trio.current_time()
        socket.send_stop(*STOP)
        assert stream.heard[2:] == [(again_s, message) for message in STOP]
        with pytest.raises(WireDown):
            socket.send("no stop")
        socket.close()
        assert stream.ended == "in order", "the stop arrives all the same"

    run_virtual(run)


@pytest.mark.parametrize("at", range(0, len(upgrade()) + 1, 7))
def test_saf_022_a_stop_has_left_before_a_reset_at_any_byte_of_the_handshake(at: int) -> None:
    service = Service(answers=False)

    async def run() -> None:
        socket = await service.begin(*STOP)
        (stream,) = service.streams
        assert [message for _, message in stream.heard] == list(STOP)
        stream.say(stream.accepted[:at], 1)
        stream.lose()
        with pytest.raises(WireDown, match="reset by the peer"):
            await socket.accepted(1.0)
            await socket.receive()
        assert not socket.is_open and stream.ended == "reset"
        with pytest.raises(WireDown, match="closed"):
            socket.send_stop(*STOP)

    run_virtual(run)


def frame(opcode: Opcode, payload: bytes = b"", fin: bool = True) -> bytes:
    """Return a short frame of the service."""
    return bytes([opcode | (0x80 if fin else 0), len(payload)]) + payload


SPOKEN = {
    "garbage": b"\xff" * 50,
    "a frame with a mask": b"\x81\x80\0\0\0\0",
    "a compressed frame": b"\xc1\x02ab",
    "a text that is none": frame(Opcode.TEXT, b"\xff"),
    "a close": frame(Opcode.CLOSE, b"\x03\xe8"),
    "a message that is too long": b"\x82\x7f" + (2 << 20).to_bytes(8, "big") + bytes(2 << 20),
    "a message without end": frame(Opcode.BINARY, b"", False) + frame(Opcode.CONTINUATION, b"", False) * 4000,
    "pings": frame(Opcode.PING) * 400_000,
    "pongs": frame(Opcode.PONG) * 400_000,
    "empty messages": frame(Opcode.TEXT) * 400_000,
}


@pytest.mark.parametrize("said", SPOKEN.values(), ids=SPOKEN.keys())
def test_saf_022_a_stop_leaves_at_once_after_bytes_that_were_not_understood(said: bytes) -> None:
    """This also shows SAF-025: other tasks run, few of the bytes are read, and the output is bounded."""
    service = Service()
    turns = 0

    async def others() -> None:
        nonlocal turns
        while True:
            await trio.lowlevel.checkpoint()
            turns += 1

    async def run() -> None:
        socket = await service.open()
        (stream,) = service.streams
        stream.say(said)
        writes = stream.writes
        async with trio.open_nursery() as nursery:
            nursery.start_soon(others)
            with pytest.raises(WireDown):
                while True:
                    await socket.receive()
            nursery.cancel_scope.cancel()
        assert turns + 3 >= stream.reads and stream.reads <= messages.MAX_MESSAGE / READ_SIZE + 2
        assert stream.writes - writes <= turns, "at most one pong is sent in each turn"
        began_s = trio.current_time()
        socket.send_stop(*STOP)
        assert stream.heard == [(began_s, message) for message in STOP]
        socket.close()
        assert stream.ended == "in order"

    run_virtual(run)


def test_saf_025_one_turn_takes_in_no_more_than_its_frames() -> None:
    client, server = ClientEnd("h", "/ws"), ServerEnd()
    list(server.feed(client.request))
    list(client.feed(server.accept()))
    heard = list(client.feed(frame(Opcode.TEXT, b"x") * 100))
    assert len(heard) == messages.FRAMES and client.has_unread
    while client.has_unread:
        heard += client.feed(b"")
    assert heard == ["x"] * 100


def test_saf_025_of_many_pings_the_newest_is_answered() -> None:
    client, server = ClientEnd("h", "/ws"), ServerEnd()
    list(server.feed(client.request))
    list(client.feed(server.accept()))
    list(client.feed(frame(Opcode.PING, b"old") + frame(Opcode.PING, b"new")))
    (pong,) = server.feed(client.replies())
    assert pong == (b"new",)


def test_frames_before_the_answer_count_at_one_server_and_are_dropped_by_another() -> None:
    """Of tornado and uvicorn, one keeps them and the other drops them."""
    for keeps, taken in ((True, list(STOP)), (False, [])):
        client, server = ClientEnd("h", "/ws"), ServerEnd(keeps_early=keeps)
        assert isinstance(next(server.feed(client.request + client.stop(STOP))), Opened)
        assert list(client.feed(server.accept())) == [messages.Accepted()]
        assert list(server.feed(b"")) == taken
        assert list(server.feed(client.message("later"))) == ["later"]


def test_more_than_a_bound_before_the_answer_is_refused() -> None:
    client, server = ClientEnd("h", "/ws"), ServerEnd()
    list(server.feed(client.request))
    with pytest.raises(MalformedFrame, match="before the answer"):
        for _ in range(100):
            list(server.feed(bytes(1000)))


def test_the_frames_of_a_stop_are_those_of_any_message() -> None:
    """A new mask is drawn for each."""
    client, server = ClientEnd("h", "/ws"), FrameProtocol(client=False, extensions=[])
    server.receive_bytes(client.stop(STOP))
    assert [(one.opcode, one.payload, one.message_finished) for one in server.received_frames()] == [
        (Opcode.TEXT, message, True) for message in STOP
    ]
