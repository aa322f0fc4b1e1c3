"""The world of a simulation, which a robot's verbs do not cover: pictures, a window, objects, a reset.

    world = World(robot.twin_process)
    picture = await world.render(640, 480, None)

The simulation runs in the process of the robot's twin. The simulated robot uses its simulation control,
without gates. A real driver uses its wire (``transport="twin", sim=``). Both move the same joints: joints
that are energised on the wire follow the wire, the others follow the simulation control.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import trio

from strands_actors.caller.processes.twin_process import TwinProcess, TwinProcessDown
from strands_actors.contract.extras import missing
from strands_actors.contract.loading import load
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.simulation.scene import check_size

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

_WORLD = "strands_actors.drivers.sim.world"
_RENDER = f"{_WORLD}:render"
_RESET = f"{_WORLD}:reset"
_VIEWER = "strands_actors.drivers.sim.viewer:main"

WINDOW_S = 20.0


class SimulationError(RuntimeError):
    """The simulation cannot do it. The text has the reason."""


class World:
    """One simulation. It starts its process at the first use. Every method may raise ``SimulationError``."""

    def __init__(self, twin_process: TwinProcess) -> None:
        self._twin_process = twin_process
        self._windows: list[ChildProcess] = []

    async def render(self, width: int, height: int, camera: str | None) -> NDArray[numpy.uint8]:
        """Return a picture of shape (height, width, 3), the first row on top.

        Args:
            width: Width in pixels.
            height: Height in pixels.
            camera: Name of a camera; None for a view of the whole robot.
        """
        try:
            check_size(width, height)
        except ValueError as wrong:
            raise SimulationError(str(wrong)) from None
        picture = await self._ask(_RENDER, width, height, camera or "")
        import numpy

        return numpy.frombuffer(picture.rgb, numpy.uint8).reshape(height, width, 3).copy()

    async def reset(self) -> None:
        """Put every joint back to its start, and hold it there."""
        await self._ask(_RESET)

    async def change(self, verb: str, *args: Any) -> None:
        """Change the scene.

        Args:
            verb: ``add_object``, ``remove_object``, ``add_camera``, ``save_state`` or ``load_state``.
            args: Its arguments, checked by ``scene``.
        """
        await self._ask(f"{_WORLD}:{verb}", *args)

    async def view(self) -> None:
        """Open MuJoCo's viewer in a separate process, and return when its window is open."""
        if sys.platform.startswith("linux") and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise SimulationError("there is no display (DISPLAY is not set). use render()")
        if why := missing("pictures", "a window"):
            raise SimulationError(why)
        await self._start()
        window = start(_VIEWER, {"control": self._twin_process.control})
        self._windows.append(window)
        with trio.move_on_after(WINDOW_S):
            await trio.lowlevel.wait_readable(window.socket)
            if window.socket.recv(1):
                return
        await window.drop()
        raise SimulationError("the viewer did not open; what it says is above")

    async def close(self) -> None:
        """End the simulation, and close its windows."""
        for window in self._windows:
            await window.drop()
        self._windows.clear()
        await self._twin_process.close()

    async def _ask(self, where: str, *args: Any) -> Any:
        await self._start()
        try:
            return await load(where)(self._twin_process.control, *args)
        except RuntimeError as failure:
            raise SimulationError(str(failure)) from None

    async def _start(self) -> None:
        try:
            await self._twin_process.start()
        except TwinProcessDown as down:
            raise SimulationError(str(down)) from None
