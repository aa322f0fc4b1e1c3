"""The operator's page: access to it, its commands to a robot, and the release of the dead-man."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from strands_actors import Teleoperator
from strands_actors.teleoperation.page.requests import Lateness, parse, refuse
from tests.answers import json_of, until

from .conftest import Pair
from .page_script import run_on_page

HOSTS = {"127.0.0.1:80", "localhost:80"}
MS = 1_000_000


def head(target: str, **headers: str) -> bytes:
    rows = [f"{name}: {value}" for name, value in {"Host": "127.0.0.1:80", **headers}.items()]
    return "\r\n".join([f"GET {target} HTTP/1.1", *rows]).encode()


UPGRADE = {"Upgrade": "websocket", "Origin": "http://127.0.0.1:80"}


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (head("/?token=t"), None),
        (head("/operate?token=t", **UPGRADE), None),
        (head("/"), 403),
        (head("/?token=other"), 403),
        (head("/?token="), 403),
        (head("/?token=t", Host="evil.example"), 421),
        (head("/?token=t", Host="evil.example:80"), 421),
        (head("/operate?token=t", **{**UPGRADE, "Origin": "http://evil.example"}), 403),
        (head("/operate?token=t", **{**UPGRADE, "Origin": "https://127.0.0.1:80"}), 403),
        (head("/operate?token=t", **{**UPGRADE, "Origin": "null"}), 403),
        (head("/operate?token=t", Upgrade="websocket"), 403),
        (head("/operate?token=t"), 404),
        (head("/etc/passwd?token=t"), 404),
        (head("/?token=t").replace(b"GET", b"POST"), 405),
        (head("/?token=t").replace(b"HTTP/1.1", b"SMTP"), 400),
        (head("/?token=t") + b"\r\nHost: evil.example", 400),
        (b"", 400),
        (b"\xff\xfe\r\n\r\n", 400),
    ],
)
def test_access_needs_the_token_and_a_correct_request(data: bytes, code: int | None) -> None:
    refusal = refuse(parse(data), "t", HOSTS)
    assert (None if refusal is None else refusal[0]) == code


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
    parts = urlsplit(address)
    with connect(f"ws://{parts.netloc}/operate?{parts.query}", origin=Origin(f"http://{parts.netloc}")) as socket:
        yield socket


def say(socket: ClientConnection, held: bool, **rates: float) -> None:
    socket.send(json.dumps({"held": held, "rates": rates, "at_ms": time.monotonic() * 1e3}))


def test_a_page_jogs_and_any_release_of_it_leads_to_a_hold(pair: Pair) -> None:
    with operated(pair) as (address, socket):
        before = pair.arm.get_observation()["wrist_roll"]

        def jogged() -> bool:
            say(socket, True, wrist_roll=1.0)
            return bool(pair.arm.get_observation()["wrist_roll"] > before + 3)

        for _ in range(3):  # as the page does, repeatedly until its message is acknowledged
            say(socket, False)
            socket.recv()
        until(jogged, "it is jogged")
        assert json.loads(socket.recv())["state"] in ("idle", "engaged")
        with pytest.raises(InvalidStatus) as second, operator(address):
            pass
        assert second.value.response.status_code == 409
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
        host, _, number = urlsplit(address).netloc.partition(":")
        assert host == "127.0.0.1"
        for target, code in ((f"/?{urlsplit(address).query}", 200), ("/", 403)):
            with socket.create_connection((host, int(number)), 20.0) as plain:
                plain.sendall(f"GET {target} HTTP/1.1\r\nHost: {host}:{number}\r\n\r\n".encode())
                answer = b"".join(iter(lambda plain=plain: plain.recv(65536), b""))  # type: ignore[misc]
            assert answer.startswith(f"HTTP/1.1 {code} ".encode())
            assert (b"frame-ancestors 'none'" in answer) == (code == 200)
            assert (b'"wrist_roll"' in answer) == (code == 200)
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
const html = require("fs").readFileSync(process.argv[1], "utf-8")
const start = html.indexOf("const DEAD_ZONE"), end = html.indexOf("let socket, open")
let focused = true
const document = {hasFocus: () => focused}
const told = {axes: ["a", "b"], tool: ["ee.x"]}
const element = () => ({textContent: ""}), buttons = {start() {}, discard() {}}
const pad = {connected: true, id: "pad", index: 0, axes: [1, 0, 0, 0], buttons: Array(16).fill({pressed: false})}
const shoulder = pressed => { pad.buttons[4] = {pressed} }
const navigator = {getGamepads: () => [null, pad]}
const pads = new Function("document", "element", "told", "buttons", "navigator",
  html.slice(start, end) + "; return pads")(document, element, told, buttons, navigator)
const seen = []
for (const [focus, held] of [[true, true], [false, true], [true, true], [true, false], [true, true]]) {
  focused = focus
  shoulder(held)
  seen.push(pads())
}
console.log(JSON.stringify(seen))
"""


BACK = """
pad.axes = [0.5, 1, 0, -1]
shoulder(true)
pad.buttons[8] = {pressed: true}
console.log(JSON.stringify([pads(), pads(), (pad.buttons[8] = {pressed: false}, pads())]))
"""


@pytest.mark.needs("Node.js")
def test_back_on_a_gamepad_lets_its_sticks_move_the_tool() -> None:
    *_, printed = run_on_page(PADS + BACK).splitlines()
    moved = {"ee.x": -1, "ee.y": -0.5, "ee.z": 1, "ee.wx": 0, "ee.wy": 0, "ee.wz": 0, "b": 0}
    assert json.loads(printed) == [moved] * 3, "a held button counts once"


@pytest.mark.needs("Node.js")
def test_a_gamepad_counts_only_while_its_page_has_the_focus() -> None:
    """Without focus, a browser may report the last state for ever, with the dead-man held."""
    held = {"a": 1, "b": 0}
    assert json.loads(run_on_page(PADS)) == [held, None, None, None, held], "after that, only a new press counts"
