"""Test a radio and a USB port, with a stand-in for pyusb in front of the twin. This was never run on hardware."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.processes.reserve import FILES
from strands_actors.testing import Twin
from strands_actors.testing.queueing import Queue
from tests.answers import alive, json_of, pids, state, until
from tests.kill.exhausted import Lacks, can_get_signals, take
from tests.trees import first_safe

STANDIN = str(Path(__file__).with_name("standin"))
READY_S = 1.0
"""A stop process that has its reserve is ready after this time."""
RADIO = "radio://0/80/2M/E7E7E7E7E7"


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("crazyflie", tmp_path) as process:
        yield process


@pytest.fixture
def events(tmp_path: Path, twin: Twin, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of the stand-in's events. The tree's processes find the stand-in in place of pyusb."""
    path = tmp_path / "usb"
    path.touch()
    config = {"twin": twin.port, "events": str(path), "devices": ["radio", "usb"]}
    monkeypatch.setenv("CRAZYFLIE_STANDIN", json.dumps(config))
    monkeypatch.syspath_prepend(STANDIN)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    return path


def noted(events: Path) -> list[tuple[str, object]]:
    return [(what, value) for what, value in map(json.loads, events.read_text().splitlines())]


def fly(robot: RealRobot) -> None:
    until(lambda: robot.connect_eagerly() is None, "it is connected")
    json_of(robot.takeoff(height=0.4, duration=1.0))
    for _ in range(10):
        json_of(robot.send_action({"vx": 0.2, "z": 0.4}))
        time.sleep(0.05)


@pytest.mark.long
@pytest.mark.parametrize("port", [RADIO, "usb://0"])
def test_it_flies_and_lands_over_usb(events: Path, twin: Twin, run_dir: Path, port: str) -> None:
    with Robot("crazyflie", mode="real", port=port) as robot:
        fly(robot)
        assert ("claimed", pids(robot)["wire"]) in noted(events), "only the wire process claims the radio"
        began_ns = time.monotonic_ns()
        stopped = json_of(robot.stop())
        assert (stopped["safe_state"], stopped["path"]) == ("land", "wire")
        until(lambda: twin.log.first_safe(began_ns), "a safe frame")
        twin.log.no_setpoint_after_safe(began_ns)
    settings = dict(noted(events))
    if port == RADIO:
        assert (settings["channel"], settings["rate"], settings["address"]) == (80, 2, "e7e7e7e7e7")
    else:
        assert settings["request 1"] == 1


@pytest.mark.long
def test_saf_003_when_the_wire_process_is_killed_another_process_lands_it_by_the_radio(
    events: Path, twin: Twin, run_dir: Path
) -> None:
    with Robot("crazyflie", mode="real", port=RADIO) as robot:
        fly(robot)
        root = pids(robot)["root"]
        began_ns = time.monotonic_ns()
        os.kill(pids(robot)["wire"], signal.SIGKILL)

        def landing() -> bool:
            return any(one.safe_state == "land" for one in twin.log.host("safe", began_ns))

        until(landing, "a landing")
        assert not twin.log.host("setpoint", began_ns + 100_000_000)
        until(lambda: state(robot) == "disarmed", "it is back, disarmed")
        claimed = [value for what, value in noted(events) if what == "claimed"]
        assert len(set(claimed)) >= 3 and root not in claimed, (
            "three processes claim it in turn: wire, stop process, next wire"
        )


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("stop_fault", "wire_fault"),
    [(signal.SIGSTOP, signal.SIGKILL), (signal.SIGKILL, signal.SIGKILL), (signal.SIGSTOP, signal.SIGSTOP)],
)
def test_saf_016_a_stop_process_and_the_wire_break_and_the_other_one_lands_it(
    events: Path, twin: Twin, run_dir: Path, stop_fault: signal.Signals, wire_fault: signal.Signals
) -> None:
    """This holds for either of the two stop processes. The second one acts without waiting for a new process."""
    with Robot("crazyflie", mode="real", port=RADIO) as robot:
        fly(robot)
        processes = pids(robot)
        ready = {processes["root/stop"], processes["root/stop/2"]}
        assert {"standby/stop", "standby/stop/2", "spawner"} <= processes.keys()
        broken, other = sorted(ready)
        began_ns = time.monotonic_ns()
        os.kill(broken, stop_fault)
        os.kill(processes["wire"], wire_fault)
        until(lambda: any(one.safe_state == "land" for one in twin.log.host("safe", began_ns)), "a landing")
        claimed = {value for what, value in noted(events) if what == "claimed"}
        assert claimed == {processes["wire"], other}, "only the wire and the other stop process claim it"
        until(lambda: not Path(f"/proc/{broken}").exists(), "a frozen one is ended")
        until(lambda: state(robot) == "disarmed", "it is back, disarmed")
        twin.log.no_setpoint_after_safe(began_ns)


def stop_processes(robot: RealRobot, parent: str) -> set[int]:
    return {pid for role, pid in pids(robot).items() if role.startswith(f"{parent}/stop")}


