"""Reports of drills: they have no personal data, and a file that is no report of a real robot is refused."""

from __future__ import annotations

import getpass
import json
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from docs.site import reports as pages
from strands_actors.drivers import get_native_driver_class
from strands_actors.surfaces.cli import drill_report
from strands_actors.surfaces.cli.drill import run
from strands_actors.surfaces.cli.errors import Problem
from strands_actors.surfaces.drill.certificate import StepResult
from strands_actors.surfaces.drill.connection import ON_THIS_COMPUTER, Connection, connection_of
from strands_actors.surfaces.drill.report import (
    FORM,
    LARGEST_BYTES,
    LOWERED,
    STEPS,
    BadReport,
    Peer,
    Report,
    encode,
    is_reportable,
    parse,
    report_of,
    require_real,
    write,
)
from strands_actors.surfaces.drill.run import Outcome
from tests.cli.command import ROOT

SECRETS = ("192.0.2.77", "/dev/ttyACM7", "XF1234567", "Anna", "anna", "/home/anna/arm.json")
"""Parts of the facts and results below that a report must not have."""
FACTS = {
    "port": "/dev/ttyACM7",
    "address": "192.0.2.77",
    "serial": "XF1234567",
    "nickname": "Anna's arm",
    "calibration_source": "/home/anna/arm.json",
    "firmware": {"shoulder_pan": "3.10", "elbow_flex": "3.9", "gripper": "3.10", "wrist_roll": "/home/anna"},
}


def results(failed: str = "") -> list[StepResult]:
    detail = "192.0.2.77 did not answer /home/anna/arm.json of Anna (XF1234567)"
    return [
        StepResult(
            step, step != failed, "limp", None, None if step == failed else 12.345, 50.0, None, detail, ("SAF-002",)
        )
        for step in STEPS
    ]


def made(connection: Connection = Connection.SERIAL, robot: str = "so101", failed: str = "") -> Report:
    driver = get_native_driver_class(robot)
    assert driver is not None
    return report_of(robot, driver, connection, FACTS, results(failed))


# -- make


def test_a_report_has_what_was_measured_and_no_personal_data() -> None:
    report = made()
    assert (report.peer, report.robot, report.wire, report.connection) == (
        "robot",
        "so101",
        "feetech",
        "serial port",
    )
    assert report.driver == "strands_actors.drivers.feetech.driver:Feetech"
    assert report.firmware == ["3.10", "3.9"]
    assert [step.step for step in report.steps] == list(STEPS)
    assert {(step.confirmed_ms, step.bound_ms, step.safe_state) for step in report.steps} == {(12.3, 50.0, "limp")}
    assert report.passed and not made(failed="stop").passed
    assert report.computer.architecture == os.uname().machine and report.computer.cpus == os.cpu_count()
    text = encode(report).decode()
    names = (socket.gethostname(), os.path.expanduser("~"), str(Path.cwd()))
    assert [secret for secret in (*SECRETS, *names) if secret in text] == []
    assert getpass.getuser() not in json.dumps(msgspec.to_builtins(report.computer))


def test_a_report_has_these_fields_and_no_others() -> None:
    fields = json.loads(encode(made()))
    assert set(fields) == {
        "format", "format_version", "peer", "robot", "driver", "wire", "connection", "firmware", "package_version",
        "date", "passed", "steps", "computer",
    }  # fmt: skip
    assert set(fields["computer"]) == {"system", "architecture", "cpus", "python"}
    assert {key for step in fields["steps"] for key in step} == {
        "step", "passed", "safe_state", "confirmed_ms", "bound_ms",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("port", "connection"),
    [
        ("", Connection.DEFAULT),
        ("/dev/ttyACM0", Connection.SERIAL),
        ("serial:///dev/ttyUSB0", Connection.SERIAL),
        ("192.0.2.7", Connection.NETWORK),
        ("192.0.2.7:502", Connection.NETWORK),
        ("tcp://arm.example:3000", Connection.NETWORK),
        ("[2001:db8::1]:80", Connection.NETWORK),
        ("radio://0/80/2M/E7E7E7E7E7", Connection.RADIO),
        ("usb://0", Connection.USB),
        ("ssh://duck@192.0.2.7", Connection.SSH),
        ("127.0.0.1:502", Connection.LOOPBACK),
        ("udp://127.0.0.1:19850", Connection.LOOPBACK),
        ("http://localhost:8000", Connection.LOOPBACK),
        ("[::1]:80", Connection.LOOPBACK),
        ("lo", Connection.LOOPBACK),
    ],
)
def test_a_port_is_a_kind_of_connection(port: str, connection: Connection) -> None:
    assert connection_of(port) is connection


