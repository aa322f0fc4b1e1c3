"""Test a JSON-RPC client: answers by number, deadlines, and broken connections."""

from __future__ import annotations

import json
from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.common.ports.json_rpc_port import JsonRpcPort, RequestFailed
from strands_actors.drivers.common.ports.tcp_port import OrderlyStream


class Peer:
    """A stream of bytes with the test at its other end."""

    def __init__(self) -> None:
        self.written: list[dict[str, Any]] = []
        self._send, self._receive = trio.open_memory_channel[bytes](100)
        self.closed = self.closed_in_order = False
        self.blocked = False

    def write(self, data: bytes) -> None:
        if self.blocked:
            raise WireDown("output is blocked")
        self.written.append(json.loads(data))

    async def read(self) -> bytes:
        data = await self._receive.receive()
        if not data:
            raise WireDown("the robot closed it")
        return data

    def close(self) -> None:
        self.closed = True

    def close_in_order(self) -> None:
        self.closed_in_order = True

    def say(self, **message: Any) -> None:
        self._send.send_nowait(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")

    def say_bytes(self, data: bytes) -> None:
        self._send.send_nowait(data)


async def connected(notices: list[Call] | None = None) -> tuple[JsonRpcPort, Peer]:
    peer = Peer()

    async def open_stream() -> OrderlyStream:
        return peer

    port = JsonRpcPort(open_stream, (notices if notices is not None else []).append)
    await port.open()
    return port, peer


def test_answers_are_matched_by_their_numbers_and_notices_are_passed_on() -> None:
    async def main() -> None:
        notices: list[Call] = []
        port, peer = await connected(notices)
        first, second = port.send("a", {}), port.send("b", {"x": 1})
        port.notify("c", {})
        assert [one.get("id") for one in peer.written] == [first, second, None]
        peer.say(method="tick", params={"n": 1})
        peer.say(id=second, result="two")
        peer.say(id=first, error={"code": -32601, "message": "unknown"})
        assert await port.answer(second, 1.0) == "two"
        with pytest.raises(RequestFailed, match="unknown") as no:
            await port.answer(first, 1.0)
        assert no.value.code == -32601
        assert [one.method for one in notices] == ["tick"]

    trio.run(main)


def test_a_late_answer_is_dropped() -> None:
    async def main() -> None:
        port, peer = await connected()
        number = port.send("a", {})
        with pytest.raises(WireDown, match="no answer within 20 ms"):
            await port.answer(number, 0.02)
        assert port.is_open, "the connection stays open"
        peer.say(id=number, result="late")
        assert await _asked(port, peer, "b") == "b"

    trio.run(main)


def test_an_answer_without_a_caller_is_not_kept() -> None:
    async def main() -> None:
        port, peer = await connected()
        for _ in range(3):
            forgotten = port.send("a", {})
            port.forget(forgotten)
            peer.say(id=forgotten, result="late")
        assert await _asked(port, peer, "b") == "b"
        assert port._exchange.unanswered == 0 and port._exchange.pop(forgotten) is None

    trio.run(main)


def test_a_new_connection_does_not_answer_the_requests_of_the_old() -> None:
    async def main() -> None:
        port, peer = await connected()
        number = port.send("a", {})
        await port.open()
        peer.say(id=number, result="of the old connection")
        with pytest.raises(WireDown, match="lost before the answer"):
            await port.answer(number, 1.0)

    trio.run(main)


async def _asked(port: JsonRpcPort, peer: Peer, name: str) -> Any:
    number = port.send(name, {})
    peer.say(id=number, result=name)
    return await port.answer(number, 1.0)


def test_an_invalid_line_is_counted_and_the_next_line_is_read() -> None:
    async def main() -> None:
        port, peer = await connected()
        peer.say_bytes(b"\x93\xff nonsense\n{}\n")
        peer.say(id=999, result="of nobody")
        peer.say(id="text", result="of nobody")
        assert await _asked(port, peer, "a") == "a"
        assert port.malformed == 2

    trio.run(main)


def test_two_wait_and_one_reads_for_both() -> None:
    async def main() -> None:
        port, peer = await connected()
        numbers = [port.send("a", {}), port.send("b", {})]
        got: list[Any] = []

        async def wait(number: int) -> None:
            got.append(await port.answer(number, 1.0))

        async with trio.open_nursery() as nursery:
            for number in numbers:
                nursery.start_soon(wait, number)
            await trio.testing.wait_all_tasks_blocked()
            peer.say(id=numbers[1], result=1)
            peer.say(id=numbers[0], result=0)
        assert sorted(got) == [0, 1]

    trio.run(main)


def test_the_end_of_a_connection_ends_every_wait_with_an_error() -> None:
    async def main() -> None:
        port, peer = await connected()
        number = port.send("a", {})
        peer.say_bytes(b"")
        with pytest.raises(WireDown, match="closed it"):
            await port.answer(number, 1.0)
        assert not port.is_open and peer.closed
        with pytest.raises(WireDown, match="not connected"):
            port.notify("b", {})
        with pytest.raises(WireDown, match="not connected"):
            await port.hear()

    trio.run(main)


def test_a_close_ends_every_wait_with_an_error() -> None:
    async def main() -> None:
        port, _ = await connected()
        number = port.send("a", {})
        async with trio.open_nursery() as nursery:
            nursery.start_soon(_close_soon, port)
            with trio.fail_after(1.0), pytest.raises(WireDown, match=r"not connected|lost"):
                await port.answer(number, 10.0)

    trio.run(main)


async def _close_soon(port: JsonRpcPort) -> None:
    await trio.testing.wait_all_tasks_blocked()
    port.close()


def test_a_partial_write_ends_the_connection() -> None:
    async def main() -> None:
        port, peer = await connected()
        peer.blocked = True
        with pytest.raises(WireDown, match="blocked"):
            port.send("a", {})
        assert not port.is_open and peer.closed

    trio.run(main)


def test_a_line_without_an_end_is_not_kept_for_ever() -> None:
    async def main() -> None:
        port, peer = await connected()
        number = port.send("a", {})
        for _ in range(20):
            peer.say_bytes(b"x" * 100_000)
        with pytest.raises(WireDown, match="a line of more than"):
            await port.answer(number, 1.0)
        assert not port.is_open
        with pytest.raises(WireDown, match="could not be decoded"):
            port.notify("b", {})
        with pytest.raises(WireDown, match="not connected"):
            await port.hear()

    trio.run(main)


def test_saf_022_a_stop_is_written_on_a_connection_that_is_not_understood() -> None:
    """The connection is kept for the stop. It is closed in order, so that the stop arrives."""

    async def main() -> None:
        port, peer = await connected()
        peer.say_bytes(b"x" * 2_000_000)
        with pytest.raises(WireDown, match="a line of more than"):
            await port.hear()
        assert port.takes_stops and not peer.closed
        port.send_stop("stop", {})
        port.notify_stop("rest", {})
        assert [one["method"] for one in peer.written] == ["stop", "rest"]
        port.close()
        assert peer.closed_in_order and not peer.closed
        with pytest.raises(WireDown, match="not connected"):
            port.send_stop("stop", {})

    trio.run(main)


def test_saf_021_a_reset_drops_what_waits_on_a_connection_that_is_not_understood() -> None:
    async def main() -> None:
        port, peer = await connected()
        port.notify("move", {})
        peer.say_bytes(b"x" * 2_000_000)
        with pytest.raises(WireDown, match="a line of more than"):
            await port.hear()
        port.reset()
        assert peer.closed and not peer.closed_in_order
        assert not port.takes_stops

    trio.run(main)
