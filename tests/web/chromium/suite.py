"""Watch, stop and move a robot on its twin in Chromium: ``python -m tests console``."""

from __future__ import annotations

import contextlib
import functools
import http.server
import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import pytest

from strands_actors.surfaces.agents.approval import Request
from strands_actors.surfaces.agents.asking import ask_on_console
from strands_actors.testing.wirelog import WireLog
from tests.answers import until
from tests.cli.command import Command, RobotProcess
from tests.web.browser import Visitor
from tests.web.conftest import cli
from tests.web.serving import console_of
from tests.web.test_console import LOG_VARIABLE, state_of

from .cdp import VARIABLE, Browser, Tab, chromium, find_chromium

__all__ = ["cli"]

AXE = "AXE_CORE"
ATTEMPTS = 20
BLOCK_MS = 5000
STILL_S = 0.6
"""Time in which a further setpoint would be seen."""
JOG = 'button[aria-label="shoulder_pan up"]'
SERIOUS = ("serious", "critical")
CHANGED = """(async () => {
  const pixels = async url => {
    const image = Object.assign(new Image(), {src: url})
    await image.decode()
    const canvas = Object.assign(document.createElement('canvas'), {width: image.width, height: image.height})
    const context = canvas.getContext('2d')
    context.drawImage(image, 0, 0)
    return context.getImageData(0, 0, canvas.width, canvas.height).data
  }
  const [one, two] = [await pixels(ONE), await pixels(TWO)]
  let count = 0
  const apart = at => Math.abs(one[at] - two[at])
  for (let at = 0; at < one.length; at += 4)
    if (apart(at) + apart(at + 1) + apart(at + 2) > 60) count++
  return count
})()"""
"""Counts the pixels in which two pictures differ."""
CANVAS = ".stage canvas"
ROBOT_PIXELS = 100
"""So many pixels at least show the robot, and change when it turns."""


class Bench(NamedTuple):
    """A robot on its twin with its log, the console in front of it, an operator without a browser, and Chromium."""

    robot: RobotProcess
    log: Path
    facts: dict[str, Any]
    visitor: Visitor
    browser: Browser
    run_dir: str

    @property
    def origin(self) -> str:
        return self.visitor.origin

    def setpoints(self) -> int:
        return len(WireLog(self.log).host("setpoint"))

    def open_robot(self) -> Tab:
        tab = self.browser.open(f"{self.facts['url']}&robot=so101")
        tab.until("document.querySelectorAll('.jog').length", lambda count: count == 12)
        return tab

    def hold_jog(self, tab: Tab) -> tuple[float, float]:
        """Press a jog button until it moves the robot. On a busy computer the page may be late, and the robot holds
        at once: then press again."""
        for _ in range(ATTEMPTS):
            at = tab.press(JOG)
            with contextlib.suppress(TimeoutError):
                tab.until("document.querySelector('.seat').classList.contains('engaged')", within_s=2.0)
                return at
            tab.mouse("mouseReleased", at)
            self.visitor.order("/robots/so101/resume")
        raise AssertionError("the page does not move the robot")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    path = find_chromium()
    if not path:
        pytest.exit(f"No Chromium was found. Install it, or let {VARIABLE} name its program.", returncode=2)
    with chromium(path) as running:
        yield running


