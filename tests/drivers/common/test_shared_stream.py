"""Test one connection that several tasks read."""

from __future__ import annotations

import pytest
import trio
import trio.testing

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.shared_stream import SharedStream


class Line:
    """A connection on which one task may wait at a time, as on a socket."""

    def __init__(self) -> None:
        self._send, self._receive = trio.open_memory_channel[bytes](10)
        self._reading = False

    def say(self, data: bytes) -> None:
        self._send.send_nowait(data)

    def write(self, data: bytes) -> None:
        raise WireDown("blocked")

    async def read(self) -> bytes:
        assert not self._reading, "two tasks read one connection"
        self._reading = True
        try:
            return await self._receive.receive()
        finally:
            self._reading = False

    def close(self) -> None: ...

    def close_in_order(self) -> None: ...


def test_the_first_task_reads_for_all() -> None:
    async def main() -> None:
        shared, line, received = SharedStream(lambda: None), Line(), list[bytes]()
        shared.replace(line)

        async def listen() -> None:
            received.append(await shared.read())

        async with trio.open_nursery() as nursery:
            for _ in range(3):
                nursery.start_soon(listen)
            await trio.testing.wait_all_tasks_blocked()
            line.say(b"news")
        assert sorted(received) == [b"", b"", b"news"]

    trio.run(main)


def test_a_late_reader_of_an_old_connection_does_not_disturb_the_new_one() -> None:
    """Before this reader wakes, its connection has been replaced, and the new one has a reader."""

    async def main() -> None:
        shared, first, second, received = SharedStream(lambda: None), Line(), Line(), list[bytes]()
        shared.replace(first)

        async def listen() -> None:
            received.append(await shared.read())

        async with trio.open_nursery() as nursery:
            nursery.start_soon(listen)
            await trio.testing.wait_all_tasks_blocked()
            shared.replace(second)
            async with trio.open_nursery() as others:
                others.start_soon(listen)
                others.start_soon(listen)
                await trio.testing.wait_all_tasks_blocked()
                others.start_soon(listen)
                await trio.testing.wait_all_tasks_blocked()
                second.say(b"news")
        assert received.count(b"news") == 1

    trio.run(main)


def test_a_failed_write_closes_the_connection_and_is_reported() -> None:
    async def main() -> None:
        closed: list[bool] = []
        shared = SharedStream(lambda: closed.append(True))
        shared.replace(Line())
        closed.clear()
        for _ in range(2):
            with pytest.raises(WireDown):
                shared.write(b"stop")
        assert closed == [True] and shared.connection is None

    trio.run(main)
