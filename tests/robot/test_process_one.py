"""A script that is process 1 of a container gets a warning that its tree ends with it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from strands_actors.caller.processes import process_one
from strands_actors.surfaces.cli.doctor import OK, WEAK, check_process_one
from strands_actors.testing import Twin

from .conftest import NewArm


def test_the_first_tree_of_hardware_in_process_1_warns_once(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """There is no warning for a twin, which ends with its script in any case."""
    process_one.warn_once.cache_clear()
    looks: list[int] = []

    def getpid() -> int:
        looks.append(1)
        return 1

    monkeypatch.setattr(process_one, "getpid", getpid)
    simulated = new_arm(transport="twin")
    assert simulated.connect_eagerly() is None
    simulated.cleanup()
    assert not looks
    for _ in range(2):
        arm = new_arm(port=twin.port)
        assert arm.connect_eagerly() is None
        arm.cleanup()
    process_one.warn_once.cache_clear()
    (warning,) = [record.message for record in caplog.records if "process 1" in record.message]
    assert "nobody makes the robot safe" in warning
    assert "sleep 5" in warning
    assert looks == [1]


def test_a_script_in_another_process_gets_no_warning(
    twin: Twin, new_arm: NewArm, caplog: pytest.LogCaptureFixture
) -> None:
    process_one.warn_once.cache_clear()
    assert os.getpid() != 1
    assert new_arm(port=twin.port).connect_eagerly() is None
    assert not [record for record in caplog.records if "process 1" in record.message]


@pytest.mark.parametrize(
    ("name", "state", "text"),
    [
        ("systemd", OK, "systemd"),
        ("sh", OK, "as long as process 1 runs"),
        ("python3", WEAK, "kills a robot's tree with it"),
        ("docker-init", WEAK, "as soon as the script does"),
        ("tini", WEAK, "only a race is won"),
    ],
)
def test_doctor_describes_process_1(
    name: str, state: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_one, "COMMAND", tmp_path / "comm")
    assert list(check_process_one()) == [], "a system without the name of process 1"
    (tmp_path / "comm").write_text(f"{name}\n")
    (check,) = check_process_one()
    assert (check.state, text in check.text) == (state, True), check
    assert ("wait $p" in check.remedy) == (state == WEAK)


def test_doctor_as_process_1_warns_for_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "comm").write_text("strands-actors\n")
    monkeypatch.setattr(process_one, "COMMAND", tmp_path / "comm")
    monkeypatch.setattr(process_one, "getpid", lambda: 1)
    (check,) = check_process_one()
    assert check.state == WEAK
