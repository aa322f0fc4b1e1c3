"""``console LENGTH VIEWERS``: serve the console for many stand-in robots, and stop them beside slow viewers.

``page_hz`` is the number of frames per second of a page in Chromium that shows all robots, and ``server_pct`` the
processor time of the console meanwhile, in percent of one core. Then VIEWERS connect, and the robots are stopped
again and again by two ways: ``estop``, the page of the e-stop, and ``order``, the button of one robot.

Chromium is found as in ``tests/web/chromium``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException
from websockets.typing import Origin

from benchmarks.stage import at_home
from tests.web.browser import Visitor
from tests.web.chromium.cdp import VARIABLE, chromium, find_chromium

from .scale import MADE, ROBOTS, ROUTER, SETTLE_S, endpoint, free_port, process
from .wire import percentile, processor_s

SIZES = {"short": (10, 5, 2.0), "long": (100, 200, 10.0)}
"""Number of robots, of presses by each way, and seconds of the page."""
WAIT_US = 100_000
VIEWERS = "viewers"
READ_S = 1.0
"""A slow viewer reads one message in this time. The console sends several."""
SMALL = 2048
"""Size of a viewer's receive buffer in bytes, so that unread messages stay in the console."""
APPEAR_S = 60.0
FRAMES = """new Promise(done => {{
  let count = 0
  const began = performance.now()
  const step = now => {{
    count += 1
    if (now - began < {ms}) requestAnimationFrame(step)
    else done(count * 1000 / (now - began))
  }}
  requestAnimationFrame(step)
}})"""


async def view(origin: str, cookie: str, count: int) -> None:
    """Run slow viewers. One that the console has disconnected comes back."""

    async def one() -> None:
        url = f"{origin.replace('http', 'ws', 1)}/live"
        while True:
            with contextlib.suppress(WebSocketException, OSError):
                options: dict[str, Any] = {"additional_headers": {"Cookie": cookie}, "origin": Origin(origin)}
                async with connect(url, max_queue=1, ping_interval=None, **options) as socket:
                    while True:
                        await socket.recv()
                        await asyncio.sleep(READ_S)

    async with asyncio.TaskGroup() as tasks:
        for _ in range(count):
            tasks.create_task(one())
        await asyncio.sleep(SETTLE_S)
        print(MADE, flush=True)


@contextlib.contextmanager
def viewers(visitor: Visitor, count: int) -> Iterator[None]:
    """Run slow viewers in a process while the block runs."""
    words = [sys.executable, "-m", "benchmarks.sides.console", VIEWERS, visitor.origin, visitor.cookie, str(count)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            if started.stdout.readline().strip() != MADE:
                raise SystemExit("the viewers did not start")
            yield
        finally:
            started.kill()


@contextlib.contextmanager
def served(port: int, directory: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Serve the console for the robots behind a router. Yield the process and the addresses."""
    file = directory / "mesh.toml"
    file.write_text(f'connect = "{endpoint(port)}"\ninsecure = true\n')
    main = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"
    words = [sys.executable, "-c", main, "web", "--port", "0", "--mesh", str(file), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            yield started.pid, json.loads(started.stdout.readline())
        finally:
            started.kill()


def show(url: str, pid: int, count: int, seconds: float) -> dict[str, float]:
    """Show all robots on a page, and return its frames per second and the console's processor time."""
    path = find_chromium()
    if not path:
        raise SystemExit(f"no Chromium was found. Install it, or let {VARIABLE} name its program")
    with chromium(path) as browser:
        tab = browser.open(url)
        tab.until("document.querySelectorAll('.card').length", lambda cards: cards == count)
        time.sleep(SETTLE_S)
        before_s, began_s = processor_s(pid), time.monotonic()
        page_hz = float(tab.run(FRAMES.format(ms=seconds * 1e3)))
        used = (processor_s(pid) - before_s) / (time.monotonic() - began_s)
    return {"page_hz": page_hz, "server_pct": 100.0 * used}


def presses(name: str, count: int, press: Callable[[], httpx.Response]) -> dict[str, float]:
    """Stop again and again, and return how long the answers took."""
    times_ms = []
    for _ in range(count):
        began_s = time.monotonic()
        answer = press()
        times_ms.append((time.monotonic() - began_s) * 1e3)
        if answer.status_code != 200:
            raise SystemExit(f"{name} was answered with {answer.status_code}: {answer.text}")
        time.sleep(0.02)
    return {f"{name}_p50_ms": percentile(times_ms, 0.5), f"{name}_p99_ms": percentile(times_ms, 0.99)}


def measure(size: str, viewer_count: int, directory: Path) -> dict[str, float]:
    robots, press_count, seconds = SIZES[size]
    port = free_port()
    with contextlib.ExitStack() as stack:
        stack.enter_context(process(ROUTER, port, 0, WAIT_US))
        stack.enter_context(process(ROBOTS, port, 0, robots))
        pid, facts = stack.enter_context(served(port, directory))
        visitor = stack.enter_context(Visitor(facts["url"]))
        figures = show(facts["url"], pid, robots, seconds) if viewer_count else {}
        if viewer_count:
            stack.enter_context(viewers(visitor, viewer_count))
        else:
            time.sleep(SETTLE_S)
        parts = urlsplit(facts["estop"])
        origin = f"{parts.scheme}://{parts.netloc}"
        headers = {"Origin": origin, "Cookie": visitor.cookie}
        estop = stack.enter_context(httpx.Client(headers=headers, timeout=APPEAR_S))
        figures |= presses("estop", press_count, lambda: estop.post(facts["estop"]))
        figures |= presses("order", press_count, lambda: visitor.http.post("/robots/robot00000/estop"))
    return figures


def main() -> None:
    if sys.argv[1] == VIEWERS:
        asyncio.run(view(sys.argv[2], sys.argv[3], int(sys.argv[4])))
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        print(json.dumps(measure(sys.argv[1], int(sys.argv[2]), Path(directory))))


if __name__ == "__main__":
    main()
