"""Fixtures and settings of all tests."""

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
from strands_actors.drivers.common.servo import resting
from strands_actors.kernel.health import busy

from .forked import fork_what_is_started_here

pytest_plugins = ["strands_actors.pytest_plugin", "tests.long", "tests.machines", "tests.real_time"]
"""The first plugin is loaded as if the package were installed with its entry point."""

REGISTRY = ("_registered", "_aliases", "_broken", "_robots", "_with_driver_class")
"""The names in ``strands_actors.drivers`` that hold the registry of this process."""

collect_ignore = ["lerobot"]
"""LeRobot's tests are a separate run: ``python -m tests lerobot``."""

fork_what_is_started_here()

# A shell may ignore these signals for a run in the background, and the processes under test would inherit
# this.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The result of a test must not depend on the speed of the machine or on random examples.
# STRANDS_ACTORS_EXPLORE asks for new examples.
settings.register_profile(
    "here",
    deadline=None,
    derandomize="STRANDS_ACTORS_EXPLORE" not in os.environ,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("here")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without the garbage collector. The collected tests stay until the end of the session, and
    searching them for garbage would make the collection 50 % longer.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.fixture(autouse=True)
def on_an_idle_computer() -> Iterator[None]:
    """Keep the messages on missed deadlines in this process the same on a busy computer."""
    with busy.assumed(busy.IDLE):
        yield


@pytest.fixture(scope="session", autouse=True)
def limp_at_the_end() -> Iterator[None]:
    """Make an arm of a test limp at its end, unless the test says otherwise. A lowering takes up to 3 s, and
    hundreds of tests end with a stop. Programs have the usual default."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resting, "USUAL", resting.OnExit.LIMP)
        yield


@contextlib.contextmanager
def registry_kept() -> Iterator[None]:
    """Forget, at the end of the block, all robots that were registered in it."""
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
    """Collect the run directories, and remove them at the end of the session. An earlier removal would
    delete the socket of the portal, which lives as long as the process."""
    made: list[Path] = []
    yield made
    for path in made:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def apart(run_dirs: list[Path]) -> Iterator[None]:
    """Hide the user's own robots and their lockouts from the fixtures of a module, which begin before
    ``run_dir``."""
    path = Path(tempfile.mkdtemp(prefix="sa-", dir="/tmp"))
    run_dirs.append(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STRANDS_ACTORS_RUN", str(path))
        patch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
        yield


@pytest.fixture(autouse=True)
def run_dir(run_dirs: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give each test its own run directory. Its path is short, because that of a unix socket may have
    only 108 bytes."""
    path = Path(tempfile.mkdtemp(prefix="sa-", dir="/tmp"))
    run_dirs.append(path)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(path))
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
    return path


@pytest.fixture(autouse=True)
def scheduled() -> Iterator[None]:
    """Fail a test that changes the scheduling of this process. Its children and all later tests would
    inherit the change, and a process with a high nice value gets no time on a busy machine."""

    def look() -> tuple[int, ...]:
        if not hasattr(os, "sched_getscheduler"):
            return (os.getpriority(os.PRIO_PROCESS, 0),)
        return os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    before = look()
    yield
    assert look() == before, "nice value, policy or priority have changed"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    call: pytest.CallInfo[None],
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the output of a failed command to the report; the text of its exception does not contain it."""
    report = yield
    error = None if call.excinfo is None else call.excinfo.value
    while error is not None:
        if isinstance(error, subprocess.CalledProcessError):
            report.sections.append(("output of the command", f"{error.stdout or ''}\n{error.stderr or ''}"))
        error = error.__context__  # the clean-up may have failed because of the earlier error
    return report