def test_a_network_interface_is_recognised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (2, "eth7")])
    assert connection_of("eth7") is Connection.INTERFACE


@pytest.fixture
def terminal() -> Iterator[str]:
    controller, other = os.openpty()
    yield os.ttyname(other)
    os.close(controller)
    os.close(other)


def test_the_port_of_a_twin_is_no_real_robot(terminal: str, tmp_path: Path) -> None:
    link = tmp_path / "arm"
    link.symlink_to(terminal)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "s"))
        kinds = {connection_of(str(place)) for place in (link, tmp_path / "s")}
    assert kinds == {Connection.PSEUDO_TERMINAL, Connection.UNIX_SOCKET} <= ON_THIS_COMPUTER
    for kind in ON_THIS_COMPUTER:
        assert made(kind).peer is Peer.LOCAL
        with pytest.raises(BadReport, match=f"by a {kind} of the same computer, so it may be a twin"):
            require_real(made(kind))


def test_the_driver_of_another_package_makes_no_report() -> None:
    so101, koch = get_native_driver_class("so101"), get_native_driver_class("koch")
    assert so101 and koch
    assert is_reportable("so101", so101)
    assert not is_reportable("so101", koch)
    assert not is_reportable("so101", type("Mine", (so101,), {"__module__": "mine"}))


# -- read


def test_a_report_is_read_again() -> None:
    report = made(failed="link loss")
    assert parse(encode(report)) == report
    require_real(report)


def test_a_robot_without_policies_in_a_separate_process_has_four_steps() -> None:
    fields = json.loads(encode(made()))
    fields["steps"] = [step for step in fields["steps"] if step["step"] != "policy kill"]
    assert len(parse(json.dumps(fields).encode()).steps) == 4


def test_a_report_of_a_twin_says_so_and_does_not_count() -> None:
    report = parse(encode(made(Connection.TWIN)))
    assert report.peer is Peer.TWIN
    with pytest.raises(BadReport, match=r"made on a twin\. Only a drill on a real robot counts"):
        require_real(report)


def change(**fields: Any) -> Callable[[dict[str, Any]], None]:
    return lambda report: report.update(fields)


def step(number: int, **fields: Any) -> Callable[[dict[str, Any]], None]:
    return lambda report: report["steps"][number].update(fields)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (change(format="drill"), 'its "format" is not'),
        (change(format_version=2), "version 2 of the format, and 1 is known here"),
        (change(hostname="anna"), "unknown field `hostname`"),
        (step(0, detail="at 192.0.2.77"), "unknown field `detail`"),
        (change(steps="all"), "Expected `array`"),
        (lambda report: report.pop("computer"), "missing required field `computer`"),
        (change(peer="human"), "Invalid enum value 'human'"),
        (change(robot="their_arm"), "no driver for the robot 'their_arm'"),
        (change(driver="theirs:Arm"), "'theirs:Arm' is no driver of so101"),
        (change(robot="koch"), "is no driver of koch"),
        (change(wire="dynamixel"), "is no driver of so101"),
        (change(steps=[]), "its steps are missing"),
        (lambda report: report["steps"].reverse(), "its steps are link loss"),
        (lambda report: report["steps"].pop(), "its steps are stop, policy kill, wire kill, root freeze, and"),
        (lambda report: report["steps"].insert(0, report["steps"][0] | {"step": LOWERED}), "its steps are script"),
        (lambda report: report["steps"].extend([report["steps"][0] | {"step": LOWERED}] * 2), "kill, script kill"),
        (step(1, passed=False), '"passed" does not agree'),
        (step(1, confirmed_ms=-3.0), "policy kill has a time that is impossible"),
        (step(2, bound_ms=1e9), "wire kill has a time that is impossible"),
        (step(3, confirmed_ms=None), "root freeze was passed without a confirmation"),
        (change(firmware=["<script>"]), "a version of its firmware has characters"),
        (change(connection="twin"), '"peer" does not agree'),
        (change(peer="twin"), '"peer" does not agree'),
        (change(date="yesterday"), "its date is 'yesterday'"),
        (change(date="2999-01-01"), "2999-01-01 has not come yet"),
    ],
)
def test_a_garbled_or_foreign_report_is_refused_with_the_reason(
    damage: Callable[[dict[str, Any]], object], reason: str
) -> None:
    fields = json.loads(encode(made()))
    damage(fields)
    with pytest.raises(BadReport) as refused:
        parse(json.dumps(fields).encode())
    assert reason in str(refused.value)
    assert "Send the file that `strands-actors drill" in str(refused.value)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "it is no JSON"),
        (encode(made())[:-20], "from the first brace to the last"),
        (b"\xff\xfe", "it is no JSON"),
        (b"[]", "no drill report"),
        (b'{"passed": true}', "no drill report"),
        (b" " * (LARGEST_BYTES + 1), "bytes, so it is no drill report"),
    ],
    ids=["empty", "cut", "binary", "list", "another", "large"],
)
def test_a_file_of_another_kind_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(BadReport, match=reason):
        parse(data)


