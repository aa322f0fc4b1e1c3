"""Pytest fixtures that run robots on their twins, through the real wires.

``strands_twin("so101")``    start a twin; it ends with the test
``strands_robot("so101")``   start a twin and connect a robot to it; both end with the test
``strands_run_dir``          a run directory for the robots of this test alone

The plugin imports the rest of the package only when a test uses a fixture.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .caller.handle.robot import RealRobot
    from .contract.driver import Driver
    from .testing import Twin


@pytest.fixture(scope="session")
def strands_run_dirs() -> Iterator[list[Path]]:
    """Run directories of the session, removed at its end. The loop of the robots' handles lives as long as
    the process, and so does its socket in the directory."""
    made: list[Path] = []
    yield made
    for path in made:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def strands_run_dir(strands_run_dirs: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set a run directory for one test. Its path is short, since the path of a socket must be."""
    path = Path(tempfile.mkdtemp(prefix="sa-"))
    strands_run_dirs.append(path)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(path))
    # The lock of an e-stop then ends with the test.
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
    return path


@pytest.fixture
def strands_twin(tmp_path: Path) -> Iterator[Callable[..., Twin]]:
    """Return ``start(robot, driver=None, fault=None)``, which starts a twin with its wire log.

    Args of ``start``:
        robot: Name of the robot.
        driver: Its driver class, if it is not registered.
        fault: Name of a fault that the twin has.
    """
    from .testing import Twin

    with contextlib.ExitStack() as stack:

        def start(robot: str, driver: type[Driver] | None = None, fault: str | None = None) -> Twin:
            directory = Path(tempfile.mkdtemp(prefix=f"{robot}-", dir=tmp_path))
            return stack.enter_context(Twin(robot, directory, fault, driver))

        yield start


@pytest.fixture
def strands_robot(
    strands_run_dir: Path, strands_twin: Callable[..., Twin]
) -> Iterator[Callable[..., tuple[RealRobot, Twin]]]:
    """Return ``start(robot, driver=None, **keywords)``, which returns an armed robot and its twin.

    Args of ``start``:
        robot: Name of the robot.
        driver: Its driver class, if it is not registered.
        keywords: Keyword arguments of ``Robot(...)``.
    """
    from . import Robot
    from .testing.registering import register, where_is

    made: list[RealRobot] = []

    def start(robot: str, driver: type[Driver] | None = None, **keywords: Any) -> tuple[RealRobot, Twin]:
        if driver is not None:
            register(where_is(driver), robot)
        twin = strands_twin(robot, driver)
        handle = Robot(robot, mode="real", port=twin.port, **keywords)
        made.append(handle)
        # On a busy machine the twin may wait for a processor and then counts as silent, so try again.
        for _ in range(3):
            problem = handle.connect_eagerly()
            if problem is None:
                return handle, twin
        pytest.fail(f"{robot}: {problem}")

    yield start
    for handle in made:
        handle.cleanup()
