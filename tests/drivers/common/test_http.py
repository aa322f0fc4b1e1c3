"""Test HTTP: messages as bytes, and the client's port. Limits on a service are counted in parts of messages and
bytes, in virtual time."""

from __future__ import annotations

import contextlib
import gzip
import random
from collections import deque
from collections.abc import Awaitable, Callable, Iterable

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.codecs import http_messages as http
from strands_actors.drivers.common.codecs.http_messages import ClientEnd, ServerEnd, encode_response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.ports.tcp_port import READ_SIZE
from strands_actors.testing import run_virtual
from tests.drivers.disturbed import DISTURBED

RESPONSE = encode_response(200, b'{"a":1}')
CHUNKED_HEAD = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
CHUNKED = CHUNKED_HEAD + b"3\r\nabc\r\n4;x=y\r\ndefg\r\n0\r\n\r\n"
REQUEST = ClientEnd("192.0.2.1:8000").request("POST", "/control", b'{"command":{}}')


def asked(times: int = 1, **options: int) -> ClientEnd:
    """Return a client's end that waits for this number of answers."""
    end = ClientEnd("h", **options)
    for _ in range(times):
        end.request("GET", "/x")
    return end


def feed(end: ClientEnd, data: bytes) -> list[http.Response]:
    """Feed it in as many turns as needed."""
    found = end.feed(data)
    while end.has_unread:
        found += end.feed(b"")
    return found


# -- bytes


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_messages_are_whole_however_they_are_cut(size: int) -> None:
    stream = RESPONSE + CHUNKED + b"HTTP/1.1 204 No Content\r\n\r\n" + RESPONSE
    client = asked(4)
    heard = [one for at in range(0, len(stream), size) for one in feed(client, stream[at : at + size])]
    assert [(one.status, one.body) for one in heard] == [
        (200, b'{"a":1}'), (200, b"abcdefg"), (204, b""), (200, b'{"a":1}'),
    ]  # fmt: skip
    server = ServerEnd()
    both = REQUEST + ClientEnd("h").request("GET", "/data")
    requests = [one for at in range(0, len(both), size) for one in server.feed(both[at : at + size])]
    assert [(one.method, one.target, one.body) for one in requests] == [
        ("POST", "/control", b'{"command":{}}'), ("GET", "/data", b""),
    ]  # fmt: skip
    assert b"".join(one.raw for one in requests) == both
    assert requests[0].headers["accept-encoding"] == "identity"


REFUSED = {
    "content-length '-1'": b"HTTP/1.1 200 OK\r\nContent-Length: -1",
    "two lengths": b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2",
    "a length beyond the bound": b"HTTP/1.1 200 OK\r\nContent-Length: 1048577",
    "an endless length": b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999999999999999",
    "a length and chunks": b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\nTransfer-Encoding: chunked",
    "another transfer": b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip",
    "no length": b"HTTP/1.1 200 OK",
    "HTTP/2": b"HTTP/2 200 OK\r\nContent-Length: 0",
    "no status": b"HTTP/1.1 2x0 OK\r\nContent-Length: 0",
    "no colon": b"HTTP/1.1 200 OK\r\nNo colon",
    "no words": b"\xff\xff",
    "a redirect": b"HTTP/1.1 302 Found\r\nLocation: http://192.0.2.9/\r\nContent-Length: 0",
    "an upgrade": b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: upgrade",
    "gzip": b"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\nContent-Length: 20",
    "zstd": b"HTTP/1.1 200 OK\r\nContent-Encoding: zstd\r\nContent-Length: 20",
}


@pytest.mark.parametrize("head", REFUSED.values(), ids=REFUSED.keys())
def test_saf_025_an_ambiguous_or_unrequested_answer_is_refused(head: bytes) -> None:
    client = asked()
    with pytest.raises(MalformedFrame):
        feed(client, head + b"\r\n\r\n")
    with pytest.raises(MalformedFrame, match="after the end"):
        client.feed(RESPONSE)


def test_saf_025_an_answer_to_no_request_is_refused() -> None:
    client = asked()
    assert len(feed(client, RESPONSE)) == 1
    with pytest.raises(MalformedFrame, match="to no request"):
        feed(client, RESPONSE[:1])


