"""SAF-018: an e-stop's lock outlives the tree it was put on. Read from the wire, and from who
asks."""

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
    """Connected, disarmed, and nothing gets through."""
    problem = arm.connect_eagerly() or ""
    assert BY in problem
    assert "resume()" in problem
    told = status(arm)
    assert (told["state"], told["connected"], told["locked_by"]) == ("disarmed", True, BY)
    assert told["locked_since"] and told["locked_since"] in problem
    assert BY in why(arm.send_action({"shoulder_pan": 5.0}))
    assert not twin.log.host("setpoint", since_ns)
    assert not twin.log.host("enable", since_ns)


def test_saf_018_a_script_that_is_started_again_finds_its_robot_locked(
    arm: RealRobot, twin: Twin, new_arm: NewArm
) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    press()
    arm.cleanup()
    since_ns = time.monotonic_ns()
    second = new_arm(port=twin.port)
    is_locked(second, twin, since_ns)
    json_of(second.resume())
    json_of(second.send_action({"shoulder_pan": 5.0}))
    second.cleanup()
    assert new_arm(port=twin.port).connect_eagerly() is None, "it was lifted for good"


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


def test_saf_018_another_robot_is_not(
    arm: RealRobot, new_arm: NewArm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    press()
    arm.cleanup()
    with Twin("so101", tmp_path_factory.mktemp("second")) as second:
        assert new_arm(port=second.port, tool_name="third").connect_eagerly() is None


def test_saf_018_a_lock_that_was_put_on_without_the_wire_outlives_the_tree(
    arm: RealRobot, twin: Twin, new_arm: NewArm
) -> None:
    """The wire was frozen: the root fenced it, and keeps the lock."""
    os.kill(pids(arm)["wire"], signal.SIGSTOP)
    (outcome,) = estop(by=BY, within_s=5.0)
    assert outcome.locked
    arm.cleanup()
    is_locked(new_arm(port=twin.port), twin, time.monotonic_ns())


def test_saf_018_the_root_dies_with_the_script_and_the_lock_stays(
    arm: RealRobot, twin: Twin, new_arm: NewArm
) -> None:
    press()
    known = pids(arm)
    for role in ("root", "wire"):
        os.kill(known[role], signal.SIGKILL)
    arm.cleanup()
    is_locked(new_arm(port=twin.port), twin, time.monotonic_ns())


def test_saf_018_a_lock_that_cannot_be_kept_stops_all_the_same_and_is_reported(
    twin: Twin, new_arm: NewArm, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(run_dir / "data"))
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    while not (run_dir / "data").is_file():  # the root, which writes there, may make it again meanwhile
        shutil.rmtree(run_dir / "data", ignore_errors=True)
        with contextlib.suppress(IsADirectoryError):
            (run_dir / "data").write_text("no directory can be made here")
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by=BY, within_s=5.0)
    assert outcome.outcome == "safe"
    assert outcome.note.startswith("the lock ends with this tree: ")
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
    """Whose root has a disk that takes its time."""

    def preload(self) -> None:
        super().preload()
        os.fsync = lambda fd: time.sleep(0.3)


@pytest.fixture
def slow_disk() -> Iterator[type[Driver]]:
    """Served as an so101, for this test."""
    before = get_native_driver_class("so101")
    assert before is not None
    yield SlowDisk
    register_native_driver("so101", before, overwrite=True)


def test_saf_018_a_tree_that_ends_keeps_its_lock_first(
    slow_disk: type[Driver], strands_robot: Callable[..., tuple[RealRobot, Twin]], strands_run_dir: Path
) -> None:
    arm, _ = strands_robot("so101", driver=slow_disk)
    with ThreadPoolExecutor() as thread:
        pressed = thread.submit(estop, by=BY, within_s=5.0)
        until(lambda: status(arm)["locked_by"], "it is locked")
        arm.cleanup()
        pressed.result()
    assert Locks(strands_run_dir / "data" / "locks", "so101").find() is not None
