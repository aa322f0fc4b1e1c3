"""Control the scene of a simulation: render pictures, open a window, add objects, reset.

    world = World(robot.twin_process)
    picture = await world.render(640, 480, None)

One process has the physics and imitates the robot's firmware. Its joints can be moved in two ways: by a
``Robot`` in simulation mode, which controls them directly and without checks, and by a real driver with the
robot's protocol (``transport="twin", sim=``). A joint that the real driver has energised follows the real
driver. The other joints follow the direct control.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import trio

from strands_actors.caller.processes.twin_process import TwinProcess, TwinProcessDown
from strands_actors.contract.extras import missing
from strands_actors.contract.loading import load
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.simulation.scene import check_size

if TYPE_CHECKING:
    from .picture import RenderedPicture

_WORLD = "strands_actors.drivers.sim.world"
_RENDER = f"{_WORLD}:render"
_POSE = f"{_WORLD}:pose"
_RESET = f"{_WORLD}:reset"
_VIEWER = "strands_actors.drivers.sim.viewer:main"

WINDOW_S = 20.0


class SimulationError(RuntimeError):
    """The simulation cannot carry out a request. The exception's text is the reason."""


@contextlib.contextmanager
def named(verb: str) -> Iterator[None]:
    """Put the name of the verb before the text of a ``SimulationError``."""
    try:
        yield
    except SimulationError as failure:
        raise SimulationError(f"{verb}: {failure}") from None


class Pose(NamedTuple):
    """The state of a scene: ``qpos`` of its model, and the number of the scene, which increases with each change
    of the model."""

    qpos: tuple[float, ...]
    scene: int


class World:
    """The scene of one simulation. Its process starts at the first use.

    Every method may raise ``SimulationError``.
    """

    def __init__(self, twin_process: TwinProcess) -> None:
        self._twin_process = twin_process
        self._windows: list[ChildProcess] = []

    async def render(
        self, width: int, height: int, camera: str | None, qpos: Sequence[float] = ()
    ) -> RenderedPicture:
        """Return a picture of shape (height, width, 3), the first row on top.

        Args:
            width: Width in pixels.
            height: Height in pixels.
            camera: Name of a camera; None for a view of the whole robot.
            qpos: The state to draw. Without values, the present one.
        """
        try:
            check_size(width, height)
        except ValueError as wrong:
            raise SimulationError(str(wrong)) from None
        picture = await self._ask(_RENDER, width, height, camera or "", tuple(qpos))
        from .picture import RenderedPicture

        return RenderedPicture.of(picture.rgb, width, height)

    async def pose(self) -> Pose:
        """Return the present state of the scene."""
        return Pose(*await self._ask(_POSE))

    async def reset(self) -> None:
        """Move every joint back to its start position, and hold it there."""
        await self._ask(_RESET)

    async def objects(self) -> dict[str, tuple[float, ...]]:
        """Return position (m) and orientation (w, x, y, z) of each object that was added, by its name."""
        poses: dict[str, tuple[float, ...]] = await self._ask(f"{_WORLD}:objects")
        return poses

    async def change(self, verb: str, *args: Any) -> None:
        """Change the scene.

        Args:
            verb: ``add_object``, ``remove_object``, ``add_camera``, ``set_light``, ``pause``, ``save_state`` or
                ``load_state``.
            args: The arguments of ``verb``, already checked by the module ``scene``.
        """
        await self._ask(f"{_WORLD}:{verb}", *args)

    async def view(self) -> None:
        """Open MuJoCo's viewer in a separate process, and return when the viewer's window is open."""
        if sys.platform.startswith("linux") and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise SimulationError("there is no display (DISPLAY is not set). Use render()")
        if reason := missing("pictures", "a window"):
            raise SimulationError(reason)
        await self._start()
        window = start(_VIEWER, {"control": self._twin_process.control})
        self._windows.append(window)
        with trio.move_on_after(WINDOW_S):
            await trio.lowlevel.wait_readable(window.socket)
            if window.socket.recv(1):
                return
        await window.drop()
        raise SimulationError("the viewer did not open. Read its output above")

    async def close(self) -> None:
        """End the simulation, and close its windows."""
        for window in self._windows:
            await window.drop()
        self._windows.clear()
        await self._twin_process.close()

    async def _ask(self, function: str, *args: Any) -> Any:
        await self._start()
        try:
            return await load(function)(self._twin_process.control, *args)
        except RuntimeError as failure:
            raise SimulationError(str(failure)) from None

    async def _start(self) -> None:
        try:
            await self._twin_process.start()
        except TwinProcessDown as down:
            raise SimulationError(str(down)) from None
