"""A script that is process 1 of a container is told that its tree ends with it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from strands_actors.caller.processes import process_one
from strands_actors.surfaces.cli.doctor import OK, WEAK, check_process_one
from strands_actors.testing import Twin

from .conftest import NewArm


def test_the_first_tree_of_hardware_in_process_1_says_so_once(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a twin nothing is said: that ends with its script anyway."""
    process_one.warn_once.cache_clear()
    looked: list[int] = []

    def getpid() -> int:
        looked.append(1)
        return 1

    monkeypatch.setattr(process_one, "getpid", getpid)
    simulated = new_arm(transport="twin")
    assert simulated.connect_eagerly() is None
    simulated.cleanup()
    assert not looked
    for _ in range(2):
        arm = new_arm(port=twin.port)
        assert arm.connect_eagerly() is None
        arm.cleanup()
    process_one.warn_once.cache_clear()
    (said,) = [record.message for record in caplog.records if "process 1" in record.message]
    assert "nobody makes the robot safe" in said
    assert "sleep 5" in said
    assert looked == [1]


def test_another_script_is_told_nothing(twin: Twin, new_arm: NewArm, caplog: pytest.LogCaptureFixture) -> None:
    process_one.warn_once.cache_clear()
    assert os.getpid() != 1
    assert new_arm(port=twin.port).connect_eagerly() is None
    assert not [record for record in caplog.records if "process 1" in record.message]


@pytest.mark.parametrize(
    ("name", "state", "said"),
    [
        ("systemd", OK, "systemd"),
        ("sh", OK, "if that stays"),
        ("python3", WEAK, "kills a robot's tree with it"),
        ("docker-init", WEAK, "as soon as the script does"),
        ("tini", WEAK, "only a race is won"),
    ],
)
def test_doctor_says_what_process_1_is(
    name: str, state: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_one, "COMMAND", tmp_path / "comm")
    assert list(check_process_one()) == [], "a system that does not tell"
    (tmp_path / "comm").write_text(f"{name}\n")
    (check,) = check_process_one()
    assert (check.state, said in check.found) == (state, True), check
    assert ("wait $p" in check.remedy) == (state == WEAK)


def test_doctor_as_process_1_says_so_whatever_it_is_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "comm").write_text("strands-actors\n")
    monkeypatch.setattr(process_one, "COMMAND", tmp_path / "comm")
    monkeypatch.setattr(process_one, "getpid", lambda: 1)
    (check,) = check_process_one()
    assert check.state == WEAK
