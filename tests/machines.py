"""Leave out the tests that this machine cannot run, and list their names at the end of the run.

``@pytest.mark.needs("ur-rtde")`` names a package of ``pyproject.toml``, a program of ``PROGRAMS``, or
``vcan``. The test is left out only where the machine cannot have it: the package's marker excludes this
Python or processor, the program is not installed, or the kernel has no virtual CAN buses. A package that
should be installed but is missing fails its test.

``@pytest.mark.long_beside("ur-rtde")`` makes a test long (``tests/long.py``) where the package is
available, because a quicker test that needs the package runs there. Elsewhere it runs as a quick test.
"""

from __future__ import annotations

import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement

PROGRAMS = {"Node.js": "node", "systemd": "systemd-analyze"}
"""Name of the program: its command."""
VCAN = ("unshare", "-rn", "ip", "link", "add", "type", "vcan")
"""Makes a virtual CAN bus in a network namespace, which ends with the command."""
LIST = "left_out"

_left_out = pytest.StashKey[list[str]]()


@cache
def why_not(name: str) -> str:
    """Return why this machine cannot have a package or program; empty if it can.

    Raises:
        ValueError: The name is neither a package of ``pyproject.toml`` nor one of ``PROGRAMS``.
    """
    if name in PROGRAMS:
        return "" if shutil.which(PROGRAMS[name]) else f"{name} is not installed"
    if name == "vcan":
        return "" if _succeeds(VCAN) else "the kernel has no virtual CAN buses, or this user may not make one"
    markers = [requirement.marker for requirement in _requirements() if requirement.name == name]
    if not markers:
        raise ValueError(f"{name} is no package of pyproject.toml and no program. Use one of them")
    if any(marker is None or marker.evaluate() for marker in markers):
        return ""
    return f"{name} is only for {' or '.join(map(str, markers))}"


def _succeeds(command: tuple[str, ...]) -> bool:
    return shutil.which(command[0]) is not None and subprocess.run(command, capture_output=True).returncode == 0


def _requirements() -> Iterator[Requirement]:
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    for lines in (project["dependencies"], *project["optional-dependencies"].values()):
        yield from map(Requirement, lines)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests before ``-m`` selects among them."""
    for item in items:
        if any(not why_not(marker.args[0]) for marker in item.iter_markers("long_beside")):
            item.add_marker(pytest.mark.long)


class LeaveOut:
    """Remove tests from the run. It is registered after ``-m`` and ``-k``, so that the list has only tests
    that would have run."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        kept, left_out = list[pytest.Item](), list[pytest.Item]()
        listed = config.stash[_left_out]
        for item in items:
            missing = [why for marker in item.iter_markers("needs") if (why := why_not(marker.args[0]))]
            (left_out if missing else kept).append(item)
            listed += [f"{item.nodeid}: {why}" for why in missing[:1]]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
            items[:] = kept


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_left_out] = []
    config.pluginmanager.register(LeaveOut())
    if config.pluginmanager.hasplugin("xdist"):
        config.pluginmanager.register(Workers())


class Workers:
    """Take over the lists of the workers. With pytest-xdist only they collect tests, but another process
    prints."""

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object, error: object) -> None:
        stash: pytest.Stash = node.config.stash  # type: ignore[attr-defined]
        received: list[str] = getattr(node, "workeroutput", {}).get(LIST, [])
        stash[_left_out] += [line for line in received if line not in stash[_left_out]]


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput[LIST] = session.config.stash[_left_out]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    left_out = sorted(config.stash[_left_out])
    if left_out:
        terminalreporter.section(f"left out: {len(left_out)} tests of what this machine cannot have")
        for line in left_out:
            terminalreporter.line(line)
