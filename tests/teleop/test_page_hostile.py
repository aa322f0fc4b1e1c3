"""No client can end the operator's page or lock out its operator, by any message or by silence."""

from __future__ import annotations

import json
import logging
import socket
import struct
from collections.abc import Callable

import pytest
import trio

from .test_page_alone import Served, served

STRANGERS = 64
HELD = {"held": True, "at_ms": 51.0}
TEXT, CLOSE, PING = 1, 8, 9


def frame(data: bytes | str, kind: int = TEXT, first: int = 0x80) -> bytes:
    """Return one masked WebSocket frame. ``first`` is its first byte without the kind."""
    body = data.encode() if isinstance(data, str) else data
    length = bytes([0x80 | len(body)]) if len(body) < 126 else bytes([0xFE]) + struct.pack(">H", len(body))
    mask = b"\1\2\3\4"
    return bytes([first | kind]) + length + mask + bytes(byte ^ mask[at % 4] for at, byte in enumerate(body))


MALICE = {
    "nested": frame('{"held":true,"at_ms":2,"x":' + "[" * 3900),
    "a surrogate": frame('{"held":true,"at_ms":2,"rates":{"\\ud800":1}}'),
    "no UTF-8": frame(b"\xff\xfe"),
    "a number too large": frame('{"held":true,"at_ms":2,"rates":{"a":1e999}}'),
    "not a number": frame('{"held":true,"at_ms":NaN}'),
    "an odd close": frame(b"\x00\x01junk", CLOSE),
    "reserved bits": frame("x", first=0xF0),
    "many pings": frame(b"x" * 125, PING) * 500,
    "a frame that never ends": frame("{", first=0) + frame("{", first=0, kind=0) * 10,
    "half a frame": frame(json.dumps(HELD))[:9],
    "no WebSocket": b"\x00" * 5000,
}


async def heard(test: Callable[[], bool]) -> None:
    while True:
        if test():
            return
        await trio.sleep(0.01)


async def begin(page: Served) -> trio.SocketStream:
    """Return an operator's connection that holds the dead-man."""
    stream, answer = await page.sit_down()
    assert " 101 " in answer, answer
    await stream.send_all(frame(json.dumps({"held": False, "at_ms": 1.0})))
    await stream.send_all(frame(json.dumps(HELD)))
    await heard(lambda: bool(page.told) and page.told[-1].held)
    return stream


async def lets_go(page: Served) -> None:
    """Wait until the dead-man is released and the seat is free."""
    await heard(lambda: not page.told[-1].held)
    await (await begin(page)).aclose()


@pytest.mark.parametrize("malice", MALICE)
def test_a_client_ends_its_own_connection_alone(malice: str, caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
        async with served() as page:
            stream = await begin(page)
            await stream.send_all(MALICE[malice])
            if malice in ("many pings", "half a frame", "a frame that never ends"):
                await stream.aclose()
            await lets_go(page)

    with caplog.at_level(logging.ERROR):
        trio.run(test)
    assert not caplog.records, caplog.text


async def stopped(page: Served) -> None:
    await heard(lambda: page.stops > 0)


STOP = json.dumps({**HELD, "at_ms": 52.0, "stop": True})
MANY = b"".join(frame(json.dumps({**HELD, "at_ms": 51.0 + at, "rates": {"a": 0.5}})) for at in range(200))


@pytest.mark.parametrize(
    "pieces",
    [
        (frame(STOP)[:20], frame(STOP)[20:]),
        tuple(frame(STOP)[at : at + 1] for at in range(len(frame(STOP)))),
        (frame(STOP[:9], first=0) + frame(STOP[9:], kind=0),),
        (MANY + frame(STOP),),
        (frame('{"held": null, "stop": true}'),),
        (frame('{"stop": true'),),
        (frame("STOP"),),
    ],
    ids=["two reads", "bytes", "fragments", "after a jam", "no more than a stop", "cut off", "a word"],
)
def test_saf_002_a_stop_in_any_number_of_pieces_is_read(pieces: tuple[bytes, ...]) -> None:
    async def test() -> None:
        async with served() as page:
            stream = await begin(page)
            for piece in pieces:
                await stream.send_all(piece)
                await trio.sleep(0.005)
            await stopped(page)

    trio.run(test)


def test_a_message_that_a_network_cuts_lets_go_of_nothing() -> None:
    async def test() -> None:
        async with served() as page:
            stream = await begin(page)
            for at, byte in enumerate(frame(json.dumps(HELD))):
                await stream.send_all(bytes([byte]))
                await trio.sleep(0.002 * (at % 2))
            await stream.send_all(MANY)
            await heard(lambda: len(page.told) == 203)
            assert page.told[-1].held
            assert not page.stops

    trio.run(test)


def test_a_failed_stop_is_reported_on_the_page() -> None:
    async def fail() -> str:
        raise RuntimeError("no root")

    async def test() -> None:
        async with served(stop=fail) as page:
            stream = await begin(page)
            for count in (1, 2):
                shown = b""
                await stream.send_all(frame(STOP))
                await heard(lambda count=count: page.stops == count)  # type: ignore[misc]
                while b"NOT CONFIRMED: RuntimeError('no root')" not in shown:
                    shown += await stream.receive_some(4096)

    trio.run(test)


def test_a_reset_ends_its_own_connection_alone() -> None:
    async def test() -> None:
        async with served() as page:
            stream = await begin(page)
            page.streams.remove(stream)
            stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            stream.socket.close()
            await lets_go(page)

    trio.run(test)


def test_idle_strangers_do_not_keep_the_operator_out() -> None:
    async def test() -> None:
        async with served() as page:
            port = int(page.host.rpartition(":")[2])
            for _ in range(STRANGERS):
                page.streams.append(await trio.open_tcp_stream("127.0.0.1", port))
            await begin(page)

    trio.run(test)


def test_strangers_do_not_take_the_operators_seat() -> None:
    async def test() -> None:
        async with served() as page:
            stream = await begin(page)
            port = int(page.host.rpartition(":")[2])
            for _ in range(STRANGERS):
                page.streams.append(await trio.open_tcp_stream("127.0.0.1", port))
            count = len(page.told)
            await stream.send_all(frame(json.dumps({**HELD, "at_ms": 60.0})))
            await heard(lambda: len(page.told) > count)
            assert page.told[-1].held

    trio.run(test)
