"""The operator's page: access to it, its commands to a robot, and the release of the dead-man."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from strands_actors import Teleoperator
from strands_actors.surfaces.web.operating import TAKEN
from strands_actors.teleoperation.lateness import Lateness
from tests.answers import json_of, until

from .conftest import Pair
from .page_script import run_on_page

MS = 1_000_000


def test_a_message_that_the_network_delayed_is_late() -> None:
    lateness = Lateness()
    assert lateness.of(1000.0, 50_000 * MS) == 0
    assert lateness.of(1033.0, 50_035 * MS) == 2 * MS
    assert lateness.of(1066.0, 52_066 * MS) == 2000 * MS, "it arrived two seconds after it was sent"
    assert lateness.of(3000.0, 51_999 * MS) == 0, "a quicker message is the new reference"


@contextmanager
def operated(pair: Pair) -> Iterator[tuple[str, ClientConnection]]:
    page = Teleoperator("page")
    json_of(pair.arm.attach_teleop(page))
    try:
        address = until(lambda: page.address, "it is served")
        with operator(address) as socket:
            yield address, socket
    finally:
        page.cleanup()


@contextmanager
def operator(address: str) -> Iterator[ClientConnection]:
    """Open the page as a browser does: the address gives a cookie, and the page connects with it."""
    parts = urlsplit(address)
    origin = f"{parts.scheme}://{parts.netloc}"
    with httpx.Client() as http:
        assert http.get(address).status_code == 200
        cookie = "; ".join(f"{name}={value}" for name, value in http.cookies.items())
    url = f"{origin.replace('http', 'ws', 1)}/operate"
    with connect(url, origin=Origin(origin), additional_headers={"Cookie": cookie}) as socket:
        yield socket


def say(socket: ClientConnection, held: bool, **rates: float) -> None:
    socket.send(json.dumps({"held": held, "rates": rates, "at_ms": time.monotonic() * 1e3}))


def test_a_page_jogs_and_any_release_of_it_leads_to_a_hold(pair: Pair) -> None:
    with operated(pair) as (address, socket):
        before = pair.arm.get_observation()["wrist_roll"]

        turns = itertools.count(1)

        def jogged() -> bool:
            # On a busy computer a message may be late, and then a new press is needed.
            say(socket, next(turns) % 100 != 0, wrist_roll=1.0)
            return bool(pair.arm.get_observation()["wrist_roll"] > before + 3)

        for _ in range(3):  # as the page does, repeatedly until its message is acknowledged
            say(socket, False)
            socket.recv()
        say(socket, False)
        with operator(address) as second:
            assert json.loads(second.recv(timeout=20.0))["why"] == TAKEN
            with pytest.raises(ConnectionClosed):
                second.recv(timeout=20.0)
        until(jogged, "it is jogged")
        assert json.loads(socket.recv())["state"] in ("idle", "engaged")
        gone_ns = time.monotonic_ns()
        socket.close()  # while the dead-man is held
        safe = until(lambda: pair.follower.log.first_safe(gone_ns), "it holds")
        assert safe.safe_state == "hold"
        with operator(address) as again:
            say(again, True, wrist_roll=1.0)  # held from the beginning, so it is not a new press
            time.sleep(0.2)
            say(again, True, wrist_roll=1.0)
            pair.follower.log.no_setpoint_after_safe(gone_ns)
            again.send("what?")
            with pytest.raises(ConnectionClosed):
                while True:
                    again.recv(timeout=20.0)
    json_of(pair.arm.stop_task())


def test_saf_002_stop_on_the_page_stops_the_robot_and_shows_the_result(pair: Pair) -> None:
    with operated(pair) as (_, socket):
        say(socket, False)
        before_ns = time.monotonic_ns()
        for _ in range(3):  # as the page does, until an answer arrives
            message = {"held": False, "rates": {}, "at_ms": time.monotonic() * 1e3, "stop": True}
            socket.send(json.dumps(message))
        stopped = ""
        with contextlib.suppress(ConnectionClosed):
            while True:
                stopped = json.loads(socket.recv(timeout=20.0))["stopped"] or stopped
        assert stopped.startswith("limp, ") and "NOT" not in stopped
        safe = until(lambda: pair.follower.log.first_safe(before_ns), "it is stopped")
        assert safe.safe_state == "limp"
        pair.follower.log.no_setpoint_after_safe(before_ns)
        task = until(
            lambda: (seen := json_of(pair.arm.get_task_status())) and not seen["running"] and seen, "it ends"
        )
        assert (task["exit_reason"], task["exit_detail"]) == ("stop", f"stopped by its page: {stopped}")


def test_the_pages_address_is_private_and_needs_its_token(pair: Pair, run_dir: Path) -> None:
    with operated(pair) as (address, _):
        (file,) = run_dir.glob("teleop-*.url")
        assert stat.S_IMODE(os.stat(file).st_mode) == 0o600 and file.read_text() == address
        parts = urlsplit(address)
        origin = f"http://{parts.netloc}"
        assert parts.hostname == "127.0.0.1"
        with httpx.Client(base_url=origin, headers={"Origin": origin}) as browser:
            for path in ("/", "/?token=guess", "/page/operate.js", "/operate"):
                assert browser.get(path).status_code == 403, path
            assert browser.get(f"/?{parts.query}").status_code == 200
            page = browser.get("/")
            assert "wrist_roll" in page.text and "{{" not in page.text and parts.query not in page.text
            policy = page.headers["Content-Security-Policy"]
            assert "frame-ancestors 'none'" in policy and "unsafe" not in policy
            for name in (
                "operate.js",
                "hand.js",
                "gamepad.js",
                "stopping.js",
                "dom.js",
                "operate.css",
                "console.css",
            ):
                assert browser.get(f"/page/{name}").status_code == 200, name
            assert browser.get("/", headers={"Host": "evil.example"}).status_code == 421
            assert browser.post("/", headers={"Origin": "http://evil.example"}).status_code == 403
    assert not list(run_dir.glob("teleop-*.url"))


def test_a_port_in_use_is_refused(pair: Pair) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        json_of(pair.arm.attach_teleop(Teleoperator("gamepad", listen=where)))
        ended = until(lambda: None if (now := json_of(pair.arm.get_task_status()))["running"] else now, "it ends")
    assert f"no page at {where}" in ended["exit_detail"]
    with pytest.raises(ValueError, match="Give an address of this host"):
        Teleoperator("page", listen="127.0.0.1:http")


@pytest.mark.parametrize("at_ms", [1e308, -1e308, -1.0, 1e15])
def test_a_page_with_an_impossible_clock_is_disconnected(pair: Pair, at_ms: float) -> None:
    with operated(pair) as (address, socket):
        socket.send(json.dumps({"held": False, "rates": {}, "at_ms": at_ms}))
        with pytest.raises(ConnectionClosed):
            for _ in range(100):
                socket.recv(timeout=10.0)
        with operator(address) as again:
            say(again, False)
            assert json.loads(again.recv(timeout=10.0))["state"], "the page is still served"


PADS = """
let focused = true
globalThis.document = {hasFocus: () => focused}
const pad = {connected: true, id: "pad", index: 0, axes: [1, 0, 0, 0], buttons: Array(16).fill({pressed: false})}
const shoulder = pressed => { pad.buttons[4] = {pressed} }
Object.defineProperty(globalThis, "navigator", {value: {getGamepads: () => [null, pad]}})
load().then(({Gamepads}) => {
  const words = [], pads = new Gamepads(["a", "b"], ["ee.x"], word => words.push(word))
  BODY
})
"""
FOCUS = """
  const seen = []
  for (const [focus, held] of [[true, true], [false, true], [true, true], [true, false], [true, true]]) {
    focused = focus
    shoulder(held)
    seen.push(pads.read())
  }
  console.log(JSON.stringify(seen))
"""
BACK = """
  pad.axes = [0.5, 1, 0, -1]
  shoulder(true)
  pad.buttons[8] = pad.buttons[2] = {pressed: true}
  console.log(JSON.stringify([pads.read(), pads.read(), (pad.buttons[8] = {pressed: false}, pads.read()), words]))
"""


@pytest.mark.needs("Node.js")
def test_back_on_a_gamepad_lets_its_sticks_move_the_tool() -> None:
    *rates, words = json.loads(run_on_page("gamepad.js", PADS.replace("BODY", BACK)))
    moved = {"ee.x": -1, "ee.y": -0.5, "ee.z": 1, "ee.wx": 0, "ee.wy": 0, "ee.wz": 0, "b": 0}
    assert rates == [moved] * 3 and words == ["toggle"], "a held button counts once"


@pytest.mark.needs("Node.js")
def test_a_gamepad_counts_only_while_its_page_has_the_focus() -> None:
    """Without focus, a browser may report the last state for ever, with the dead-man held."""
    seen = json.loads(run_on_page("gamepad.js", PADS.replace("BODY", FOCUS)))
    held = {"a": 1, "b": 0}
    assert seen == [held, None, None, None, held], "after that, only a new press counts"
