"""Start and end the process of a simulated robot (a twin).

The process serves the robot's real protocol, a control socket for simulations, or both.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import trio

from strands_actors.kernel.processes.process import ChildProcess, start

from .run_directory import MAX_SOCKET_PATH, run_dir

SIM = "sim"
"""The transport of a simulated robot: the control socket of its process."""

START_S = 60.0
"""Longest time for a start, on a busy computer. A twin that ends is noticed at once."""
COMPILES_S = 600.0
"""Longest time for a start if Warp has to compile a solver first, or if Isaac Sim has to start."""
END_S = 1.0

_CLEANED_UP = "the simulation was cleaned up. Make a new one"
_numbers = itertools.count(1)


class TwinProcessDown(Exception):
    """The process of a simulated robot cannot be started. The text has the reason."""


class TwinProcess:
    """The process of a simulated robot (a twin). ``start`` starts it.

    Args:
        twin: ``module:function`` that runs in the process.
        robot: Name of the robot.
        has_control: Serve a control socket for simulations, too.
        place: Position and orientation of the base in the simulation; None for that of the model.
        options: Options of the simulated robot.
        pictures: True if cameras draw the scene.
        on_wire: True if only the cameras use the control socket, and the driver uses the robot's real protocol.
        backend: The physics; empty for MuJoCo.
    """

    def __init__(
        self,
        twin: str,
        robot: str,
        has_control: bool = False,
        place: Mapping[str, Any] | None = None,
        options: Mapping[str, Any] | None = None,
        pictures: bool = False,
        on_wire: bool = False,
        backend: str = "",
    ) -> None:
        self.robot = robot
        self._pictures = pictures
        self._on_wire = on_wire
        self._backend = backend
        self._twin = twin
        self._place = place
        self.options: Mapping[str, Any] = options or {}
        self._has_control = has_control
        self._process: ChildProcess | None = None
        self._starting = trio.Lock()
        self._closed = False
        self.port = ""
        """Port or address of the robot's real protocol, after the start."""
        self.control = ""
        """Path of the control socket after the start; empty without a control socket."""

    @property
    def pid(self) -> int:
        """Return the process id; 0 if the process does not run."""
        return 0 if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the process if it does not run. Return when it accepts connections. Raise ``TwinProcessDown`` if
        it cannot be started.
        """
        async with self._starting:
            if self._closed:
                raise TwinProcessDown(_CLEANED_UP)
            if self._process is None or not self._process.alive:
                await self._start()

    async def _start(self) -> None:
        self.control = _socket_path() if self._has_control else ""
        with tempfile.TemporaryDirectory(prefix="strands-actors-") as directory:
            port_file = Path(directory) / "port"
            args = {
                "twin": self._twin,
                "robot": self.robot,
                "port_file": str(port_file),
                "log": os.environ.get("STRANDS_ACTORS_TWIN_LOG"),
                "control": self.control or None,
                "place": self._place,
                "options": self.options or None,
                "pictures": self._pictures,
                "on_wire": self._on_wire,
                "backend": self._backend,
            }
            self._process = process = start("strands_actors.caller.processes.twin_entry:main", args)
            with trio.move_on_after(COMPILES_S if self._backend else START_S):
                while process.alive and not self._closed:
                    if port_file.exists():
                        self.port = port_file.read_text().strip()
                        return
                    await trio.sleep(0.005)
        # ``close`` was called during the start, and has ended the process.
        if self._closed:
            raise TwinProcessDown(_CLEANED_UP)
        self._process = None
        # If ``_process`` stayed set, the next start would treat the process as ready.
        await process.drop()
        raise TwinProcessDown("the twin did not start")

    async def close(self) -> None:
        """End the process. It cannot be started again."""
        self._closed = True
        process, self._process = self._process, None
        if process is not None:
            process.kill(15)
            with trio.move_on_after(END_S):
                await process.wait()
            await process.drop()
        if self.control:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.control)


def _socket_path() -> str:
    """Return a new path for a socket. Raise ``TwinProcessDown`` if the path is too long."""
    path = f"{run_dir()}/sim-{os.getpid()}-{next(_numbers)}.sock"
    if len(path.encode()) > MAX_SOCKET_PATH:
        raise TwinProcessDown(
            f"{path} is too long for the path of a socket. Set STRANDS_ACTORS_RUN to a shorter path"
        )
    return path
