"""When the HTTP client asks the permit: before anything leaves, and before a body does."""

from __future__ import annotations

import contextlib
from functools import partial

import pytest
import trio

from strands_actors.contract.wire import PermitDenied
from strands_actors.drivers.common.http_client import HttpClient


class Once:
    """A permit that holds for the first look alone: a stop comes right after it."""

    def __init__(self) -> None:
        self.looks = 0

    def check(self) -> None:
        self.looks += 1
        if self.looks > 1:
            raise PermitDenied("a stop is waiting")


@pytest.mark.parametrize("body", [b"", b'{"x": 1}'])
def test_saf_010_a_request_that_has_left_whole_is_not_told_as_denied(body: bytes) -> None:
    """One without a body has left with its head: the service carries it out."""
    heard: list[bytes] = []

    async def serve(stream: trio.SocketStream) -> None:
        with contextlib.suppress(trio.BrokenResourceError):
            heard.append(bytes(await stream.receive_some()))
            await stream.send_all(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")
            while data := await stream.receive_some():
                heard.append(bytes(data))

    async def run() -> None:
        async with trio.open_nursery() as nursery:
            serving = partial(trio.serve_tcp, serve, 0, host="127.0.0.1")
            (listener,) = await nursery.start(serving)
            client = HttpClient(f"http://127.0.0.1:{listener.socket.getsockname()[1]}")
            if body:
                with pytest.raises(PermitDenied):
                    await client.post("/move", body, 2.0, Once())
            else:
                assert (await client.post("/move", body, 2.0, Once())).status_code == 200
            await client.aclose()
            nursery.cancel_scope.cancel()

    trio.run(run)
    assert body not in b"".join(heard) if body else heard
