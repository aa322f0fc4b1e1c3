"""SAF-016: root and wire fail almost together, and the standby makes the robot safe.

Processes and wires are real. One robot has a serial port, whose descriptor the standby inherits.
The other is on a network, where the standby opens a new connection.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.supervisors.standby.report import LOCK, REPORT, StandbyReport, holder, read
from strands_actors.testing import Twin
from tests.answers import alive, pids, resumed, status, until, why

Start = Callable[..., tuple[RealRobot, Twin]]

MOVES = {"so101": "shoulder_pan", "robotiq_2f85": "grip"}
SAFE = {"so101": "limp", "robotiq_2f85": "hold"}
KILL, FREEZE = signal.SIGKILL, signal.SIGSTOP
PAIRS = [(KILL, KILL), (KILL, FREEZE), (FREEZE, KILL), (FREEZE, FREEZE)]
SETTLE_S = 0.5


@pytest.fixture
def moving(strands_robot: Start) -> Iterator[Callable[[str], tuple[RealRobot, Twin, dict[str, int]]]]:
    """Start an armed robot with a command in force, and return it with its processes. The processes
    are killed afterwards."""
    started: list[int] = []

    def start(kind: str) -> tuple[RealRobot, Twin, dict[str, int]]:
        arm, twin = strands_robot(kind)
        seen: dict[str, float] = arm.get_observation()
        joint, here = next(iter(seen.items()))
        assert arm.send_action({joint: here + 0.05})["status"] == "success"
        processes = pids(arm)
        started.extend(processes[role] for role in ("root", "wire", "standby"))
        return arm, twin, processes

    yield start
    for pid in started:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, KILL)


def report_of(strands_run_dir: Path, robot: str) -> StandbyReport:
    """Wait for the final report of the standby."""
    path = strands_run_dir / f"{robot}{REPORT}"
    return until(
        lambda: report if (report := read(path)) is not None and report.over else None, "the standby reports"
    )


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: "-".join(number.name for number in pair))
@pytest.mark.parametrize("kind", MOVES)
def test_saf_016_root_and_wire_break_and_the_standby_makes_safe(
    moving: Callable[[str], Any], strands_run_dir: Path, kind: str, pair: tuple[signal.Signals, signal.Signals]
) -> None:
    _, twin, processes = moving(kind)
    broken_ns = time.monotonic_ns()
    os.kill(processes["root"], pair[0])
    os.kill(processes["wire"], pair[1])
    safe = until(lambda: twin.log.first_safe(broken_ns), "a safe frame")
    assert safe.safe_state == SAFE[kind]
    report = report_of(strands_run_dir, kind)
    assert report.confirmed and report.pid == processes["standby"], report
    until(lambda: not alive(processes["standby"]), "the standby ends")
    for role in ("root", "wire"):
        assert not alive(processes[role]), f"{role} was fenced, or had ended"
        with contextlib.suppress(ProcessLookupError):
            os.kill(processes[role], signal.SIGCONT)
    # The absence of a setpoint has no event to wait for.
    time.sleep(SETTLE_S)
    twin.log.no_setpoint_after_safe(broken_ns)
    assert holder(strands_run_dir / f"{kind}{LOCK}") is None


def test_saf_016_a_wire_that_dies_before_it_has_made_safe_leaves_the_standby(
    moving: Callable[[str], Any], strands_run_dir: Path
) -> None:
    """The root is killed and one servo is mute, so the wire process keeps trying. The standby waits
    until the wire process has ended."""
    _, twin, processes = moving("so101")
    twin.fault("garbage:5")
    time.sleep(0.1)
    killed_ns = time.monotonic_ns()
    os.kill(processes["root"], KILL)
    until(lambda: twin.log.first_safe(killed_ns), "the wire makes safe")
    time.sleep(2.5)
    assert alive(processes["wire"]) and alive(processes["standby"])
    assert not (strands_run_dir / f"so101{REPORT}").exists()
    second_ns = time.monotonic_ns()
    os.kill(processes["wire"], KILL)
    until(lambda: twin.log.first_safe(second_ns), "the standby makes safe")
    until(lambda: (strands_run_dir / f"so101{REPORT}").exists(), "the standby reports")
    twin.fault("ok")
    assert report_of(strands_run_dir, "so101").confirmed
    twin.log.no_setpoint_after_safe(killed_ns)


def test_saf_016_a_wire_that_makes_safe_by_itself_needs_no_standby(
    moving: Callable[[str], Any], strands_run_dir: Path
) -> None:
    _, twin, processes = moving("so101")
    killed_ns = time.monotonic_ns()
    os.kill(processes["root"], KILL)
    until(lambda: not alive(processes["wire"]), "the wire ends")
    until(lambda: not alive(processes["standby"]), "the standby ends")
    assert not (strands_run_dir / f"so101{REPORT}").exists()
    last = [entry for entry in twin.log.entries(killed_ns) if entry.sender == "host"][-1]
    time.sleep(SETTLE_S)
    twin.log.silent_after(last.t_ns + 1)
    twin.log.no_setpoint_after_safe(killed_ns)


def test_saf_016_a_tree_that_ends_leaves_no_standby_and_no_report(
    strands_robot: Start, strands_run_dir: Path
) -> None:
    arm, twin = strands_robot("so101")
    standby = pids(arm)["standby"]
    assert arm.cleanup()["status"] == "success"
    assert not alive(standby)
    ended_ns = time.monotonic_ns()
    time.sleep(SETTLE_S)
    twin.log.silent_after(ended_ns)
    assert not (strands_run_dir / f"so101{REPORT}").exists()


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize("how", [KILL, FREEZE], ids=lambda how: how.name)
def test_saf_016_a_killed_or_frozen_standby_is_replaced_and_motion_goes_on(
    moving: Callable[[str], Any], kind: str, how: signal.Signals
) -> None:
    arm, twin, before = moving(kind)
    began_ns = time.monotonic_ns()
    os.kill(before["standby"], how)
    now = until(
        lambda: seen if (seen := pids(arm)).get("standby", 0) not in (0, before["standby"]) else None,
        "a new standby",
    )
    until(lambda: status(arm)["standby"] == "ready", "the standby is ready")
    assert {role: now[role] for role in ("root", "wire")} == {role: before[role] for role in ("root", "wire")}
    assert twin.log.first_safe(began_ns) is None, "the robot still moves"
    broken_ns = time.monotonic_ns()
    os.kill(now["root"], KILL)
    os.kill(now["wire"], KILL)
    safe = until(lambda: twin.log.first_safe(broken_ns), "the new standby makes safe")
    assert safe.safe_state == SAFE[kind]
    twin.log.no_setpoint_after_safe(broken_ns)


def test_saf_016_without_a_standby_nothing_is_armed(moving: Callable[[str], Any]) -> None:
    """The spawner would start another standby. It is frozen, so for a second there is no standby."""
    arm, twin, processes = moving("so101")
    assert arm.stop()["status"] == "success"
    os.kill(processes["spawner"], FREEZE)
    os.kill(processes["standby"], KILL)
    until(lambda: status(arm)["standby"] != "ready", "the missing standby is reported")
    requested_ns = time.monotonic_ns()
    refused = why(arm.resume())
    assert "a process that could stop the robot is missing" in refused and "Try again" in refused
    assert twin.log.host("enable", requested_ns) == []
    resumed(arm)
    assert twin.log.host("enable", requested_ns)


def test_saf_016_the_standby_is_gone_and_then_the_root(moving: Callable[[str], Any], strands_run_dir: Path) -> None:
    """Only the wire process is left, and it makes the robot safe."""
    _, twin, processes = moving("so101")
    broken_ns = time.monotonic_ns()
    os.kill(processes["standby"], KILL)
    os.kill(processes["root"], KILL)
    until(lambda: not alive(processes["wire"]), "the wire ends")
    safe = twin.log.first_safe(broken_ns)
    assert safe is not None and safe.safe_state == "limp"
    twin.log.no_setpoint_after_safe(broken_ns)
    assert not (strands_run_dir / f"so101{REPORT}").exists()


def test_saf_016_the_next_robot_reports_what_the_standby_did(
    moving: Callable[[str], Any], strands_run_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    arm, _, processes = moving("so101")
    os.kill(processes["root"], FREEZE)
    os.kill(processes["wire"], KILL)
    report_of(strands_run_dir, "so101")
    until(lambda: not alive(processes["standby"]), "the standby ends")
    assert arm.resume()["status"] == "success"
    report = status(arm)["standby_report"]
    assert "the root was ended" in report and "the wire had ended" in report and "every motor confirmed" in report
    assert report in caplog.text
    assert not (strands_run_dir / f"so101{REPORT}").exists(), "the report is given once"


def test_saf_016_a_frozen_standby_of_an_earlier_tree_is_ended_and_writes_nothing(
    moving: Callable[[str], Any], strands_run_dir: Path
) -> None:
    """If it continued later, it could write to the robot of the next tree."""
    arm, twin, processes = moving("so101")
    os.kill(processes["standby"], FREEZE)
    os.kill(processes["root"], KILL)
    until(lambda: not alive(processes["wire"]), "the wire makes safe, and ends")
    assert holder(strands_run_dir / f"so101{LOCK}") is not None
    assert arm.resume()["status"] == "success"
    assert not alive(processes["standby"])
    resumed_ns = time.monotonic_ns()
    with contextlib.suppress(ProcessLookupError):
        os.kill(processes["standby"], signal.SIGCONT)
    time.sleep(SETTLE_S)
    assert twin.log.first_safe(resumed_ns) is None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda number: number.name)
def test_saf_016_signals_that_end_the_others_do_not_end_the_standby(
    moving: Callable[[str], Any], strands_run_dir: Path, number: signal.Signals
) -> None:
    """``pkill -f strands`` ends root and wire process. The standby survives and makes the robot safe."""
    _, twin, processes = moving("so101")
    assert os.getsid(processes["standby"]) == processes["standby"]
    broken_ns = time.monotonic_ns()
    for role in ("standby", "root", "wire"):
        os.kill(processes[role], number)
    until(lambda: twin.log.first_safe(broken_ns), "a safe frame")
    until(lambda: not alive(processes["standby"]), "the standby ends")
    twin.log.no_setpoint_after_safe(broken_ns)


def test_processes_have_their_own_names(moving: Callable[[str], Any]) -> None:
    """``pkill python`` is meant for scripts and must not match a robot's processes.

    ``pkill`` compares with ``comm``, ``pkill -f`` with ``cmdline``.
    """
    _, _, processes = moving("so101")
    for role in ("root", "wire", "standby"):
        assert Path(f"/proc/{processes[role]}/comm").read_text().strip() == f"strands-{role}"[:15]
        words = Path(f"/proc/{processes[role]}/cmdline").read_bytes().split(b"\0")
        assert words[0].decode() == f"strands-actors so101 {role}"
        assert not any(b"python" in word for word in words)
