"""The model of a robot for the browser, which computes the frames itself from the positions in the telemetry.

A scene is one message: four bytes with the length of the JSON that follows (little endian), the JSON, spaces up to
a multiple of four bytes, and the numbers of all meshes. The JSON says where each mesh has its numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import trio

from strands_actors.drivers import model_of
from strands_actors.surfaces.view.model import Body, Mesh, RobotModel, read_model

_ALIGN = 4
_DIGITS = 6


class Scenes:
    """The scenes of robots. Each is read once from a twin, which takes a second or more.

    Args:
        files: Model files of the user (MJCF or URDF), by name of the robot.
    """

    def __init__(self, files: Mapping[str, str]) -> None:
        self._files = files
        self._scenes: dict[tuple[str, str], bytes] = {}
        self._reading = trio.Lock()

    async def get(self, robot_type: str, robot: str = "") -> bytes:
        """Return the scene of a robot. It is read from the robot's own model file, else from the file with which
        its type was registered here, else from the model of its type.

        Raises:
            NoModel: There is no model of this type here.
        """
        key = robot_type, self._files.get(robot) or model_of(robot_type) or ""
        async with self._reading:
            if key not in self._scenes:
                model = await read_model(*key)
                self._scenes[key] = await trio.to_thread.run_sync(scene_of, model)
            return self._scenes[key]


def scene_of(model: RobotModel) -> bytes:
    """Return the message with the bodies, joints and meshes of a model."""
    numbers = bytearray()
    meshes = [_mesh_json(mesh, numbers) for mesh in model.meshes()]
    head = msgspec.json.encode({"bodies": [_body_json(body) for body in model.bodies()], "meshes": meshes})
    head += b" " * (-len(head) % _ALIGN)
    return len(head).to_bytes(4, "little") + head + bytes(numbers)


def _body_json(body: Body) -> dict[str, Any]:
    frame = body.frame
    return {
        "name": frame.name,
        "parent": frame.parent,
        "xyz": _rounded(frame.xyz),
        "quat": _rounded(frame.quat),
        "joints": [
            {
                "name": joint.name,
                "slides": joint.slides,
                "axis": _rounded(joint.axis),
                "anchor": _rounded(joint.anchor),
                "zero": joint.zero,
                "start": joint.start,
            }
            for joint in body.joints
        ],
    }


def _mesh_json(mesh: Mesh, numbers: bytearray) -> dict[str, Any]:
    points, faces = np.asarray(mesh.points, "<f4"), np.asarray(mesh.faces, "<u4")
    offset = len(numbers)
    numbers += points.tobytes()
    numbers += faces.tobytes()
    return {
        "body": mesh.body,
        "rgba": _rounded(mesh.rgba),
        "at": offset,
        "points": len(points),
        "faces": len(faces),
    }


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(float(value), _DIGITS) for value in values]
