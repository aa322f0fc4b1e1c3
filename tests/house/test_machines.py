"""What a machine cannot have is left out by name, and printed: never skipped in silence."""

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
"""A run takes a second of a free machine."""

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
    """Return what pytest prints on a machine that has no program at all."""
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
def test_what_is_left_out_is_printed_by_name(tmp_path: Path, workers: tuple[str, ...]) -> None:
    told = run(tmp_path / "test_it.py", *workers)
    assert "left out: 1 tests of what this machine cannot have" in told
    assert told.count("test_it.py::test_the_page: Node.js is not installed") == 1
    assert "2 passed" in told


def test_what_would_not_have_run_is_not_in_the_list(tmp_path: Path) -> None:
    told = run(tmp_path / "test_it.py", "-k", "rest or form", "-m", "not long")
    assert "left out" not in told and "2 passed" in told, "the quick form is not long here"


def test_a_marker_of_a_package_decides_whether_it_is_installed_or_not() -> None:
    assert why_not("trio") == ""
    has_wheels = sys.version_info < (3, 13) and platform.machine() != "aarch64"
    assert (why_not("ur-rtde") == "") == has_wheels
    with pytest.raises(ValueError, match="no-such-package is no package"):
        why_not("no-such-package")
