"""Tests that a machine cannot run are left out and listed by name. They are never skipped silently."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.machines import why_not

from .test_imports import ROOT

PATIENCE_S = 240.0
"""Timeout. A run takes a second on a free machine."""

TESTS = """
import pytest

@pytest.mark.needs("Node.js")
def test_the_page():
    raise AssertionError("run all the same")

def test_the_rest():
    pass

@pytest.mark.long_beside("Node.js")
def test_a_quick_form():
    pass
"""


def run(path: Path, *arguments: str) -> str:
    """Return the output of pytest on a machine without any external program."""
    path.write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.machines", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(path.parent), *arguments, str(path)],
        cwd=ROOT,
        env={**os.environ, "PATH": str(path.parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("workers", [(), ("-p", "xdist", "-n", "1")], ids=["alone", "with workers"])
def test_tests_that_are_left_out_are_printed_by_name(tmp_path: Path, workers: tuple[str, ...]) -> None:
    output = run(tmp_path / "test_it.py", *workers)
    assert "left out: 1 tests of what this machine cannot have" in output
    assert output.count("test_it.py::test_the_page: Node.js is not installed") == 1
    assert "2 passed" in output


def test_tests_that_were_not_selected_are_not_listed(tmp_path: Path) -> None:
    output = run(tmp_path / "test_it.py", "-k", "rest or form", "-m", "not long")
    assert "left out" not in output and "2 passed" in output, "the quick form must not count as a long test"


def test_the_marker_of_a_package_decides_about_its_tests() -> None:
    assert why_not("trio") == ""
    has_wheels = sys.version_info < (3, 13) and platform.machine() != "aarch64"
    assert (why_not("ur-rtde") == "") == has_wheels
    with pytest.raises(ValueError, match="no-such-package is no package"):
        why_not("no-such-package")
