"""Pytest fixtures that run simulated robots (twins), commanded over the real robots' protocols.

``strands_twin("so101")``    start a simulated robot; it ends with the test
``strands_robot("so101")``   start a simulated robot and return a ``Robot`` that is connected to it; both end with
                             the test
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
    """Directories for the robots' sockets, removed at the end of the test session. The event loop of the robots,
    and its socket in the directory, live as long as the process.
    """
    made: list[Path] = []
    yield made
    for path in made:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def strands_run_dir(strands_run_dirs: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set a directory for the robots' sockets, for one test. Its path is short, because the path of a socket is
    limited.
    """
    path = Path(tempfile.mkdtemp(prefix="sa-"))
    strands_run_dirs.append(path)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(path))
    # The lock after an e-stop is stored in this directory, so it ends with the test.
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))
    return path


@pytest.fixture
def strands_twin(tmp_path: Path) -> Iterator[Callable[..., Twin]]:
    """Return the function ``start(robot, driver=None, fault=None)``. It starts a simulated robot with a log of its
    frames.

    Args of ``start``:
        robot: Name of the robot.
        driver: Its driver class, if it is not registered.
        fault: Name of a fault of the simulated robot.
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
    """Return the function ``start(robot, driver=None, **keywords)``. It returns an armed robot (its motors have
    torque) and the simulated robot that it is connected to.

    Args of ``start``:
        robot: Name of the robot.
        driver: Its driver class, if it is not registered.
        keywords: Keyword arguments of ``Robot(...)``.
    """
    from . import Robot
    from .testing.registering import class_path_of, register

    made: list[RealRobot] = []

    def start(robot: str, driver: type[Driver] | None = None, **keywords: Any) -> tuple[RealRobot, Twin]:
        if driver is not None:
            register(class_path_of(driver), robot)
        twin = strands_twin(robot, driver)
        handle = Robot(robot, mode="real", port=twin.port, **keywords)
        made.append(handle)
        # On a busy computer the simulated robot may wait for a processor and look silent. So connecting is tried
        # again.
        for _ in range(3):
            problem = handle.connect_eagerly()
            if problem is None:
                return handle, twin
        pytest.fail(f"{robot}: {problem}")

    yield start
    for handle in made:
        handle.cleanup()
