"""``python -m tests lerobot`` chooses a Python for its environment. Small programs stand in for interpreters of
a version that no machine has."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from tests.lerobot.environments import PLUGIN, ROOT, VERSIONS, interpreter, main, split, version_of

RUNS, REFUSES = "echo 3.99", "echo 'python3.99: command not found' >&2; exit 127"


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    return tmp_path


def put(python: Path, does: str) -> str:
    python.parent.mkdir(parents=True, exist_ok=True)
    python.write_text(f"#!/bin/sh\n{does}\n")
    python.chmod(0o755)
    return str(python)


def test_a_shim_that_refuses_to_run_is_passed_over_for_the_newest_release_of_pyenv(machine: Path) -> None:
    put(machine / "path" / "python3.99", REFUSES)
    for release in ("3.99.2", "3.99.0rc1"):
        put(machine / "pyenv" / "versions" / release / "bin" / "python", RUNS)
    newest = put(machine / "pyenv" / "versions" / "3.99.10" / "bin" / "python", RUNS)
    assert interpreter("3.99") == newest


def test_a_working_python_on_the_path_is_chosen(machine: Path) -> None:
    on_path = put(machine / "path" / "python3.99", RUNS)
    put(machine / "pyenv" / "versions" / "3.99.2" / "bin" / "python", RUNS)
    assert interpreter("3.99") == on_path


def test_no_python_is_chosen_when_none_runs(machine: Path) -> None:
    put(machine / "path" / "python3.99", REFUSES)
    assert interpreter("3.99") is None


def test_any_version_of_lerobot_is_tried_by_one_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert split(["--lerobot", "0.7.0", "-x", "--lerobot=0.4.4"]) == (["0.7.0", "0.4.4"], ["-x"])
    newest = VERSIONS[-1]
    assert version_of("0.7.0") == ("0.7.0", newest.python, newest.extras)
    assert version_of(VERSIONS[0].lerobot) == VERSIONS[0]
    for wrong in (["--lerobot"], ["--lerobot="], ["--lerobot", "-x"]):
        assert main(wrong) == 2
        assert "which is no version. Give one, such as --lerobot 0.6.1" in capsys.readouterr().out


def test_the_declared_range_of_lerobot_is_that_of_the_versions_that_were_tried() -> None:
    tried = SpecifierSet(f">={VERSIONS[0].lerobot},<={VERSIONS[-1].lerobot}")
    plugin = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]["dependencies"]
    extra = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["lerobot"]
    declared = [Requirement(line).specifier for line in (*plugin, *extra) if Requirement(line).name == "lerobot"]
    assert declared == [tried, tried]
