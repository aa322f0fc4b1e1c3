"""``console LENGTH VIEWERS``: serve the console for many stand-in robots, and stop them beside slow viewers.

``page_hz`` is the number of frames per second of a page in Chromium that shows all robots, and ``server_pct`` the
processor time of the console meanwhile, in percent of one core. They are measured only with VIEWERS above 0. Then
VIEWERS watch an arm on its twin, which is stopped again and again by two ways: ``estop``, the page of the e-stop,
and ``stop``, the button of the arm. The time is from the request until the twin has read the safe frame.

Chromium is found as in ``tests/web/chromium``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
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

from .fleet import Arm, start
from .scale import MADE, ROBOTS, ROUTER, endpoint, free_port, process
from .wire import percentile, processor_s

SIZES = {"short": (10, 5, 2.0), "long": (100, 600, 10.0)}
"""Number of robots, of presses by each way, and seconds of the page."""
WAIT_US = 100_000
VIEWERS = "viewers"
SETTLE_S = 5.0
"""Time for the page, or for the viewers, to get their first messages, in seconds."""
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


def behind(port: int, directory: Path) -> tuple[str, ...]:
    """Return the options of a console for the robots behind a router."""
    file = directory / "mesh.toml"
    file.write_text(f'connect = "{endpoint(port)}"\ninsecure = true\n')
    return "--mesh", str(file)


@contextlib.contextmanager
def served(*options: str) -> Iterator[tuple[int, dict[str, str]]]:
    """Serve the console. Yield the process and the addresses."""
    main = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"
    words = [sys.executable, "-c", main, "web", "--port", "0", "--json", *options]
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


def stops(name: str, count: int, arm: Arm, press: Callable[[], httpx.Response]) -> dict[str, float]:
    """Resume the arm and stop it, again and again. Return how long it took until the safe frame was on its wire."""
    times_ms = []
    for _ in range(count):
        answer = arm.robot.resume()
        if answer["status"] != "success":
            raise SystemExit(f"the arm is not resumed: {answer}")
        time.sleep(0.02)
        began_ns = time.monotonic_ns()
        response = press()
        if response.status_code != 200:
            raise SystemExit(f"{name} was answered with {response.status_code}: {response.text}")
        safe = arm.log.first_safe(began_ns)
        if safe is None:
            raise SystemExit(f"{name}: no safe frame")
        times_ms.append((safe.t_ns - began_ns) / 1e6)
    return {f"{name}_p50_ms": percentile(times_ms, 0.5), f"{name}_p99_ms": percentile(times_ms, 0.99)}


def crowded(size: str, directory: Path) -> dict[str, float]:
    """Show 100 robots on one page."""
    robots, _, seconds = SIZES[size]
    port = free_port()
    with contextlib.ExitStack() as stack:
        stack.enter_context(process(ROUTER, endpoint(port), "", WAIT_US))
        stack.enter_context(process(ROBOTS, endpoint(port), 0, robots))
        pid, facts = stack.enter_context(served(*behind(port, directory)))
        stack.enter_context(Visitor(facts["url"]))
        return show(facts["url"], pid, robots, seconds)


def stopped(size: str, viewer_count: int, directory: Path) -> dict[str, float]:
    """Stop an arm on its twin from the console, while viewers watch it."""
    _, count, _ = SIZES[size]
    arm = start(0, directory, on_exit="limp")
    try:
        with contextlib.ExitStack() as stack:
            _, facts = stack.enter_context(served())
            visitor = stack.enter_context(Visitor(facts["url"]))
            if viewer_count:
                stack.enter_context(viewers(visitor, viewer_count))
            time.sleep(SETTLE_S)
            parts = urlsplit(facts["estop"])
            headers = {"Origin": f"{parts.scheme}://{parts.netloc}", "Cookie": visitor.cookie}
            estop = stack.enter_context(httpx.Client(headers=headers, timeout=APPEAR_S))
            order = f"/robots/{arm.robot.name}/stop"
            return {
                **stops("estop", count, arm, lambda: estop.post(facts["estop"])),
                **stops("stop", count, arm, lambda: visitor.http.post(order)),
            }
    finally:
        arm.robot.cleanup()


def main() -> None:
    if sys.argv[1] == VIEWERS:
        asyncio.run(view(sys.argv[2], sys.argv[3], int(sys.argv[4])))
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        size, viewer_count = sys.argv[1], int(sys.argv[2])
        figures = crowded(size, Path(directory)) if viewer_count else {}
        print(json.dumps(figures | stopped(size, viewer_count, Path(directory))), flush=True)
    os._exit(0)  # zenoh's callbacks would delay a normal exit


if __name__ == "__main__":
    main()
