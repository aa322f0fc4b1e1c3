"""What the cameras of the simulated Spot see: a floor of tiles below a sky. Pure.

A picture depends on where the camera is, so it changes when the robot moves. The robot itself, and other things,
are not in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from strands_actors.drivers.spot.protocol import Vector, rotated

from .geometry import Pose

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

TILE_M = 0.5
"""Side of a tile."""
FARTHEST_M = 10.0
"""Longest distance that a depth camera measures. Beyond it the picture has zeros [assumed]."""
_FADES_M = 12.0
"""Distance at which the tiles have faded to a third."""
_LIGHT, _DARK, _HAZE = (214.0, 206.0, 190.0), (96.0, 104.0, 118.0), (176.0, 184.0, 196.0)
"""Red, green and blue of the tiles, and of the far end of the floor."""
_ZENITH = (104.0, 146.0, 214.0)
_GREY = (0.299, 0.587, 0.114)


class Lens(NamedTuple):
    """A camera without distortion: its size and its focal length, pixels. Its optical centre is in the middle."""

    columns: int
    rows: int
    focal: float

    def resized(self, ratio: float) -> Lens:
        return Lens(max(1, round(self.columns * ratio)), max(1, round(self.rows * ratio)), self.focal * ratio)

    @property
    def centre(self) -> tuple[float, float]:
        return (self.columns - 1) / 2, (self.rows - 1) / 2


def depth(lens: Lens, camera: Pose) -> NDArray[np.uint16]:
    """Return the distance of the floor along the optical axis, millimetres; 0 where nothing is measured.

    Args:
        lens: The camera.
        camera: Its pose above the floor. Its x axis points to the right of the picture, its y axis downwards.
    """
    import numpy as np

    far_m, _ = _seen(lens, camera)
    return np.where(far_m <= FARTHEST_M, far_m * 1000.0, 0.0).astype("<u2")


def colour(lens: Lens, camera: Pose) -> NDArray[np.uint8]:
    """Return red, green and blue of each pixel. The arguments are those of ``depth``."""
    import numpy as np

    far_m, (x, y, z) = _seen(lens, camera)
    is_floor = np.isfinite(far_m)
    reach = np.where(is_floor, far_m, 0.0)
    place = [camera.xyz[axis] + ray * reach for axis, ray in enumerate((x, y))]
    is_light = (np.floor(place[0] / TILE_M) + np.floor(place[1] / TILE_M)) % 2 == 0
    clear = np.exp(-reach / _FADES_M)[..., None]
    tiles = np.where(is_light[..., None], _LIGHT, _DARK) * clear + np.multiply(_HAZE, 1.0 - clear)
    height = np.clip(z / np.sqrt(x * x + y * y + z * z), 0.0, 1.0)[..., None]
    sky = np.multiply(_ZENITH, height) + np.multiply(_HAZE, 1.0 - height)
    picture: NDArray[np.uint8] = np.rint(np.where(is_floor[..., None], tiles, sky)).astype(np.uint8)
    return picture


def grey(lens: Lens, camera: Pose) -> NDArray[np.uint8]:
    """Return the brightness of each pixel. The arguments are those of ``depth``."""
    import numpy as np

    picture: NDArray[np.uint8] = np.rint(colour(lens, camera) @ np.array(_GREY)).astype(np.uint8)
    return picture


def _seen(lens: Lens, camera: Pose) -> tuple[Any, tuple[Any, Any, Any]]:
    """Return for each pixel how far the floor is along the optical axis (infinite for the sky), and its ray in the
    frame of the floor, of length 1 along the optical axis."""
    import numpy as np

    centre_x, centre_y = lens.centre
    right = (np.arange(lens.columns) - centre_x)[None, :] / lens.focal
    down = (np.arange(lens.rows) - centre_y)[:, None] / lens.focal
    axes = [rotated(camera.rotation, axis) for axis in _AXES]
    x, y, z = (axes[0][part] * right + axes[1][part] * down + axes[2][part] for part in range(3))
    sinks = z < -_LEAST
    far_m = np.where(sinks, camera.xyz[2] / np.where(sinks, -z, 1.0), np.inf)
    return far_m, (x, y, z)


_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_LEAST = 1e-6
