"""Sources of pictures: a device, a rendered scene, or a service of the robot.

A source runs in a camera process, apart from everything that moves the robot. It is opened by a function

    async def open_camera(settings: CameraSettings) -> PictureSource

The user gives the name of this function (``module:function``) as the type of a camera. A driver names it for the
robot's own cameras (``Driver.CAMERAS``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import msgspec

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


class CameraSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The settings of one camera, after validation.

    Width and height are those of the picture after ``rotation``.
    """

    name: str
    type: str
    robot: str = ""  # the robot's name in the registry
    port: str = ""  # the port of the robot, or the scene to render
    options: dict[str, Any] = {}  # options of the robot's driver
    view: str = ""
    index_or_path: int | str = ""
    fps: float | None = None
    width: int | None = None
    height: int | None = None
    rotation: int = 0  # clockwise rotation of the picture, in degrees: 0, 90, 180, -90
    color_mode: str = "rgb"
    fourcc: str | None = None
    backend: int = 0
    warmup_s: float = 0.0

    @property
    def turned(self) -> bool:
        """True if the rotation exchanges width and height."""
        return self.rotation in (90, -90)

    @property
    def captured_size(self) -> tuple[int | None, int | None]:
        """Width and height of the picture before it is rotated."""
        return (self.height, self.width) if self.turned else (self.width, self.height)


class Picture(NamedTuple):
    """One picture.

    Attributes:
        image: Array of shape (height, width, 3), RGB. The first row is the top of the picture.
        captured_ns: Time of the capture, on the computer's monotonic clock (ns).
    """

    image: NDArray[numpy.uint8]
    captured_ns: int


class PictureSource(Protocol):
    """An open source of pictures, used in one loop.

    If a method raises an exception, the exception is reported, and the source is opened again later.
    """

    paced: bool
    """True if ``read`` waits for a new picture. Otherwise it is called once per period."""

    async def read(self) -> Picture:
        """Return the next picture, in RGB, with the time of its capture."""
        ...

    async def aclose(self) -> None:
        """Close the device or the connection of the source."""
        ...
