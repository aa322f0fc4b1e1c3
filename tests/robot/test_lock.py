"""SAF-018: the lock of an e-stop outlives its tree. The tests read the simulated robot's wire log and the
answers of the verbs.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, register_native_driver
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.supervisors.root.locks import Locks
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from tests.answers import json_of, pids, status, until, why

from .conftest import NewArm
from .helpers import limps

BY = "the red button"


def press() -> None:
    (outcome,) = estop(by=BY, within_s=5.0)
    assert (outcome.outcome, outcome.locked, outcome.note) == ("safe", True, "")


def is_locked(arm: RealRobot, twin: Twin, since_ns: int) -> None:
    """Check that the robot is connected and disarmed, and that it refuses commands."""
    problem = arm.connect_eagerly() or ""
    assert BY in problem
    assert "resume()" in problem
    reported = status(arm)
    assert (reported["state"], reported["connected"], reported["locked_by"]) == ("disarmed", True, BY)
    assert reported["locked_since"] and reported["locked_since"] in problem
    assert BY in why(arm.send_action({"shoulder_pan": 5.0}))
    assert not twin.log.host("setpoint", since_ns)
    assert not twin.log.host("enable", since_ns)


def test_saf_018_a_restarted_script_finds_its_robot_locked(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    press()
    arm.cleanup()
    since_ns = time.monotonic_ns()
    second = new_arm(port=twin.port)
    is_locked(second, twin, since_ns)
    json_of(second.resume())
    json_of(second.send_action({"shoulder_pan": 5.0}))
    second.cleanup()
    assert new_arm(port=twin.port).connect_eagerly() is None, "the lock was lifted for later trees too"


def test_saf_018_another_name_on_the_port_is_locked_too(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    press()
    arm.cleanup()
    is_locked(new_arm(port=twin.port, tool_name="third"), twin, time.monotonic_ns())


def test_saf_018_the_name_on_another_port_is_locked_too(
    arm: RealRobot, new_arm: NewArm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    press()
    arm.cleanup()
    with Twin("so101", tmp_path_factory.mktemp("second")) as second:
        is_locked(new_arm(port=second.port), second, 0)


def test_saf_018_a_robot_of_another_name_on_another_port_is_not_locked(
    arm: RealRobot, new_arm: NewArm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    press()
    arm.cleanup()
    with Twin("so101", tmp_path_factory.mktemp("second")) as second:
        assert new_arm(port=second.port, tool_name="third").connect_eagerly() is None


def test_saf_018_a_lock_by_the_root_outlives_the_tree(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    """The wire was frozen, so the root fenced it and wrote the lock."""
    os.kill(pids(arm)["wire"], signal.SIGSTOP)
    (outcome,) = estop(by=BY, within_s=5.0)
    assert outcome.locked
    arm.cleanup()
    is_locked(new_arm(port=twin.port), twin, time.monotonic_ns())


def test_saf_018_the_root_dies_with_the_script_and_the_lock_stays(
    arm: RealRobot, twin: Twin, new_arm: NewArm
) -> None:
    press()
    processes = pids(arm)
    for role in ("root", "wire"):
        os.kill(processes[role], signal.SIGKILL)
    arm.cleanup()
    is_locked(new_arm(port=twin.port), twin, time.monotonic_ns())


def test_saf_018_an_estop_whose_lock_cannot_be_written_still_stops_and_reports_it(
    twin: Twin, new_arm: NewArm, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(run_dir / "data"))
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    while not (run_dir / "data").is_file():  # the root writes there, and may create the folder again meanwhile
        shutil.rmtree(run_dir / "data", ignore_errors=True)
        with contextlib.suppress(IsADirectoryError):
            (run_dir / "data").write_text("no directory can be made here")
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by=BY, within_s=5.0)
    assert outcome.outcome == "safe"
    assert outcome.note.startswith("the lock is lost when the robot's processes end: ")
    assert limps(twin.log, began_ns)
    assert BY in why(arm.send_action({"shoulder_pan": 5.0}))


def test_saf_018_a_simulation_is_locked_by_its_name(new_arm: NewArm) -> None:
    first = new_arm(transport="twin")
    assert first.connect_eagerly() is None
    press()
    first.cleanup()
    second = new_arm(transport="twin")
    assert BY in (second.connect_eagerly() or "")
    json_of(second.resume())
    until(lambda: status(second)["state"] == "armed", "armed")


class SlowDisk(Feetech):
    """A driver whose root has a slow disk."""

    def preload(self) -> None:
        super().preload()
        os.fsync = lambda fd: time.sleep(0.3)


@pytest.fixture
def slow_disk() -> Iterator[type[Driver]]:
    """Register the slow driver as so101 during this test."""
    before = get_native_driver_class("so101")
    assert before is not None
    yield SlowDisk
    register_native_driver("so101", before, overwrite=True)


def test_saf_018_a_tree_writes_its_lock_before_it_ends(
    slow_disk: type[Driver], strands_robot: Callable[..., tuple[RealRobot, Twin]], strands_run_dir: Path
) -> None:
    arm, _ = strands_robot("so101", driver=slow_disk)
    with ThreadPoolExecutor() as thread:
        pressed = thread.submit(estop, by=BY, within_s=5.0)
        until(lambda: status(arm)["locked_by"], "the robot is locked")
        arm.cleanup()
        pressed.result()
    assert Locks(strands_run_dir / "data" / "locks", "so101").find() is not None