ENDLESS: dict[str, tuple[bytes, bytes]] = {
    "no head": (b"", b"x"),
    "headers": (b"HTTP/1.1 200 OK\r\n", b"X: y\r\n"),
    "interim answers": (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    "chunks": (CHUNKED_HEAD, b"1\r\nx\r\n"),
    "heads of chunks": (CHUNKED_HEAD, b"1;" + b"a" * 1000 + b"\r\nx\r\n"),
    "one chunk": (CHUNKED_HEAD + b"fffffff\r\n", b"x" * 1000),
    "trailers": (CHUNKED_HEAD + b"0\r\n", b"X: y\r\n"),
    "no size": (CHUNKED_HEAD, b"0"),
}


@pytest.mark.parametrize(("begins", "goes_on"), ENDLESS.values(), ids=ENDLESS.keys())
def test_saf_025_an_answer_that_never_ends_costs_bounded_work_and_bytes(begins: bytes, goes_on: bytes) -> None:
    """Each turn processes at most ``EVENTS`` parts, and each part once."""
    client = asked()
    data = goes_on * (READ_SIZE // len(goes_on) + 1)
    feed(client, begins)
    turns = fed = 0
    with pytest.raises(MalformedFrame):
        while True:
            client.feed(data)
            turns, fed = turns + 1, fed + len(data)
            while client.has_unread:
                client.feed(b"")
                turns += 1
    assert fed <= http.MAX_HEAD + 2 * http.MAX_BODY + 2 * READ_SIZE
    assert turns <= 2 * http.MAX_CHUNKS / http.EVENTS + fed / READ_SIZE + 2


def test_saf_025_one_turn_takes_in_no_more_than_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The count is taken where h11 parses. Without the limit 682 chunks came in one read."""
    parsed = 0
    next_event = http.h11.Connection.next_event

    def count(connection: http.h11.Connection) -> object:
        nonlocal parsed
        parsed += 1
        return next_event(connection)

    monkeypatch.setattr(http.h11.Connection, "next_event", count)
    client = asked()
    feed(client, CHUNKED_HEAD)
    parsed = 0
    client.feed(b"1\r\nx\r\n" * 682)
    assert parsed == http.EVENTS and client.has_unread
    while client.has_unread:
        client.feed(b"")
    assert 682 <= parsed <= 682 + 2, "no part is parsed twice"
    (answer,) = feed(client, b"0\r\n\r\n")
    assert answer.body == b"x" * 682


def test_disturbed_messages_raise_only_the_codecs_error() -> None:
    """Fewer messages than for our own codecs: the authors of h11 test it with far more, and it is slow."""
    chance = random.Random(2)
    for _ in range(DISTURBED // 16):
        with contextlib.suppress(MalformedFrame):
            feed(asked(), disturbed(chance, chance.choice([RESPONSE, CHUNKED])))
        with contextlib.suppress(MalformedFrame):
            list(ServerEnd().feed(disturbed(chance, REQUEST)))


def disturbed(chance: random.Random, data: bytes) -> bytes:
    bytes_ = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(bytes_) + 1)
        match chance.randrange(3):
            case 0:
                bytes_[at : at + 1] = bytes([chance.randrange(256)])
            case 1:
                del bytes_[at : at + chance.randint(1, 8)]
            case _:
                bytes_[at:at] = bytes_[: chance.randint(0, 12)]
    return bytes(bytes_) or b"x"


@pytest.mark.parametrize("target", ["/a b", "/a\r\nX: y", "/ü", ""])
def test_a_target_that_would_break_the_request_is_refused(target: str) -> None:
    with pytest.raises(ValueError, match="GET"):
        ClientEnd("h").request("GET", target)


# -- the port


class Service:
    """The service behind the port. ``says`` has the answers to each request, in pieces."""

    def __init__(self, *says: bytes) -> None:
        self.says = says
        self.streams: list[Stream] = []

    async def open_stream(self, host: str, port: int) -> Stream:
        await trio.lowlevel.checkpoint()
        self.streams.append(Stream(self))
        return self.streams[-1]

    @property
    def heard(self) -> list[tuple[float, str]]:
        """Return the time and the target of each request."""
        return [one for stream in self.streams for one in stream.heard]

    def port(self, **options: int) -> HttpPort:
        return HttpPort("192.0.2.1", 80, self.open_stream, **options)


class Stream:
    def __init__(self, service: Service) -> None:
        self._service = service
        self._end = ServerEnd()
        self._coming: deque[bytes] = deque()
        self._news = trio.Event()
        self.heard: list[tuple[float, str]] = []
        self.reads = 0
        self.ended = ""

    def write(self, data: bytes) -> None:
        for request in self._end.feed(data):
            self.heard.append((trio.current_time(), request.target))
            self.say(self._service.says)

    def say(self, pieces: Iterable[bytes]) -> None:
        self._coming.extend(
            piece[at : at + READ_SIZE] for piece in pieces for at in range(0, len(piece), READ_SIZE)
        )
        self._news.set()

    async def read(self) -> bytes:
        while not self._coming:
            self._news = trio.Event()
            await self._news.wait()
        await trio.lowlevel.checkpoint()
        self.reads += 1
        return self._coming.popleft()

    def close(self) -> None:
        self.ended = self.ended or "reset"

    def close_in_order(self) -> None:
        self.ended = self.ended or "in order"


def asks(service: Service, *expected: str) -> Callable[[], Awaitable[None]]:
    async def run() -> None:
        with pytest.raises(WireDown, match="|".join(expected)):
            await service.port().ask("GET", "/x", within_s=1.0)

    return run


def test_saf_025_endless_chunks_end_an_answer_after_few_reads_and_others_run_meanwhile() -> None:
    service = Service(CHUNKED_HEAD, b"1\r\nx\r\n" * 200_000)
    turns = 0

    async def others() -> None:
        nonlocal turns
        while True:
            await trio.lowlevel.checkpoint()
            turns += 1

    async def run() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(others)
            await asks(service, "more than 2048 chunks")()
            nursery.cancel_scope.cancel()

    run_virtual(run)
    (stream,) = service.streams
    assert stream.reads <= http.MAX_CHUNKS * 6 / READ_SIZE + 2
    assert turns >= http.MAX_CHUNKS / http.EVENTS


def test_saf_025_a_compressed_bomb_is_never_unpacked() -> None:
    packed = gzip.compress(b"\0" * (8 << 20))
    head = f"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\nContent-Length: {len(packed)}\r\n\r\n".encode()
    service = Service(head, packed)
    run_virtual(asks(service, r"compressed \(gzip\)"))
    assert service.streams[0].reads == 1, "only the head is read"


def test_saf_025_a_redirect_is_not_followed() -> None:
    service = Service(b"HTTP/1.1 307 Temporary Redirect\r\nLocation: /y\r\nContent-Length: 0\r\n\r\n")
    run_virtual(asks(service, "redirects to '/y'"))
    assert [target for _, target in service.heard] == ["/x"]


def test_the_client_sets_the_longest_answer() -> None:
    service = Service(encode_response(200, b"x" * 2_000_000))

    async def run() -> None:
        with pytest.raises(WireDown, match="more than 1048576"):
            await service.port().ask("GET", "/x", within_s=1.0)
        assert len((await service.port(max_body=4 << 20).ask("GET", "/x", within_s=1.0)).body) == 2_000_000

    run_virtual(run)


GARBLED = {
    "garbled": b"\x00\xff garbled\r\n\r\n",
    "an answer that was not asked for": RESPONSE + RESPONSE,
    "an endless head": b"x" * 100_000,
    "nothing": b"",
    "half an answer": RESPONSE[:20],
}


@pytest.mark.parametrize("said", GARBLED.values(), ids=GARBLED.keys())
def test_saf_022_a_stop_leaves_at_once_on_a_connection_that_is_not_understood(said: bytes) -> None:
    service = Service()

    async def run() -> None:
        port = service.port()
        async with trio.open_nursery() as nursery:
            await nursery.start(port.serve)
            port.send("POST", "/move")
            service.streams[0].say([said])
            await trio.sleep(0.01)
            began_s = trio.current_time()
            port.send_stop("POST", "/stop")
            assert service.heard[-1] == (began_s, "/stop")
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_022_only_a_stop_is_sent_on_a_connection_with_invalid_answers() -> None:
    service = Service(b"\x00\xff garbled\r\n\r\n")

    async def run() -> None:
        port = service.port()
        with pytest.raises(WireDown, match="Check which service runs there"):
            await port.ask("POST", "/move", within_s=1.0)
        assert not port.is_open and not service.streams[0].ended
        with pytest.raises(WireDown, match="not connected"):
            port.send("POST", "/move")
        port.send_stop("POST", "/stop")
        await port.open()
        assert [stream.ended for stream in service.streams] == ["in order", ""], "the stop arrives all the same"
        assert [target for _, target in service.heard] == ["/move", "/stop"]
        port.close()
        assert service.streams[1].ended == "reset"
        with pytest.raises(WireDown, match="not connected"):
            port.send_stop("POST", "/stop")

    run_virtual(run)


def test_saf_002_a_request_leaves_whole_with_its_permit_or_not_at_all() -> None:
    class Permits:
        left = 1

        def check(self) -> None:
            self.left -= 1
            if self.left < 0:
                raise PermitDenied("a stop is waiting")

    service = Service(RESPONSE)

    async def run() -> None:
        port, permit = service.port(), Permits()
        answer = await port.ask("POST", "/move", b'{"x": 1}', within_s=1.0, permit=permit)
        assert answer.body == b'{"a":1}' and permit.left == 0
        with pytest.raises(PermitDenied):
            await port.ask("POST", "/move", b'{"x": 2}', within_s=1.0, permit=permit)
        assert len(service.heard) == 1

    run_virtual(run)


def test_a_missing_answer_is_reported_with_the_address() -> None:
    async def run() -> None:
        began_s = trio.current_time()
        with pytest.raises(WireDown, match=r"^192\.0\.2\.1:80: no answer within .* ms"):
            await Service().port().ask("GET", "/x", within_s=0.1)
        assert trio.current_time() - began_s == pytest.approx(0.1)

    run_virtual(run)
