"""Take the picture of a robot's twin, in a pose of ``poses.toml``."""

from __future__ import annotations

import functools
import io
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trio
from numpy.typing import NDArray
from PIL import Image

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import SimulationClient
from strands_actors.simulation.gif import colours
from strands_actors.testing import Twin

from .camera import Direction, Floats, frame, visible_points
from .light import Studio

WIDTH, HEIGHT = 640, 480
SAMPLES = 32
MOST_BYTES = 75_000
FILLED = 0.86
DIRECTION = (148.0, -16.0)

_POSES = Path(__file__).with_name("poses.toml")
_ANSWER_S = 60.0


class Scene(NamedTuple):
    """A robot's scene as its twin has it: a binary file of MuJoCo, and the state ``qpos``."""

    file: bytes
    qpos: tuple[float, ...]


@functools.cache
def poses() -> Mapping[str, Any]:
    """Return the table of ``poses.toml``, by robot."""
    return tomllib.loads(_POSES.read_text())


async def scene_at(control: str) -> Scene:
    """Return the scene of a running twin, by the path of its control socket."""
    client = SimulationClient(control)
    try:
        model = await client.call(p.GetModel(0), p.Model, _ANSWER_S)
        pose = await client.call(p.GetPose(0), p.Pose, _ANSWER_S)
    finally:
        client.close()
    return Scene(model.binary, pose.qpos)


def scene_of(robot: str) -> Scene:
    """Start the twin of a robot, and return its scene."""
    with tempfile.TemporaryDirectory() as folder, Twin(robot, Path(folder), by_hand=True):
        return trio.run(scene_at, str(Path(folder) / "control"))


def picture_of(robot: str, samples: int = SAMPLES, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    """Return the picture of a robot's twin, of shape (height, width, 3)."""
    return portrait(scene_of(robot), poses().get(robot, {}), samples, width, height)


def portrait(scene: Scene, table: Mapping[str, Any], samples: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return the picture of a scene, of shape (height, width, 3).

    Args:
        scene: The robot's scene.
        table: The robot's table in ``poses.toml``.
        samples: Number of pictures of which this is the mean.
        width: Width in pixels.
        height: Height in pixels.
    """
    studio = Studio(scene.file, width, height, samples)
    try:
        pose = posed(studio.model, scene.qpos, table.get("joints", {}))
        points = points_in(studio.model, pose)
        if table.get("grounded", True):
            put_on_floor(studio.model, pose, points)
            points = points_in(studio.model, pose)
        direction = Direction(*table.get("direction", DIRECTION))
        return studio.shoot(pose, frame(points, direction, width / height, table.get("filled", FILLED)))
    finally:
        studio.close()


def posed(model: Any, qpos: Sequence[float], joints: Mapping[str, float]) -> list[float]:
    """Return a state with some joints changed.

    Args:
        model: The compiled model.
        qpos: The state before.
        joints: Position by name of a joint, in radians or metres. ``base_z`` is the height of a free body.
    """
    pose = list(qpos)
    for name, value in joints.items():
        pose[2 if name == "base_z" else int(model.joint(name).qposadr[0])] = value
    return pose


def points_in(model: Any, pose: Sequence[float]) -> Floats:
    """Return points of everything that is drawn of the robot in this pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    return visible_points(model, data)


def put_on_floor(model: Any, pose: list[float], points: Floats) -> None:
    """Move the robot up or down until its lowest point is on the floor. ``pose`` or ``model`` is changed."""
    lowest = float(points[:, 2].min())
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        pose[2] -= lowest
    else:
        model.body_pos[1, 2] -= lowest


def png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture as a PNG file with 256 colours, also those of small parts.

    Dithering makes the shades smooth. A file that gets larger than ``MOST_BYTES`` by it is not dithered.
    """
    palette, _ = colours([picture])
    chosen = Image.new("P", (1, 1))
    chosen.putpalette(palette.tobytes())
    for dither in (Image.Dither.FLOYDSTEINBERG, Image.Dither.NONE):
        file = io.BytesIO()
        image = Image.fromarray(picture).quantize(palette=chosen, dither=dither)
        image.save(file, "PNG", optimize=True)
        if len(file.getvalue()) <= MOST_BYTES:
            break
    return file.getvalue()
