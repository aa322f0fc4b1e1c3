"""The pytest plugin of ``strands_actors``: fixtures with real twins behind real wires.

``strands_twin("so101")``    starts a twin; ends with the test
``strands_robot("so101")``   a connected robot on a twin of its own; cleaned up, with its twin, with the test
``strands_run_dir``          where this test's robots meet, and no others

It imports nothing before a fixture is asked for.
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
    from .caller.robot import RealRobot
    from .contract.driver import Driver
    from .testing import Twin


@pytest.fixture(scope="session")
def strands_run_dirs() -> Iterator[list[Path]]:
    """Removed at the end of the session: the handle's loop lives as long as the process, its socket
    with it."""
    made: list[Path] = []
    yield made
    for path in made:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def strands_run_dir(strands_run_dirs: list[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Short, as a socket's path must be."""
    path = Path(tempfile.mkdtemp(prefix="sa-"))
    strands_run_dirs.append(path)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(path))
    monkeypatch.setenv("STRANDS_ACTORS_DATA", str(path / "data"))  # an e-stop's lock ends with the test
    return path


@pytest.fixture
def strands_twin(tmp_path: Path) -> Iterator[Callable[..., Twin]]:
    """``strands_twin(robot, driver=None, fault=None)``: a running twin, with its wire log."""
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
    """``strands_robot(robot, driver=None, **keywords)``: an armed robot and its twin."""
    from . import Robot
    from .testing.registering import register, where_is

    made: list[RealRobot] = []

    def start(robot: str, driver: type[Driver] | None = None, **keywords: Any) -> tuple[RealRobot, Twin]:
        if driver is not None:
            register(where_is(driver), robot)
        twin = strands_twin(robot, driver)
        handle = Robot(robot, mode="real", port=twin.port, **keywords)
        made.append(handle)
        for _ in range(3):  # a twin that a busy machine lets wait counts as silent
            problem = handle.connect_eagerly()
            if problem is None:
                return handle, twin
        pytest.fail(f"{robot}: {problem}")

    yield start
    for handle in made:
        handle.cleanup()
