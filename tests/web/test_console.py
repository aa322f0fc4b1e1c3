"""A browser watches, stops and moves a robot on its twin through ``strands-actors web``."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import ssl
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from strands_actors.surfaces.cli import run
from strands_actors.testing.wirelog import WireLog
from tests.answers import until
from tests.cli.command import Command, RobotProcess

from .browser import OpenPage, Visitor
from .conftest import Bench
from .serving import console_of

LOG_VARIABLE = "STRANDS_ACTORS_TWIN_LOG"
LOOK_S = 0.4
"""Time in which a further setpoint would be seen."""


def test_who_is_not_let_in_gets_nothing(bench: Bench) -> None:
    visitor = bench.visitor
    with httpx.Client(base_url=visitor.origin, headers={"Origin": visitor.origin}) as stranger:
        for path in ("/", "/page/console.js", "/robots/so101/scene", "/devices"):
            assert stranger.get(path).status_code == 403, path
        for path in ("/robots/so101/stop", "/robots/so101/resume", "/devices/offer"):
            assert stranger.post(path).status_code == 403, path
        assert stranger.get("/?token=guess").status_code == 403
        assert not stranger.cookies
    elsewhere = visitor.http.post("/robots/so101/stop", headers={"Origin": "http://evil.example"})
    rebound = visitor.http.get("/", headers={"Host": "evil.example"})
    assert (elsewhere.status_code, rebound.status_code) == (403, 421)


def test_the_pages_are_served_and_nothing_else(bench: Bench) -> None:
    visitor = bench.visitor
    page = visitor.http.get("/")
    assert page.status_code == 200 and "data-facts" in page.text and "{{" not in page.text
    policy = page.headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
    for name in ("console.js", "vendor.js", "console.css"):
        assert visitor.http.get(f"/page/{name}").status_code == 200
    for path in ("/page/index.html", "/page/..%2fapp.py", "/page/../app.py", "/robots/..%2f/scene"):
        assert visitor.http.get(path).status_code == 404, path
    cookie = visitor.http.get("/", params={"token": "x"})
    assert cookie.status_code == 403


def test_the_model_of_a_robot_is_served(bench: Bench) -> None:
    visitor = bench.visitor
    with visitor.page("so101") as page:
        page.kind("reading")
    data = visitor.http.get("/robots/so101/scene").content
    length = int.from_bytes(data[:4], "little")
    head: dict[str, Any] = json.loads(data[4 : 4 + length])
    assert {joint["name"] for body in head["bodies"] for joint in body["joints"]} >= {"shoulder_pan", "gripper"}
    names = ["world", *(body["name"] for body in head["bodies"])]
    assert all(names.index(body["parent"]) < names.index(body["name"]) for body in head["bodies"])
    last = max(head["meshes"], key=lambda mesh: int(mesh["at"]))
    assert len(data) == 4 + length + last["at"] + 12 * (last["points"] + last["faces"])


def test_saf_009_a_page_moves_a_robot_while_its_button_is_held(bench: Bench) -> None:
    """SAF-009: two pages do not move one robot."""
    visitor = bench.visitor
    with visitor.page("so101") as page:
        axes = page.kind("axes")["axes"]
        assert axes["shoulder_pan"]["unit"] == "deg" and axes["shoulder_pan"]["high"] > 100
        start = measured(page.kind("reading"), "shoulder_pan")
        page.jog(shoulder_pan=1.0)
        page.until(lambda message: message["type"] == "seat" and message["state"] == "engaged", "it is engaged")
        page.until(
            lambda message: message["type"] == "reading" and measured(message, "shoulder_pan") > start + 5,
            "it moves",
        )
        with visitor.page("so101") as second:
            second.kind("axes")
            second.jog(shoulder_pan=-1.0)
            refused = second.until(lambda each: each["type"] == "seat" and bool(each["reason"]), "a refusal")
            assert refused["state"] == "idle"
            second.let_go()
        page.let_go()
        page.until(lambda message: message["type"] == "seat" and message["state"] == "idle", "it holds")
        until(lambda: state_of(page) == "holding", "the robot holds")


@pytest.mark.parametrize("ending", ["blocked", "closed"])
def test_saf_001_a_page_that_is_blocked_or_closed_ends_its_motion(
    ending: str, cli: Command, tmp_path: Path
) -> None:
    log = tmp_path / "wire.log"
    cli.environment[LOG_VARIABLE] = str(log)
    with RobotProcess(cli) as robot, console_of(cli) as facts, Visitor(facts["url"]) as visitor:
        robot.call("release")
        with visitor.page("so101") as watching:
            watching.kind("axes")
            with visitor.page("so101") as page:
                page.kind("axes")
                page.jog(shoulder_pan=1.0)
                page.until(lambda each: each["type"] == "seat" and each["state"] == "engaged", "it is engaged")
                until(lambda: state_of(watching) == "armed" and lease_of(watching) != "", "the page commands")
                if ending == "blocked":
                    page.freeze()
                    until(lambda: state_of(watching) == "holding", "the robot holds")
            until(lambda: state_of(watching) == "holding", "the robot holds")
            setpoints = len(WireLog(log).host("setpoint"))
            time.sleep(LOOK_S)
            assert 0 < setpoints == len(WireLog(log).host("setpoint"))


def test_a_page_jogs_the_tool_of_an_arm(bench: Bench) -> None:
    with bench.visitor.page("so101") as page:
        page.kind("axes")
        page.send(type="tool")
        assert page.kind("tool")["keys"][:3] == ["ee.x", "ee.y", "ee.z"]
        start = page.until(lambda message: message["type"] == "reading", "a reading")
        before = measured(start, "shoulder_lift")
        page.jog(**{"ee.z": 1.0})
        page.until(
            lambda message: message["type"] == "reading" and abs(measured(message, "shoulder_lift") - before) > 2,
            "it moves",
        )
        page.let_go()


def test_stop_estop_and_resume_tell_what_the_robot_has_confirmed(bench: Bench) -> None:
    visitor = bench.visitor
    stopped = visitor.order("/robots/so101/stop")
    assert stopped["ok"] and stopped["outcome"]["outcome"] == "safe" and len(stopped["outcome"]["motors"]) == 6
    assert visitor.order("/robots/so101/resume")["result"]["armed"]
    assert visitor.order("/robots/so101/estop")["outcome"]["locked"]
    with visitor.page("so101") as page:
        until(lambda: bool(fleet(page)) and fleet(page)[0]["locked_by"] != "", "the lock is shown")
        events = page.until(
            lambda each: each["type"] == "events" and any(one["kind"] == "stop" for one in each["events"]),
            "the stop",
        )
        assert events["robot"] == "so101"
    unknown = visitor.order("/robots/nobody/stop")
    assert not unknown["ok"] and unknown["outcome"]["outcome"] == "unreachable"
    refused = visitor.order("/robots/so101/pose", targets={"shoulder_pan": 400.0})
    assert not refused["ok"] and refused["refused"]["code"]
    assert visitor.order("/robots/so101/resume")["ok"]


def test_the_estop_has_its_own_origin_and_no_script(bench: Bench) -> None:
    visitor, url = bench.visitor, bench.estop
    parts = urlsplit(url)
    assert parts.netloc not in visitor.origin
    served = visitor.http.get(url)
    assert served.headers["Referrer-Policy"] == "same-origin", "else Chromium sends Origin: null with the form"
    assert served.headers["Origin-Agent-Cluster"] == "?1" and "<script" not in served.text
    assert "script-src" not in served.headers["Content-Security-Policy"]
    assert f"frame-ancestors {visitor.origin}" in served.headers["Content-Security-Policy"]
    evil = visitor.http.post(url, headers={"Origin": "http://evil.example"})
    assert evil.status_code == 403
    done = visitor.http.post(url, headers={"Origin": f"{parts.scheme}://{parts.netloc}"})
    assert '<li class="good"><b>so101</b> safe' in done.text
    assert visitor.http.get(url).status_code == 200
    with visitor.page() as page:
        until(lambda: bool(fleet(page)) and fleet(page)[0]["locked_by"] != "", "the lock is shown")
    assert visitor.order("/robots/so101/resume")["ok"]


def test_a_pose_is_stored_and_reached_again(bench: Bench) -> None:
    visitor = bench.visitor
    with visitor.page("so101") as page:
        there = measured(page.kind("reading"), "shoulder_pan")
        stored = visitor.order("/robots/so101/poses/store", name="here")["poses"]["here"]
        assert abs(stored["shoulder_pan"] - there) < 0.5 and len(stored) == 6
        assert visitor.order("/robots/so101/pose", targets={"shoulder_pan": there - 15.0})["ok"]
        page.until(
            lambda each: each["type"] == "reading" and measured(each, "shoulder_pan") < there - 14, "it has moved"
        )
        assert visitor.order("/robots/so101/stop")["ok"] and visitor.order("/robots/so101/resume")["ok"]
        assert visitor.order("/robots/so101/pose", targets=stored)["ok"]
        seen = len(page.messages)
        until(
            lambda: any(
                each["type"] == "reading" and measured(each, "shoulder_pan") > there - 1
                for each in page.messages[seen:]
            ),
            "it is back",
        )
    assert visitor.order("/robots/so101/poses/remove", name="here")["poses"] == {}
    gone = visitor.http.post("/robots/so101/poses/remove", content=b'{"name": "here"}')
    assert gone.status_code == 409 and "no pose here" in gone.text


BAD_MESSAGES: tuple[str | bytes, ...] = (
    "",
    "{}",
    "[]",
    "x" * 3000,
    '{"type":"jog"}',
    '{"type":"jog","held":true,"at_ms":-1}',
    '{"type":"jog","held":1,"at_ms":1}',
    '{"type":"watch","robot":5}',
    '{"type":"order"}',
    '{"type":"watch","robot":"a","more":1}',
    "[" * 4000,
    b"\0\1",
)


@pytest.mark.parametrize("text", BAD_MESSAGES)
def test_a_page_that_sends_something_else_is_disconnected(text: str | bytes, shared_visitor: Visitor) -> None:
    with shared_visitor.page() as page:
        page.kind("fleet")
        page.send_text(text)
        assert page.closed.wait(20)
    with shared_visitor.page() as next_page:
        next_page.kind("fleet")


def test_a_port_in_use_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert run(["web", "--port", str(min(taken.getsockname()[1], 65532))]) == 2
    assert "Give another --port" in capsys.readouterr().err


def measured(message: dict[str, Any], joint: str) -> float:
    return next(float(each["measured"]) for each in message["reading"]["joints"] if each["name"] == joint)


def fleet(page: OpenPage) -> list[dict[str, Any]]:
    for message in reversed(page.messages):
        if message["type"] == "fleet":
            return list(message["robots"])
    return []


def state_of(page: OpenPage) -> str:
    return str(next((each["state"] for each in fleet(page) if each["name"] == "so101"), ""))


def lease_of(page: OpenPage) -> str:
    return str(next((each["lease"] for each in fleet(page) if each["name"] == "so101"), ""))


def test_the_tree_of_a_robot_shows_processes_and_restarts(bench: Bench) -> None:
    visitor = bench.visitor

    def processes() -> dict[str, dict[str, Any]]:
        answer = visitor.http.get("/robots/so101/tree")
        assert answer.status_code == 200, answer.text
        tree = answer.json()
        assert any(actor["address"].endswith("/actor/gate") for actor in tree["actors"])
        return {process["role"]: process for process in tree["processes"]}

    first = processes()
    assert first["root"]["state"] == "running" and first["standby"]["restarts"] == 0
    os.kill(first["standby"]["pid"], 9)
    until(lambda: processes()["standby"]["restarts"] == 1, "the standby is replaced")
    assert visitor.http.get("/robots/nobody/tree").status_code == 404


def test_another_device_gets_in_by_a_code(tmp_path: Path, cli: Command) -> None:
    with console_of(cli, "--lan", "--name", "localhost") as facts, Visitor(facts["url"]) as operator:
        certificate = tmp_path.joinpath("own.pem")
        parts = urlsplit(facts["pairing"])
        certificate.write_text(ssl.get_server_certificate((parts.hostname or "", parts.port or 0)))
        tls = ssl.create_default_context(cafile=str(certificate))
        digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate.read_text())).hexdigest()
        assert digest == facts["fingerprint"].replace(":", "").lower()
        offered = operator.order("/devices/offer", role="viewer")
        assert offered["picture"].startswith("data:image/svg+xml;base64,") and offered["url"] in facts["pairing"]

        with Visitor(facts["pairing"], offered["code"], tls) as phone:
            assert phone.http.post("/robots/so101/resume").status_code == 403
            assert phone.http.get("/devices").status_code == 403
            assert phone.http.get("/setup/ports").status_code == 403
            with pytest.raises(ConnectionClosed), phone.command(type="drill", robot="so101") as socket:
                socket.recv(timeout=20)
            assert phone.order("/robots/so101/stop")["outcome"]["outcome"] == "unreachable", "a viewer may stop"
            again = phone.http.post("/pair", content=f"code={offered['code']}")
            assert again.status_code == 403
            devices = operator.http.get("/devices").json()["devices"]
            (other,) = [device for device in devices if device["role"] == "viewer"]
            with phone.page() as page:
                page.kind("fleet")
                operator.order("/devices/revoke", id=other["id"])
                assert page.closed.wait(20)
            assert phone.http.get("/page/console.js").status_code == 403
        with Visitor(facts["pairing"], parts.query.removeprefix("code="), tls) as tablet:
            assert tablet.http.get("/devices").status_code == 200
