"""The socket for orders to a running twin: no client ends or blocks it."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from strands_actors.drivers.common.twin import orders
from strands_actors.drivers.common.twin.orders import LONGEST, send_order, serve_orders


@asynccontextmanager
async def served(path: Path) -> AsyncIterator[list[str]]:
    """Serve orders, and give the list of the lines that were carried out."""
    done: list[str] = []

    def obey(line: str) -> None:
        if line == "dance":
            raise ValueError("unknown control line.\nUse unplug")
        done.append(line)

    async with trio.open_nursery() as nursery:
        await nursery.start(serve_orders, str(path), obey)
        yield done
        nursery.cancel_scope.cancel()


async def order(path: Path, line: str) -> str:
    return await trio.to_thread.run_sync(send_order, str(path), line)


def test_an_order_is_carried_out_before_it_is_answered_and_an_unknown_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "orders"

    async def run() -> None:
        async with served(path) as done:
            assert await order(path, "fault off:3") == ""
            assert done == ["fault off:3"]
            assert await order(path, "dance") == "unknown control line. Use unplug"
            assert await order(path, "plug") == ""
        assert done == ["fault off:3", "plug"]
        assert not path.exists()

    trio.run(run)


def test_the_socket_of_a_killed_twin_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "orders"
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(path))
    left.close()
    with pytest.raises(ConnectionRefusedError):
        send_order(str(path), "plug")

    async def run() -> None:
        async with served(path) as done:
            assert await order(path, "plug") == ""
        assert done == ["plug"]

    trio.run(run)


def test_clients_that_are_silent_or_rude_neither_end_nor_block_the_twin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "WITHIN_S", 1.0)
    path = tmp_path / "orders"

    async def run() -> None:
        async with served(path) as done:
            silent = await trio.open_unix_socket(str(path))
            await silent.send_all(b"unpl")
            rude = await trio.open_unix_socket(str(path))
            await rude.send_all(b"\xff\x00" * LONGEST)
            gone = await trio.open_unix_socket(str(path))
            await gone.send_all(b"plug\n")
            await gone.aclose()
            cut = await trio.open_unix_socket(str(path))
            await cut.send_all(b"fault off:1")
            await cut.aclose()
            assert await order(path, "power-cycle") == ""
            with trio.fail_after(10.0):
                assert await silent.receive_some(10) == b"", "it is closed after its time"
            await silent.aclose()
            await rude.aclose()
            assert await order(path, "unplug") == ""
            assert sorted(done) == ["plug", "power-cycle", "unplug"], "only whole lines are orders"

    trio.run(run)