@pytest.fixture(scope="module")
def bench(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    directory = tmp_path_factory.mktemp("sa")
    log = directory / "wire.log"
    command = Command(directory)
    command.environment[LOG_VARIABLE] = str(log)
    agent = ("--agent", "tests.web.scripted_agent:helpful", "--lan", "--name", "127.0.0.1")
    with (
        RobotProcess(command) as robot,
        console_of(command, *agent) as facts,
        Visitor(facts["url"]) as visitor,
    ):
        robot.call("release")
        yield Bench(robot, log, facts, visitor, browser, command.environment["STRANDS_ACTORS_RUN"])


def test_the_picture_changes_when_a_joint_moves(bench: Bench) -> None:
    tab = bench.open_robot()
    blank = bench.browser.open("about:blank")
    empty = tab.picture(CANVAS)

    def changed(since: str) -> int:
        script = CHANGED.replace("ONE", json.dumps(since)).replace("TWO", json.dumps(tab.picture(CANVAS)))
        return int(blank.run(script))

    until(lambda: changed(empty) > ROBOT_PIXELS, "the robot is drawn")
    before = tab.picture(CANVAS)
    at = bench.hold_jog(tab)
    until(lambda: changed(before) > ROBOT_PIXELS, "the drawn robot moves")
    tab.mouse("mouseReleased", at)
    tab.close()
    blank.close()


def test_closing_the_tab_ends_a_jog(bench: Bench) -> None:
    tab = bench.open_robot()
    with bench.visitor.page() as watching:
        bench.hold_jog(tab)
        until(lambda: state_of(watching) == "armed", "it moves")
        tab.close()
        until(lambda: state_of(watching) == "holding", "the robot holds")
        setpoints = bench.setpoints()
        time.sleep(STILL_S)
        assert 0 < setpoints == bench.setpoints()
    bench.visitor.order("/robots/so101/resume")


def test_the_estop_stops_the_robot_beside_a_page_that_is_blocked(bench: Bench) -> None:
    tab = bench.open_robot()
    at = tab.middle_of("#estop")
    tab.start(f"const end = performance.now() + {BLOCK_MS}; while (performance.now() < end);")
    blocked_until_ns = time.monotonic_ns() + BLOCK_MS * 1_000_000
    before = len(WireLog(bench.log).host("safe"))
    time.sleep(0.3)
    button = (80.0, at[1])
    for kind in ("mousePressed", "mouseReleased"):
        tab.mouse(kind, button, wait=False)
    until(lambda: len(WireLog(bench.log).host("safe")) > before, "the twin gets the stop")
    stop = WireLog(bench.log).host("safe")[before]
    assert stop.t_ns < blocked_until_ns, "the stop had to wait for the page"
    tab.close()
    bench.visitor.order("/robots/so101/resume")


def test_a_hostile_page_in_the_same_browser_moves_and_stops_nothing(bench: Bench) -> None:
    """The page has the browser's cookie, because cookies ignore the port. Its origin gives it away."""
    tab = bench.open_robot()
    assert tab.run("document.cookie") == "", "a script can read the cookie"
    before = (bench.setpoints(), len(WireLog(bench.log).host("safe")))
    pages = functools.partial(_HostilePage, bench.origin, bench.facts["estop"])
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), pages) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        hostile = bench.browser.open_in(tab.context, f"http://127.0.0.1:{server.server_port}/")
        done = hostile.until("window.results && window.results.length === 4 && window.results")
        hostile.close()
        server.shutdown()
    assert done == ["no socket", "not read", "not read", "not read"]
    answers = [
        event["params"]
        for event in bench.browser.events
        if event.get("sessionId") == hostile.session and event["method"] == "Network.responseReceivedExtraInfo"
    ]
    # Only the console's answers have this header. The three orders, and the form of the e-stop:
    statuses = [each["statusCode"] for each in answers if "content-security-policy" in each["headers"]]
    assert statuses == [403, 403, 403, 403]
    time.sleep(STILL_S)
    assert before == (bench.setpoints(), len(WireLog(bench.log).host("safe")))
    tab.close()


