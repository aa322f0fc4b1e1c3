"""Test the rover's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.earthrover.config import REPORT_OLD_S
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import armed, first_safe, robot_on, shared_twin

"""Added to the published bounds, for a busy machine."""


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("earthrover", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process) as process:
        yield process


@pytest.fixture
def rover(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(f"http://{twin.port}", "earthrover") as robot:
        yield robot


def command(entry: Entry) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(entry.data.partition(b"\r\n\r\n")[2])["command"]
    return found


def drive(rover: RealRobot, twin: Twin, **action: float) -> int:
    """Send an action and wait until it is on the wire. Return when it was sent."""
    armed(rover)
    began_ns = time.monotonic_ns()
    json_of(rover.send_action(action))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def test_saf_001_a_command_is_repeated_for_its_lifetime_and_ends_in_zero(rover: RealRobot, twin: Twin) -> None:
    began_ns = drive(rover, twin, linear=0.5, angular=-0.25)
    zero = first_safe(twin.log, began_ns)
    assert (zero.t_ns - began_ns) / 1e9 > 0.25
    sent = twin.log.host("setpoint", began_ns)
    assert 2 <= len(sent) <= 4, "the command is re-sent at 10 Hz for its lifetime"
    assert all(command(one) == {"linear": 0.5, "angular": -0.25, "lamp": 0} for one in sent)
    time.sleep(0.4)
    twin.log.no_setpoint_after_safe(began_ns)
    assert state(rover) == "holding"
    drive(rover, twin, linear=0.1)  # a late writer may go on


@pytest.mark.long
def test_saf_001_the_lamp_keeps_the_twist_and_does_not_prolong_it(rover: RealRobot, twin: Twin) -> None:
    began_ns = drive(rover, twin, linear=0.5)
    for lamp in (1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0):
        time.sleep(0.05)
        rover.send_action({"lamp": lamp})
    time.sleep(0.5)
    moving = [one for one in twin.log.host("setpoint", began_ns) if command(one)["linear"]]
    assert any(command(one)["lamp"] for one in moving), "the lamp went on while it drove"
    assert (moving[-1].t_ns - began_ns) / 1e9 <= 0.3 + 0.1
    assert command(twin.log.host("safe", began_ns)[-1])["lamp"] == 1, "a zero leaves the lamp as it is"


def test_saf_005_a_stop_is_repeated_until_a_newer_report_shows_speed_0(rover: RealRobot, twin: Twin) -> None:
    drive(rover, twin, linear=1.0)
    time.sleep(0.2)
    began_ns = time.monotonic_ns()
    stopped = json_of(rover.stop())
    assert stopped["safe_state"] == "zero" and list(stopped["motors"]) == ["linear", "angular", "lamp"]
    first_safe(twin.log, began_ns)
    assert len(twin.log.host("safe", began_ns)) >= 2
    twin.log.no_setpoint_after_safe(began_ns)
    assert status(rover)["sensors"]["speed"] == [0.0] or stopped["took_ms"] > 50
    assert "Call resume() first" in why(rover.send_action({"linear": 0.1}))
    json_of(rover.resume())
    assert twin.log.setpoints_after_safe(began_ns) == 0, "no setpoint is sent after the stop, not even by a resume"


@pytest.mark.long
def test_saf_005_a_rover_that_reports_a_speed_is_not_reported_as_stopped(rover: RealRobot, twin: Twin) -> None:
    drive(rover, twin, linear=0.5)
    twin.fault("wrong")
    until(lambda: status(rover)["sensors"]["speed"][0] > 0.5, "it reports too much")
    began_ns = time.monotonic_ns()
    said = why(rover.stop())
    assert "not confirmed: it reports speed" in said
    assert len(twin.log.host("safe", began_ns)) > 5, "zero is repeated"
    twin.fault("ok")
    until(lambda: state(rover) == "disarmed", "it is confirmed when it can be")


@pytest.mark.long
def test_saf_010_a_command_in_the_socket_of_a_stopped_service_is_followed_by_zero(
    rover: RealRobot, twin: Twin
) -> None:
    """The service is stopped with a command in its socket. The caller stops, then the service continues."""
    drive(rover, twin, linear=0.3)
    twin.pause()
    rover.send_action({"linear": 0.9})
    time.sleep(0.05)
    said = why(rover.stop())
    assert "not confirmed" in said
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: twin.log.host("safe", back_ns), "a zero")
    until(lambda: state(rover) == "disarmed", "it is back, disarmed, and confirmed")
    time.sleep(0.3)
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    late = [one for one in frames if one.kind == "setpoint"]
    assert len(late) <= 1, "at most one command was under way, and none follows"
    until(lambda: status(rover)["sensors"].get("speed") == [0.0], "it stands")


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_roots_own_connection_stops_the_rover(
    rover: RealRobot, twin: Twin, number: signal.Signals
) -> None:
    drive(rover, twin, linear=0.5)
    began_ns = time.monotonic_ns()
    os.kill(pids(rover)["wire"], number)
    first_safe(twin.log, began_ns)
    time.sleep(0.3)
    twin.log.no_setpoint_after_safe(began_ns)
    until(lambda: state(rover) == "disarmed", "a new wire, disarmed")


@pytest.mark.long
def test_saf_020_a_cable_that_is_back_carries_zero_first(rover: RealRobot, twin: Twin) -> None:
    drive(rover, twin, linear=0.5)
    twin.unplug()
    until(lambda: state(rover) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    first_safe(twin.log, back_ns)
    first = next(one for one in twin.log.entries(back_ns) if one.sender == "host")
    assert first.kind == "safe"
    until(lambda: state(rover) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)


@pytest.mark.long
@pytest.mark.parametrize("fault", ["garbage", "intermittent", "delayed", "slow"])
def test_saf_006_a_stop_is_sent_at_once_with_any_answer_of_the_service(
    rover: RealRobot, twin: Twin, fault: str
) -> None:
    drive(rover, twin, linear=0.5)
    twin.fault(fault)
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    rover.stop()
    first_safe(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(rover) == "disarmed", "confirmed at last")


@pytest.mark.long
def test_saf_012_a_service_that_repeats_its_last_report_is_sent_nothing(rover: RealRobot, twin: Twin) -> None:
    """The service answers, so no link is lost, but the rover is gone."""
    drive(rover, twin, linear=0.2)
    twin.fault("stuck")
    until(lambda: status(rover)["observation_age_s"] > REPORT_OLD_S, "its report is old")
    old_ns = time.monotonic_ns()
    assert status(rover)["connected"]
    assert "no position from linear" in why(rover.send_action({"linear": 0.2}))
    time.sleep(0.3)
    assert twin.log.host("setpoint", old_ns) == []
    twin.fault("ok")
    until(lambda: rover.send_action({"linear": 0.2})["status"] == "success", "it reports again")


def test_saf_003_neither_root_nor_stop_channel_loads_the_http_client(rover: RealRobot, twin: Twin) -> None:
    mapped = {role: Path(f"/proc/{pids(rover)[role]}/maps").read_text() for role in ("root", "wire")}
    assert all("zenoh" in text for text in mapped.values())
    script = (
        "from strands_actors.drivers.earthrover.driver import EarthRover\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        "driver = EarthRover('earthrover', '127.0.0.1', {})\n"
        "driver.preload()\n"
        "driver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "strands_actors.drivers.earthrover.stop" in loaded
    assert [name for name in ("httpx", "httpcore", "rich", "numpy") if name in loaded] == []


def test_speak_and_sensors(rover: RealRobot, twin: Twin) -> None:
    assert json_of(rover.speak(text="hello")) == {"spoken": "hello"}
    requested = asyncio.run(rover.use_tool({"action": "speak", "text": "by an agent"}, "test"))
    assert json_of(requested) == {"spoken": "by an agent"}
    assert "1..200 characters" in why(asyncio.run(rover.use_tool({"action": "speak", "text": ""}, "test")))
    sensors = status(rover)["sensors"]
    assert sensors["battery_pct"] == [88.0]
    assert sensors["latitude_longitude_deg"] == pytest.approx([22.75, 114.09], abs=0.01)
