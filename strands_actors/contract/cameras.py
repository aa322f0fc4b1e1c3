"""Sources of pictures: a device, a rendered scene, or a service of the robot.

A source runs in a camera process, apart from everything that moves the robot. It is opened by a function

    async def open_camera(settings: CameraSettings) -> PictureSource

which is named as ``module:function``: by the type of a camera, or by a driver for its robot's cameras
(``Driver.CAMERAS``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import msgspec

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


class CameraSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The settings of one camera, after validation. Sizes are those of the picture after ``rotation``."""

    name: str
    type: str
    robot: str = ""  # the robot's name in the registry
    port: str = ""  # the port of the robot, or its scene
    options: dict[str, Any] = {}  # options of the robot's driver
    view: str = ""
    index_or_path: int | str = ""
    fps: float | None = None
    width: int | None = None
    height: int | None = None
    rotation: int = 0  # degrees clockwise: 0, 90, 180, -90
    color_mode: str = "rgb"
    fourcc: str | None = None
    backend: int = 0
    warmup_s: float = 0.0

    @property
    def turned(self) -> bool:
        """True if width and height are exchanged before ``rotation``."""
        return self.rotation in (90, -90)

    @property
    def captured_size(self) -> tuple[int | None, int | None]:
        """Width and height before ``rotation``."""
        return (self.height, self.width) if self.turned else (self.width, self.height)


class Picture(NamedTuple):
    """One picture.

    Attributes:
        image: (height, width, 3), RGB, with the first row on top.
        captured_ns: On the host's monotonic clock.
    """

    image: NDArray[numpy.uint8]
    captured_ns: int


class PictureSource(Protocol):
    """An open source of pictures, used in one loop.

    An exception of its methods is reported, and the source is opened again later.
    """

    paced: bool
    """True if ``read`` waits for a new picture. Otherwise it is called once per period."""

    async def read(self) -> Picture:
        """Return the next picture, in RGB, with the time of its capture."""
        ...

    async def aclose(self) -> None:
        """Release the device or connection of the source."""
        ...