class _HostilePage(http.server.BaseHTTPRequestHandler):
    """A page of another port: it sends orders, opens the page's connection, and submits the e-stop's form."""

    def __init__(self, console: str, estop: str, *arguments: Any) -> None:
        self._console, self._estop = console, estop
        super().__init__(*arguments)

    def do_GET(self) -> None:
        script = f"""
            const console_ = {json.dumps(self._console)}, results = []
            const options = {{method: 'POST', credentials: 'include', mode: 'no-cors', body: '{{}}'}}
            const post = path => fetch(console_ + path, options)
              .then(async answer => results.push(await answer.text() || 'not read'), () => results.push('not read'))
            const socket = new WebSocket(console_.replace('http', 'ws') + '/live')
            socket.onopen = () => results.unshift('socket')
            socket.onerror = async () => {{
              results.unshift('no socket')
              await post('/robots/so101/resume'); await post('/robots/so101/pose'); await post('/robots/so101/stop')
              window.results = results
            }}
        """
        form = f'<form method=post action="{self._estop}" target=f id=e></form><iframe name=f></iframe>'
        body = f"<!doctype html>{form}<script>{script}; document.getElementById('e').submit()</script>".encode()
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def test_a_second_device_gets_in_by_its_code_only(bench: Bench) -> None:
    offered = bench.visitor.order("/devices/offer", role="viewer")
    phone = bench.browser.open(offered["url"])
    phone.until("document.querySelector('#code') && document.readyState === 'complete'")
    phone.click("#code")
    phone.type("00000000")
    phone.click("button")
    phone.until("document.body.textContent.includes('not valid')")
    phone.go(f"{offered['url']}?code={offered['code']}")
    phone.until(f"document.querySelector('#code')?.value === '{offered['code']}'")
    phone.click("button")
    phone.until("document.querySelector('.card h2')?.textContent === 'so101'")
    assert phone.run("document.querySelector('nav a.operator').hidden"), "a viewer sees the operators' views"
    phone.close()


def test_a_question_is_answered_on_the_page_and_a_viewer_only_sees_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_RUN", bench.run_dir)
    offered = bench.visitor.order("/devices/offer", role="viewer")
    viewer = bench.browser.open(f"{offered['url']}?code={offered['code']}")
    viewer.until("document.querySelector('#code')?.value")
    viewer.click("button")
    operator = bench.browser.open(bench.facts["url"])
    answers: list[bool] = []
    asking = threading.Thread(
        target=lambda: answers.append(ask_on_console(Request("so101", "set_torque", {"enabled": True})))
    )
    asking.start()
    viewer.until("document.querySelector('.consent h2')?.textContent.includes('set_torque')")
    assert viewer.run("document.querySelector('.consent .row').hidden")
    operator.click(".consent .go")
    asking.join()
    assert answers == [True]
    viewer.until("document.querySelector('.consent .left').textContent.includes('approved by')")
    operator.close()
    viewer.close()


VIEWS = ("#/", "#/robots/so101", "#/agent", "#/devices")


def test_no_request_leaves_the_console(bench: Bench) -> None:
    tab = bench.open_robot()
    for view in VIEWS:
        tab.run(f"location.hash = {view!r}")
        time.sleep(STILL_S)
    own = {urlsplit(bench.origin).netloc, urlsplit(bench.facts["estop"]).netloc}
    requests = tab.requests()
    others = [url for url in requests if urlsplit(url).scheme != "data" and urlsplit(url).netloc not in own]
    assert len(requests) > 10 and not others
    tab.close()


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("view", [*VIEWS, "pair", "estop"])
def test_axe_has_no_serious_finding(bench: Bench, view: str, theme: str) -> None:
    source = Path(os.environ.get(AXE, "node_modules/axe-core/axe.min.js"))
    assert source.exists(), f"axe-core was not found. npm install axe-core, and let {AXE} name its axe.min.js"
    tab = bench.browser.open(bench.facts["url"])
    tab.command("Page.setBypassCSP", enabled=True)
    tab.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])
    tab.until("document.querySelector('.card h2')?.textContent === 'so101'")
    if view == "pair":
        tab.go(f"{bench.origin}/pair")
        tab.until("location.pathname === '/pair' && document.readyState === 'complete'")
    elif view == "estop":
        tab.go(bench.facts["estop"])
        tab.until("location.pathname === '/estop' && document.readyState === 'complete'")
    else:
        tab.run(f"location.hash = {view!r}")
        time.sleep(STILL_S)
    tab.run(source.read_text("utf-8") + "; true")
    found = tab.run(
        "axe.run(document, {iframes: false}).then(result => result.violations.map("
        "each => ({id: each.id, impact: each.impact, nodes: each.nodes.map(node => node.html.slice(0, 160))})))"
    )
    tab.close()
    assert [each for each in found if each["impact"] in SERIOUS] == []
