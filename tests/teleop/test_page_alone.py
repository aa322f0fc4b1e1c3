"""The operator's page without a robot: which client gets its seat, and under which host names it answers."""

from __future__ import annotations

import base64
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors import Teleoperator
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.page import server
from strands_actors.teleoperation.teleoperator import parse_listen_address

from .page_script import run_on_page


class Served:
    def __init__(self, address: str, told: list[Operate]) -> None:
        self.host, _, self.token = address.removeprefix("http://").partition("/?token=")
        self.told = told
        self.stops = 0
        self.streams: list[trio.SocketStream] = []

    async def ask(self, path: str, host: str, *headers: str) -> tuple[trio.SocketStream, str]:
        """Return a connection and the first line of its answer. ``host`` is the name that a browser uses."""
        stream = await trio.open_tcp_stream("127.0.0.1", int(self.host.rpartition(":")[2]))
        self.streams.append(stream)
        rows = (f"GET {path}?token={self.token} HTTP/1.1", f"Host: {host}", *headers, "", "")
        await stream.send_all("\r\n".join(rows).encode())
        return stream, (await stream.receive_some(300)).partition(b"\r\n")[0].decode()

    async def sit_down(self) -> tuple[trio.SocketStream, str]:
        key = base64.b64encode(os.urandom(16)).decode()
        upgrade = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
        own = (f"Origin: http://{self.host}", f"Sec-WebSocket-Key: {key}")
        return await self.ask("/operate", self.host, *upgrade, *own)


async def confirm_stop() -> str:
    return "limp, 6 motors confirmed"


@asynccontextmanager
async def served(
    host: str = "127.0.0.1", stop: Callable[[], Awaitable[str]] = confirm_stop
) -> AsyncIterator[Served]:
    received: list[Operate] = []

    async def count_stop() -> str:
        page.stops += 1
        return await stop()

    serving = server.Page(
        MonotonicClock(), received.append, lambda *_: None, count_stop, lambda: {"state": "idle"}, ["a"], [], "t"
    )
    async with trio.open_nursery() as nursery:
        tell, addresses = trio.open_memory_channel[str](1)
        nursery.start_soon(serving.serve, host, 0, tell.send_nowait)
        page = Served(await addresses.receive(), received)
        with trio.fail_after(20.0):
            yield page
        for stream in page.streams:
            await stream.aclose()
        nursery.cancel_scope.cancel()


def test_a_page_that_is_silent_gives_its_seat_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sleeping phone or a lost network does not close its connection."""
    monkeypatch.setattr(server, "SILENT_S", 1.0)

    async def test() -> None:
        async with served() as page:
            silent, answer = await page.sit_down()
            assert " 101 " in answer
            assert " 409 " in (await page.sit_down())[1], "the first client still has the seat"
            assert await silent.receive_some(300) != b"", "a status of the robot"
            while await silent.receive_some(300):
                pass
            assert not page.told[-1].held
            assert " 101 " in (await page.sit_down())[1]

    trio.run(test)


HIDDEN = """
const html = require("fs").readFileSync(process.argv[1], "utf-8")
const text = html.slice(html.indexOf("function connect"), html.indexOf("connect()\\nsetInterval"))
let opened = 0, socket, open
const document = {hidden: true}, location = {}, waiting = []
const setTimeout = again => waiting.push(again)
class WebSocket { constructor() { opened += 1 } }
eval(text + "; connect()")
const before = opened
document.hidden = false
if (waiting.length) waiting.pop()()
console.log(before, opened)
"""


@pytest.mark.needs("Node.js")
def test_a_hidden_page_requests_no_seat() -> None:
    """A hidden page would be silent, lose the seat, and take it again."""
    assert run_on_page(HIDDEN).split() == ["0", "1"]


@pytest.mark.parametrize("host", ["LocalHost", "localhost", "127.0.0.1"])
def test_a_page_is_found_by_its_name_in_any_case(host: str) -> None:
    async def test() -> None:
        async with served(parse_listen_address(host)[0]) as page:
            for name in (page.host, page.host.lower()):  # browsers send it in lower case
                assert " 200 " in (await page.ask("/", name))[1]

    trio.run(test)


@pytest.mark.parametrize("listen", ["0.0.0.0:8000", "0.0.0.0", "0:8000", "0.0:8000"])
def test_a_page_that_no_browser_could_name_is_refused(listen: str) -> None:
    with pytest.raises(
        ValueError, match=r"all addresses of this computer\. Give the address .* such as 192\.0\.2\.5"
    ):
        Teleoperator("phone", listen=listen)


STOP = """
const html = require("fs").readFileSync(process.argv[1], "utf-8")
const part = (from, to) => html.slice(html.indexOf(from), html.indexOf(to))
const elements = {stop: {}}
const element = id => elements[id]
const shown = [], sent = [], letGo = () => {}
const show = (state, why) => shown.push(`${state}: ${why}`)
let key = ""
const performance = {now: () => 1}
const full = {bufferedAmount: 5000, send: text => sent.push(JSON.parse(text))}
const text = part("let socket, open", "function turn").replace("let stop = false", "var stop = false")
eval(text.replace("let socket, open = false", "var socket = full, open = false"))
pressStop()
console.log(shown.pop(), "|", sent.length)
open = true; pressStop()
console.log(shown.pop(), "|", sent.pop().stop)
showStopped("asked, not confirmed yet"); console.log(shown.pop(), "|", stop)
showStopped("limp, 6 motors confirmed"); console.log(shown.pop(), "|", stop)
open = false; showStopped(""); console.log(shown.pop())
open = true; pressStop(); open = false; showStopped(""); console.log(shown.pop())
"""


def test_the_page_shows_each_step_of_a_stop_and_only_confirmed_results() -> None:
    assert run_on_page(STOP).splitlines() == [
        "stopping: NOT SENT: this page is not connected. Use the robot's own switch | 0",
        "stopping: sent | true",
        "stopping: asked, not confirmed yet | false",
        "stopped: limp, 6 motors confirmed | false",
        "stopped: limp, 6 motors confirmed",
        "stopping: NOT CONFIRMED: the connection ended. Cut its power if it still moves",
    ]
