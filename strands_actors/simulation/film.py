"""Film a simulation: note the poses while it runs, and draw them afterwards.

Drawing in software is slower than a film. In this way the film misses no picture, and the simulation is not slower
while it is filmed. Drawing takes its time when the film ends.
"""

from __future__ import annotations

import base64
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import trio

from strands_actors.caller.session.portal import portal
from strands_actors.contract.extras import missing

from .handle import Pose, SimulationError, World, named
from .scene import check_size

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

MP4, GIF = ".mp4", ".gif"
TYPES = {MP4: "video/mp4", GIF: "image/gif"}
"""The kinds of files, by the end of the name."""

LEAST_PIXELS = 64
"""Least width and height of an mp4, which the encoder needs. Both are even."""


class Size(NamedTuple):
    """Width and height of the pictures in pixels."""

    width: int
    height: int


class Video:
    """A film of a simulation, which ``SimRobot.video`` makes.

    In a ``with`` statement it films while the block runs, and writes the file at the end. A notebook shows the
    film, if it is the last value of a cell.

    Attributes:
        path: The file.
        frames: Number of pictures. 0 until the film ends.
    """

    def __init__(
        self, world: World, call: Callable[..., Any], path: Path, fps: int, size: Size, camera: str | None
    ) -> None:
        self.path = path
        self.frames = 0
        self._world = world
        self._call = call
        self._fps = fps
        self._size = size
        self._camera = camera
        self._poses: list[Pose] = []
        self._ended = False

    def __enter__(self) -> Video:
        # This picture shows before the film begins that it can be drawn. It also starts the simulation.
        with named("video"):
            self._call(self._world.render, *self._size, self._camera)
        self._poses, self._ended = [], False
        self._filming = portal().submit(self._film)
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended = True
        with named("video"):
            self._filming.result()
            write(self.path, self._pictures(), self._fps, self._size)
        self.frames = len(self._poses)

    def wait(self, seconds: float) -> Video:
        """Film for a number of seconds, and write the file."""
        with self:
            time.sleep(seconds)
        return self

    def _repr_html_(self) -> str | None:
        if not self.frames or not self.path.is_file():
            return None
        content = base64.b64encode(self.path.read_bytes()).decode()
        data = f"data:{TYPES[self.path.suffix.lower()]};base64,{content}"
        return f'<img src="{data}">' if data.startswith("data:image") else f'<video controls src="{data}"></video>'

    async def _film(self) -> None:
        began = trio.current_time()
        while not (self._ended and self._poses):
            self._poses.append(await self._world.pose())
            await trio.sleep_until(began + len(self._poses) / self._fps)

    def _pictures(self) -> Iterator[NDArray[numpy.uint8]]:
        if len({pose.scene for pose in self._poses}) > 1:
            raise SimulationError(
                "objects or cameras were added or removed during the film. Add them before it begins"
            )
        for pose in self._poses:
            yield self._call(self._world.render, *self._size, self._camera, pose.qpos)


def checked(path: object, fps: object, width: object, height: object) -> tuple[Path, int, Size]:
    """Check the arguments of ``SimRobot.video`` that do not depend on the robot, and return them.

    Raises:
        SimulationError: The file cannot be written: its folder or a package is missing.
        TypeError, ValueError: An argument is wrong.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"path is {path!r}. Give the name of a file that ends with {MP4} or {GIF}")
    file = Path(os.fspath(path)).expanduser()
    if file.suffix.lower() not in TYPES:
        raise ValueError(f"path is {str(path)!r}. Give a name that ends with {MP4} or {GIF}")
    if isinstance(fps, bool) or not isinstance(fps, int) or not 1 <= fps <= 50:
        raise ValueError(f"fps is {fps!r}. Give pictures per second as a whole number, 1 to 50")
    check_size(width, height)
    assert isinstance(width, int) and isinstance(height, int)
    if file.suffix.lower() == MP4:
        if width % 2 or height % 2 or min(width, height) < LEAST_PIXELS:
            raise ValueError(
                f"the picture's size is {width} x {height}. "
                f"Give an even width and height of {LEAST_PIXELS} pixels or more for {MP4}"
            )
        if reason := missing("dataset", f"a film as {MP4}"):
            raise SimulationError(f"{reason}, or give a name that ends with {GIF}")
    if not file.absolute().parent.is_dir():
        raise SimulationError(f"there is no folder {str(file.absolute().parent)!r}. Make it, or choose another")
    return file, fps, Size(width, height)


def write(path: Path, pictures: Iterator[NDArray[numpy.uint8]], fps: int, size: Size) -> None:
    """Write pictures into a file. An older file of this name stays until the new one is complete."""
    part = path.with_name(f".{path.name}.part")
    try:
        if path.suffix.lower() == GIF:
            from .gif import write_gif

            write_gif(part, list(pictures), fps)
        else:
            _write_mp4(part, pictures, fps, size)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _write_mp4(path: Path, pictures: Iterator[NDArray[numpy.uint8]], fps: int, size: Size) -> None:
    from .mp4 import Mp4

    film = Mp4(path, "libsvtav1", {"preset": "10", "crf": "32"}, size, fps)
    try:
        for picture in pictures:
            film.add(picture)
        film.finish()
    except BaseException:
        film.abandon()
        raise