# -- the command


def test_the_command_shows_the_report_and_where_to_send_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = made(failed="stop")
    outcome = Outcome(results("stop"), None, None, report)
    path = tmp_path / "report.json"
    assert drill_report.write(outcome, path) == ""
    drill_report.show(outcome, path)
    shown = capsys.readouterr().out
    assert path.read_text() in shown and parse(path.read_bytes()) == report
    assert f'open an issue of the project with the form "{FORM}"' in shown
    assert f"name: {FORM}\n" in (ROOT / ".github" / "ISSUE_TEMPLATE" / "stop_drill.yml").read_text()


def test_the_report_of_a_twin_is_shown_as_one_that_must_not_be_sent(capsys: pytest.CaptureFixture[str]) -> None:
    drill_report.show(Outcome(results(), None, None, made(Connection.TWIN)), Path("report.json"))
    shown = capsys.readouterr().out
    assert "do not send it: it was made on a twin" in shown and "open an issue" not in shown


def test_a_file_that_cannot_be_written_is_refused_before_the_drill(tmp_path: Path) -> None:
    (tmp_path / "there.json").touch()
    for name, reason in (("there.json", "exists already"), ("no/such/report.json", "there is no folder")):
        with pytest.raises(Problem, match=reason):
            run("so101", None, True, True, [], False, tmp_path / name)
    problem = drill_report.write(Outcome(results(), None, None, made()), tmp_path)
    assert "cannot be written" in problem and "The drill itself is done" in problem


# -- the pages


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    report = made(failed="link loss")
    write(report, tmp_path / f"so101-{report.date}.json")
    write(msgspec.structs.replace(report, date="2026-01-31"), tmp_path / "so101-2026-01-31.json")
    write(made(Connection.NETWORK, "xarm7"), tmp_path / f"xarm7-{report.date}-2.json")
    return tmp_path


def test_the_page_and_the_robots_pages_show_the_reports(folder: Path) -> None:
    sent = pages.read(folder)
    assert [(each.report.robot, each.report.date > "2026-02") for each in sent] == [
        ("so101", True), ("so101", False), ("xarm7", True),
    ]  # fmt: skip
    page = pages.page(sent)
    assert "Reports: 3, of 2 robots. Drills that passed every step: 1." in page
    assert page.index("### so101") < page.index("2026-01-31: **failed: link loss**.") < page.index("### xarm7")
    assert "| stop | `limp` | 12.3 ms | 50 ms | ok |" in page
    assert "| link loss | `limp` | not confirmed | 50 ms | **failed** |" in page
    assert pages.EMPTY not in page
    assert pages.summary("so101", sent, "x.md").startswith("[2 drills](x.md#so101), 0 passed, last on 20")
    assert pages.summary("koch", sent, "x.md").startswith("not yet")
    assert "| link loss |" in "\n".join(pages.section("so101", sent, "x.md"))
    assert "Nothing yet." in "\n".join(pages.section("koch", sent, "x.md"))


@pytest.mark.parametrize(
    ("name", "report", "reason"),
    [
        ("koch-2026-01-31.json", made(), "koch-2026-01-31.json: a report of so101 of this day is so101-20"),
        ("so101.json", made(), "so101.json: a report of so101"),
        ("so101-2026-01-31.json", made(Connection.TWIN), "so101-2026-01-31.json: it was made on a twin"),
    ],
)
def test_a_report_that_does_not_count_gets_no_page(folder: Path, name: str, report: Report, reason: str) -> None:
    write(report, folder / name)
    with pytest.raises(BadReport, match=reason):
        pages.read(folder)


def test_the_page_is_made_from_the_reports() -> None:
    assert pages.PAGE.read_text() == pages.page(pages.reports()), "run python -m docs.site.reports"