def first_and_second(robot: RealRobot, parent: str) -> tuple[int, int]:
    """Return the stop process of ``parent`` that gets an order first, and the other one.

    One of the two is killed and replaced. The other one is then the first.
    """
    lost, first = stop_processes(robot, parent)
    os.kill(lost, signal.SIGKILL)
    (second,) = until(lambda: stop_processes(robot, parent) - {lost, first}, "another stop process")
    until(lambda: len(os.listdir(f"/proc/{second}/fd")) > FILES, "it has its reserve")
    time.sleep(READY_S)
    return first, second


@pytest.mark.long
@pytest.mark.parametrize("lacks", [Lacks.FILES, Lacks.TABLE])
@pytest.mark.parametrize("killed", [("wire",), ("root", "wire")], ids="+".join)
def test_saf_024_a_stop_process_has_no_free_file_and_the_other_one_lands_it(
    events: Path,
    twin: Twin,
    run_dir: Path,
    killed: tuple[str, ...],
    lacks: Lacks,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The exhausted process gets the order. The standby gives it when the root is gone."""
    with can_get_signals(), Robot("crazyflie", mode="real", port=RADIO) as robot:
        until(lambda: robot.connect_eagerly() is None, "it is connected")
        first, second = first_and_second(robot, "standby" if "root" in killed else "root")
        fly(robot)
        processes = pids(robot)
        take(lacks, first)
        queue = Queue([*processes.values(), twin.process.pid, os.getpid()])
        killed_ns = time.monotonic_ns()
        # Suspend both first. Otherwise the wire process may land it in the moment between the two kills.
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for role in killed:
                os.kill(processes[role], number)
        landing = first_safe(twin.log, killed_ns, "land")
        waited_ms = queue.waited_ms()
        assert (landing.t_ns - killed_ns) / 1e6 - waited_ms <= robot.driver.bound_s * 1e3
        claimed = {value for what, value in noted(events) if what == "claimed"}
        assert claimed == {processes["wire"], second}, "the exhausted process cannot claim it"
        assert f"process {first} ended in a stop: no file can be opened" in capfd.readouterr().err
        twin.log.no_setpoint_after_safe(killed_ns)


@pytest.mark.long
@pytest.mark.parametrize("lacks", [Lacks.FILES, Lacks.TABLE])
def test_saf_024_root_and_its_stop_processes_have_no_free_file_and_the_standby_lands_it(
    events: Path, twin: Twin, run_dir: Path, lacks: Lacks
) -> None:
    """The root cannot start another stop process either, so it ends."""
    with can_get_signals(), Robot("crazyflie", mode="real", port=RADIO) as robot:
        fly(robot)
        processes = pids(robot)
        of_standby = stop_processes(robot, "standby")
        for pid in (processes["root"], *stop_processes(robot, "root")):
            take(lacks, pid)
        queue = Queue([*processes.values(), twin.process.pid, os.getpid()])
        killed_ns = time.monotonic_ns()
        os.kill(processes["wire"], signal.SIGKILL)
        landing = first_safe(twin.log, killed_ns, "land")
        waited_ms = queue.waited_ms()
        assert (landing.t_ns - killed_ns) / 1e6 - waited_ms <= 2 * robot.driver.bound_s * 1e3
        claimed = {value for what, value in noted(events) if what == "claimed"}
        assert len(claimed & of_standby) == 1 and claimed - of_standby == {processes["wire"]}
        until(lambda: not alive(processes["root"]), "the root has ended")
        twin.log.no_setpoint_after_safe(killed_ns)


@pytest.mark.long
def test_an_unplugged_dongle_is_noticed(events: Path, twin: Twin, run_dir: Path) -> None:
    with Robot("crazyflie", mode="real", port=RADIO) as robot:
        fly(robot)
        gone = Path(f"{events}.unplugged")
        gone.touch()
        until(lambda: state(robot) in ("lost", None), "it is noticed")
        gone.unlink()
        until(lambda: state(robot) == "disarmed", "it is back, disarmed")


def test_without_pyusb_the_line_that_installs_it_is_named(run_dir: Path) -> None:
    hidden = "import sys; sys.modules['usb'] = sys.modules['usb.core'] = None\n"
    script = hidden + (
        "import trio\n"
        "from strands_actors.contract.wire import WireDown\n"
        "from strands_actors.drivers.crazyflie.config import parse_port\n"
        "from strands_actors.drivers.crazyflie.usb_links import open_usb_link\n"
        "try:\n"
        f"    trio.run(open_usb_link, parse_port({RADIO!r}))\n"
        "except WireDown as down:\n"
        "    print(down)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "pip install 'strands-actors[crazyflie]'" in done.stdout


def test_neither_the_root_nor_a_udp_drone_loads_pyusb() -> None:
    script = (
        "from strands_actors.drivers.crazyflie.driver import Crazyflie\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        f"driver = Crazyflie('crazyflie', {RADIO!r}, {{}})\n"
        "driver.preload(); driver.preload_wire()\n"
        "driver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "strands_actors.drivers.crazyflie.stop_channel" in loaded
    assert [name for name in ("usb", "numpy", "mujoco") if name in loaded] == []
