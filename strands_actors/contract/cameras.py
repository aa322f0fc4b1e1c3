"""What gives pictures: a device, a scene that is drawn, a robot's own service. It runs in a camera's
process, apart from everything that moves the robot.

    async def open_camera(settings: CameraSettings) -> PictureSource

is named as ``module:function``: by the type of a camera, or by a driver for the robot's own cameras
(``Driver.CAMERAS``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import msgspec

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


class CameraSettings(msgspec.Struct, frozen=True, kw_only=True):
    """One camera, checked. Sizes are those of the picture as it is handed out: after ``rotation``."""

    name: str
    type: str
    robot: str = ""  # its kind
    port: str = ""  # where the robot is, or its scene
    options: dict[str, Any] = {}  # of the robot's driver
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
        """Return whether width and height of what is captured are the other way round."""
        return self.rotation in (90, -90)

    @property
    def captured_size(self) -> tuple[int | None, int | None]:
        """Width and height before ``rotation``."""
        return (self.height, self.width) if self.turned else (self.width, self.height)


class Picture(NamedTuple):
    """``image``: (height, width, 3), RGB, the first row on top. ``captured_ns``: on the host's
    monotonic clock."""

    image: NDArray[numpy.uint8]
    captured_ns: int


class PictureSource(Protocol):
    """Belongs to one loop. Whatever it raises is told, and it is opened anew, later."""

    paced: bool
    """Whether ``read`` waits for a picture that is new; else it is called once a period."""

    async def read(self) -> Picture: ...
    async def aclose(self) -> None: ...
