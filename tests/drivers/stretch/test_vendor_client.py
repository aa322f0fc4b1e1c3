"""Test the unmodified hello-robot-stretch-body 0.7.31 on the twin: each board by its class, and the whole robot."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors.testing import Twin

from .vendor import environment

pytestmark = pytest.mark.real_time

LAST = ("nice", "-n", "10")
"""The vendor's threads use both cores for seconds at a time. With this priority they get only what other tests
leave."""
PATIENCE_S = 120.0
Client = Callable[[str], dict[str, Any]]


@pytest.fixture(scope="module")
def python() -> Path:
    return environment()


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("stretch3", tmp_path) as process:
        yield process


@pytest.fixture
def client(twin: Twin, tmp_path: Path, python: Path) -> Client:
    """Return a function that runs one part of ``body_client`` and returns its results."""
    fleet = Path(twin.port).parent / "fleet"
    (robot,) = fleet.iterdir()

    def run(what: str) -> dict[str, Any]:
        done = subprocess.run(
            [*LAST, str(python), str(Path(__file__).parent / "body_client.py"), str(fleet), robot.name, what],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env={**os.environ, "HOME": str(tmp_path)},
        )
        assert done.returncode == 0, done.stderr[-2000:]
        seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return seen

    return run


@pytest.mark.long
def test_a_lift_is_moved(client: Client) -> None:
    seen = client("lift")
    assert seen["started"] and seen["homed"] and seen["mode"] == 5
    assert (seen["from"], seen["to"]) == (pytest.approx(0.5, abs=1e-3), pytest.approx(0.53, abs=3e-3))
    assert seen["board"]["protocol_version"] == "p5" and seen["board"]["stepper_type"] == "hello-motor-lift"


def test_an_arm_is_moved_by_steps(client: Client) -> None:
    seen = client("arm")
    assert seen["started"] and seen["to"] == pytest.approx(0.12, abs=3e-3)


def test_a_stepper_waits_for_its_pulse_and_reports_the_gains_in_its_flash(client: Client) -> None:
    seen = client("stepper")
    assert seen["started"] and seen["waited_for_sync"] and seen["mode"] == 2
    assert (seen["watchdog_in_flash"], seen["pKp_d"]) == (0, 6.0)
    assert seen["voltage"] == pytest.approx(12.0, abs=0.1)


def test_the_power_board_presses_the_runstop_and_releases_it(client: Client) -> None:
    seen = client("pimu")
    assert seen["started"] and seen["protocol"] == "p6"
    assert seen["runstop"] == [False, True, False]
    assert seen["voltage"] == pytest.approx(12.8, abs=0.1) and seen["az"] == pytest.approx(9.81, abs=0.01)


@pytest.mark.long
def test_a_base_drives_and_its_firmware_stops_it_without_commands(client: Client) -> None:
    seen = client("base")
    assert seen["started"] and seen["fastest"] == pytest.approx(0.1, abs=0.01) and seen["x"] > 0.05
    assert seen["left_alone"] == pytest.approx(0.0, abs=1e-3)


def test_the_wrists_board_is_read(client: Client) -> None:
    seen = client("wacc")
    assert seen["started"] and seen["az"] == pytest.approx(9.81, abs=0.01)


def test_a_head_turns(client: Client) -> None:
    seen = client("head")
    assert seen["started"] and seen["head_pan"] == pytest.approx(-0.4, abs=0.03)


def test_the_whole_robot_starts_is_homed_and_moves_at_one_pulse(client: Client) -> None:
    """It has all six boards and both chains. Its thread that looks for collisions ends, because it needs the
    robot's URDF."""
    seen = client("robot")
    assert seen["started"] and seen["homed"]
    assert seen["lift"] == pytest.approx(0.52, abs=3e-3) and seen["arm"] == pytest.approx(0.12, abs=5e-3)
    assert seen["voltage"] == pytest.approx(12.8, abs=0.1)


def test_the_vendors_routine_homes_an_arm_by_contact(client: Client, twin: Twin) -> None:
    """Before that the vendor's client refuses to move it, and the position is what the encoder has in one turn."""
    twin.power_cycle()
    seen = client("home_arm")
    assert seen["started"] and seen["homed"] == [False, True]
    assert seen["without_homing"] == pytest.approx(seen["from"], abs=1e-3) and 0 <= seen["from"] < 0.05
    assert seen["contacts"][0] == 0 < seen["contacts"][1] and "Hardstop detected" in seen["said"]
    assert seen["to"] == pytest.approx(0.1, abs=1e-3), "the end of the routine"


@pytest.mark.long
def test_the_vendors_routine_homes_the_whole_robot(client: Client, twin: Twin) -> None:
    twin.power_cycle()
    seen = client("home_robot")
    assert seen["started"] and seen["homed"] == [False, True]
    assert seen["lift"] == pytest.approx(0.6, abs=2e-3) and seen["arm"] == pytest.approx(0.1, abs=1e-3)
    assert seen["wrist_yaw"] == pytest.approx(0.0, abs=0.03)
    assert seen["stretch_gripper"] == pytest.approx(0.0, abs=1.0), "its fingertips just touch"
