"""Test ``doctor``: it reports defects with their remedies. It fails only on what every robot needs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from strands_actors.kernel.health import busy
from strands_actors.surfaces.cli.doctor import (
    BROKEN,
    NOTE,
    OK,
    WEAK,
    Check,
    _show,
    check_directory,
    check_drivers,
    check_extras,
    check_load,
    check_python,
    examine,
)
from strands_actors.surfaces.cli.packages import missing_requirements
from tests.cli.command import Command


def found(checks: list[Check], name: str) -> list[Check]:
    return [check for check in checks if check.name == name]


def test_a_machine_on_which_the_tests_run_is_healthy(cli: Command) -> None:
    done = cli.json("doctor")
    assert done["ok"] is True
    names = {check["name"] for check in done["checks"]}
    needed = {"python", "timerfd", "pidfd", "scheduling", "directory", "zenoh", "gl", "drivers", "robots"}
    assert needed | {"load"} <= names
    for check in done["checks"]:
        assert list(check) == ["name", "state", "found", "remedy"]
        assert check["state"] in (OK, NOTE, WEAK), check
        assert check["state"] != WEAK or not check["name"].startswith("extra"), check
        assert bool(check["remedy"]) == (check["state"] != OK), check
    printed = cli.run("doctor")
    assert printed.returncode == 0
    assert "everything a robot needs is here" in printed.stdout or "this computer is busy" in printed.stdout


def test_a_directory_open_to_others_is_a_defect_and_sets_the_exit_code(cli: Command, tmp_path: Path) -> None:
    os.chmod(tmp_path, 0o777)
    cli.environment["STRANDS_ACTORS_RUN"] = str(tmp_path)
    done = cli.run("doctor")
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if "directory" in line and "broken" in line]
    assert "open to others" in line
    assert "remedy: set STRANDS_ACTORS_RUN" in done.stdout
    os.chmod(tmp_path, 0o700)
    cli.environment["STRANDS_ACTORS_RUN"] = str(tmp_path)
    cli.wait_until_gone()


def test_a_computer_that_has_no_time_for_a_robot_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with busy.assumed(busy.Machine(20.0, 2)):
        (check,) = check_load()
        _show([check])
    assert (check.state, check.text) == (WEAK, "this computer is busy: load 20 on 2 cores")
    assert "close other programs" in check.remedy
    shown = capsys.readouterr().out
    assert "everything a robot needs is here" not in shown and "this computer is too busy now" in shown
    with busy.assumed(busy.IDLE):
        (check,) = check_load()
    assert (check.state, check.text, check.remedy) == (OK, "load 0 on 2 cores", "")


def test_a_directory_with_a_long_name_is_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(tmp_path / ("x" * 80)))
    (check,) = check_directory()
    assert check.state == BROKEN
    assert "shorter path" in check.remedy


def test_a_python_that_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.version_info", (3, 9, 1))
    (check,) = check_python()
    assert (check.state, "3.11 to 3.14" in check.remedy) == (BROKEN, True)


def test_a_third_party_driver_that_breaks_is_weak_and_one_of_ours_is_broken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from strands_actors import drivers

    drivers.list_native_drivers()
    why = {"theirs": "ImportError: no sdk", "feetech": "ImportError: no pyserial"}
    if hasattr(drivers, "broken_drivers"):
        monkeypatch.setattr(drivers, "broken_drivers", lambda: why)
    else:
        monkeypatch.setattr(drivers, "broken", why)
    ours, theirs = found(list(check_drivers()), "driver")
    assert (ours.state, theirs.state) == (BROKEN, WEAK)
    assert "feetech" in ours.text
    assert "no sdk" in theirs.text


def test_a_part_that_cannot_be_examined_is_a_finding_not_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    def explode() -> None:
        raise OSError("no such bus")

    monkeypatch.setattr("serial.tools.list_ports.comports", explode)
    (check,) = found(list(examine()), "serial")
    assert (check.state, check.text) == (BROKEN, "OSError: no such bus")


def test_a_missing_extra_is_a_note_of_one_line_with_its_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    requirements = ["trio>=0.30", "no-such-package-1; extra == 'spot'", "no-such-package-2; extra == 'docs'"]
    monkeypatch.setattr("strands_actors.surfaces.cli.doctor.metadata.requires", lambda _: requirements)
    checks = list(check_extras())
    assert [(check.name, check.state) for check in checks] == [("packages", OK), ("extra spot", NOTE)]
    assert checks[1].as_json()["remedy"] == "pip install 'strands-actors[spot]'"
    _show(checks)
    lines = capsys.readouterr().out.splitlines()
    assert " ".join(lines[1].split()) == "note extra spot not installed: pip install 'strands-actors[spot]'"
    assert lines[2:] == ["everything a robot needs is here"]


def test_a_missing_package_that_every_robot_needs_is_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strands_actors.surfaces.cli.doctor.metadata.requires", lambda _: ["no-such-package-1"])
    (check,) = check_extras()
    assert (check.state, check.text) == (BROKEN, "missing: no-such-package-1")


def test_missing_requirements_are_listed_by_extra() -> None:
    requirements = [
        "trio>=0.30",
        "no-such-package-1",
        "no-such-package-2; extra == 'spot'",
        "msgspec; extra == 'agent'",
        "no-such-package-3; python_version < '3.0'",
        "no-such-package-4; python_version < '3.0' and extra == 'agent'",
        "no-such-package-5; extra == 'test'",
        "no-such-package-7; extra == 'bench'",
        f"no-such-package-6; platform_machine != '{os.uname().machine}' and extra == 'agent'",
        "strands-actors[agent]; extra == 'all'",
    ]
    assert missing_requirements(requirements) == {
        "": ["no-such-package-1"],
        "spot": ["no-such-package-2"],
        "agent": [],
    }
