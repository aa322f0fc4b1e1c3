"""Shared by all tests."""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from strands_actors import drivers
from strands_actors.drivers import list_native_drivers
from strands_actors.kernel.health import busy

from .forked import fork_what_is_started_here

pytest_plugins = ["strands_actors.pytest_plugin", "tests.long", "tests.machines", "tests.real_time"]
"""The first as if the package were installed with its entry point."""

REGISTRY = ("_registered", "_aliases", "_broken", "_robots", "_found")
"""What ``strands_actors.drivers`` knows in this process."""

collect_ignore = ["lerobot"]
"""Asked for by itself: ``python -m tests lerobot``."""

fork_what_is_started_here()

# Whoever runs the tests in the background may have had these ignored, and the processes under test
# with them.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# No verdict of a test hangs on how fast the machine is, nor on the day's examples: who wants new
# ones says so.
settings.register_profile(
    "here",
    deadline=None,
    derandomize="STRANDS_ACTORS_EXPLORE" not in os.environ,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("here")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays until the end: the garbage collector need not look through it while it
    grows, which takes half as long again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.fixture(autouse=True)
def on_an_idle_computer() -> Iterator[None]:
    """What this process says of a missed deadline is the same on a busy computer."""
    with busy.assumed(busy.IDLE):
        yield


@contextlib.contextmanager
def registry_kept() -> Iterator[None]:
    """Forget what is registered meanwhile."""
    list_native_drivers()
    with pytest.MonkeyPatch.context() as patch:
        for name in REGISTRY:
            patch.setattr(drivers, name, getattr(drivers, name).copy())
        yield


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    """A robot that a test registers is unknown to the next test."""
    with registry_kept():
        yield


@pytest.fixture(scope="module", autouse=True)
def registry_of_module() -> Iterator[None]:
    """A robot that a fixture of a module registers is unknown to the next module."""
    with registry_kept():
        yield


@pytest.fixture(scope="session")
def run_dirs() -> Iterator[list[Path]]:
    """Removed at the end of the session only: the portal lives as long as the process, its socket
    with it."""
    made: list[Path] = []
    yield made
    for path in made:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def apart(run_dirs: list[Path]) -> Iterator[None]:
    """No test meets a robot of whoever runs it, nor its lockout: fixtures of a module begin before
    ``run_dir``."""
    path = Path(tempfile.mkdtemp(prefix="sa-", dir="/tmp"))
    run_dirs.append(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STRANDS_ACTORS_RUN", str(path))
        patch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
        yield


@pytest.fixture(autouse=True)
def run_dir(run_dirs: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this test's robots meet, and no others. Short: a unix socket's path has 108 bytes."""
    path = Path(tempfile.mkdtemp(prefix="sa-", dir="/tmp"))
    run_dirs.append(path)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(path))
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
    return path


@pytest.fixture(autouse=True)
def scheduled() -> Iterator[None]:
    """How this process is scheduled is as before: what a test has made it, its children are, and all
    tests behind it. One that is nice gets nothing on a busy machine."""

    def look() -> tuple[int, ...]:
        if not hasattr(os, "sched_getscheduler"):
            return (os.getpriority(os.PRIO_PROCESS, 0),)
        return os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    before = look()
    yield
    assert look() == before, "nice value, policy or priority are others"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    call: pytest.CallInfo[None],
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A command that failed says why on its own output, which the exception keeps to itself."""
    report = yield
    error = None if call.excinfo is None else call.excinfo.value
    while error is not None:
        if isinstance(error, subprocess.CalledProcessError):
            report.sections.append(("output of the command", f"{error.stdout or ''}\n{error.stderr or ''}"))
        error = error.__context__  # cleaning up may have failed, too, because of it
    return report
