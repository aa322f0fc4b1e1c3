"""The operator's page without a robot: which client gets its seat, and under which host names it answers."""

from __future__ import annotations

import base64
import os
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
import trio

from strands_actors import Teleoperator
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.supervisors.root.messages import Operate
from strands_actors.surfaces.web import operating
from strands_actors.teleoperation.teleoperator import parse_listen_address

from .page_script import run_on_page


class Served:
    def __init__(self, address: str, told: list[Operate]) -> None:
        self.host, _, self.token = address.removeprefix("http://").partition("/?token=")
        self.cookie = ""
        self.told = told
        self.stops = 0
        self.streams: list[trio.SocketStream] = []

    async def ask(self, path: str, host: str, *headers: str) -> tuple[trio.SocketStream, str]:
        """Return a connection and the head of its answer. ``host`` is the name that a browser uses."""
        stream = await trio.open_tcp_stream("127.0.0.1", int(self.host.rpartition(":")[2]))
        self.streams.append(stream)
        cookie = (f"Cookie: {self.cookie}",) if self.cookie else ()
        rows = (f"GET {path} HTTP/1.1", f"Host: {host}", *cookie, *headers, "", "")
        await stream.send_all("\r\n".join(rows).encode())
        head = b""
        while b"\r\n\r\n" not in head:  # One byte at a time, so that no frame after it is read.
            head += await stream.receive_some(1)
        return stream, head.decode()

    async def come_in(self) -> None:
        """Get a session for the token, as a browser does."""
        _, head = await self.ask(f"/?token={self.token}", self.host)
        rows = [row for row in head.split("\r\n") if row.lower().startswith("set-cookie: ")]
        self.cookie = rows[0].partition(": ")[2].partition(";")[0]

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

    serving = operating.OperatorPage(
        MonotonicClock(), received.append, lambda *_: None, count_stop, lambda: {"state": "idle"}, ["a"], [], "t"
    )
    async with trio.open_nursery() as nursery:
        tell, addresses = trio.open_memory_channel[str](1)
        nursery.start_soon(serving.serve, host, 0, tell.send_nowait)
        page = Served(await addresses.receive(), received)
        with trio.fail_after(20.0):
            await page.come_in()
            yield page
        for stream in page.streams:
            await stream.aclose()
        nursery.cancel_scope.cancel()


def test_a_page_that_is_silent_gives_its_seat_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sleeping phone or a lost network does not close its connection."""
    monkeypatch.setattr(operating, "SILENT_S", 1.0)

    async def test() -> None:
        async with served() as page:
            silent, answer = await page.sit_down()
            assert " 101 " in answer
            second, _ = await page.sit_down()
            assert operating.TAKEN.encode() in await second.receive_some(300), "the first client still has the seat"
            assert await silent.receive_some(300) != b"", "a status of the robot"
            while await silent.receive_some(300):
                pass
            assert not page.told[-1].held
            third, _ = await page.sit_down()
            assert b'"state"' in await third.receive_some(300)

    trio.run(test)


def test_other_devices_get_the_page_encrypted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(tmp_path))
    monkeypatch.setattr(operating, "is_local", lambda host: False)

    def look(address: str) -> str:
        (file,) = (tmp_path / "console").glob("*.pem")
        with httpx.Client(verify=ssl.create_default_context(cafile=str(file))) as browser:
            let_in = browser.get(address)
            assert let_in.status_code == 200 and "Secure" in let_in.headers["Set-Cookie"]
            return browser.get(address.partition("?")[0]).text

    async def test() -> None:
        page = operating.OperatorPage(
            MonotonicClock(), lambda _: None, lambda *_: None, confirm_stop, dict, ["a"], [], "a title"
        )
        async with trio.open_nursery() as nursery:
            tell, addresses = trio.open_memory_channel[str](1)
            nursery.start_soon(page.serve, "127.0.0.1", 0, tell.send_nowait)
            address = await addresses.receive()
            assert address.startswith("https://127.0.0.1:")
            assert "a title" in await trio.to_thread.run_sync(look, address)
            nursery.cancel_scope.cancel()

    trio.run(test)


HIDDEN = """
const script = read()
const text = script.slice(script.indexOf("function connect"), script.indexOf("document.title ="))
const AGAIN_MS = 1
let opened = 0, socket, isOpen
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
    assert run_on_page("operate.js", HIDDEN).split() == ["0", "1"]


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
load().then(({Stopping}) => {
  const stop = new Stopping(), tell = () => console.log(`${stop.state}: ${stop.text} | ${stop.isPressed}`)
  stop.press(false); stop.look("", false); tell()
  stop.press(true); tell()
  stop.look("asked, not confirmed yet", true); tell()
  stop.look("limp, 6 motors confirmed", true); tell()
  stop.look("", false); tell()
  stop.press(true); stop.look("", false); tell()
})
"""


@pytest.mark.needs("Node.js")
def test_the_page_shows_each_step_of_a_stop_and_only_confirmed_results() -> None:
    assert run_on_page("stopping.js", STOP).splitlines() == [
        "stopping: NOT SENT: this page is not connected. Use the robot's own switch | true",
        "stopping: sent | true",
        "stopping: asked, not confirmed yet | false",
        "stopped: limp, 6 motors confirmed | false",
        "stopped: limp, 6 motors confirmed | false",
        "stopping: NOT CONFIRMED: the connection ended. Cut its power if it still moves | true",
    ]
