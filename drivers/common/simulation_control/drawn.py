"""The model of a simulated robot as a display outside MuJoCo needs it: the surfaces of the bodies, and their frames
in a pose.

``drawn_model`` gets a compiled copy of the scene from a twin. After that the twin is not needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.physics.lean_mujoco import mujoco

from . import protocol as p
from .client import Refusal, SimulationClient
from .looks.outlines import Floats, Outline, Station, ball, box, rod

WORLD = "world"
"""Name of the frame in which the robot stands."""

_ANSWER_S = 30.0
_DRAWN_GROUPS = 3
"""MuJoCo draws the groups below this one. The shapes of physics are in others."""
# MuJoCo's enums are not equal to the numbers of numpy in every order of the comparison.
_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_MIDDLE = (0.0, 0.0, 0.0)
_EDGE = 0.05
"""Radius of the edges of boxes and cylinders, as a share of their smallest half size."""


class Mesh(NamedTuple):
    """A surface of one body, in the frame of the body, in metres.

    ``points`` has a row for each corner, ``faces`` three indices for each triangle. ``rgba`` is from 0 to 1.
    """

    body: str
    points: Floats
    faces: NDArray[np.int32]
    rgba: tuple[float, float, float, float]


class Frame(NamedTuple):
    """The frame of a body in that of its parent: metres, and a quaternion w, x, y, z."""

    name: str
    parent: str
    xyz: tuple[float, float, float]
    quat: tuple[float, float, float, float]


class Joint(NamedTuple):
    """A joint with one degree of freedom. It moves its body by ``position - zero``.

    Attributes:
        name: Name of the joint.
        slides: True for a joint that slides, False for a hinge.
        axis: Direction in the frame of the body.
        anchor: A point of the axis in the frame of the body, in metres.
        zero: Position in which the body stands as the model has it, in radians or metres.
        start: Position of a joint that the telemetry does not have.
    """

    name: str
    slides: bool
    axis: tuple[float, float, float]
    anchor: tuple[float, float, float]
    zero: float
    start: float


class Body(NamedTuple):
    """A body: its frame in that of its parent while its joints are at ``zero``, and the joints that move it, in the
    order in which they turn it."""

    frame: Frame
    joints: tuple[Joint, ...]


class DrawnModel:
    """The model of a robot.

    Args:
        model: The compiled MuJoCo model.
        qpos: The state in which joints stay that the telemetry does not have.
    """

    def __init__(self, model: Any, qpos: Sequence[float]) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = qpos
        self._start = [float(value) for value in qpos]
        self._names = [WORLD, *(model.body(index).name or f"body_{index}" for index in range(1, model.nbody))]
        self._addresses = {
            model.joint(index).name: int(model.jnt_qposadr[index])
            for index in range(model.njnt)
            if self._is_single(index)
        }

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(self._addresses)

    def meshes(self) -> Iterator[Mesh]:
        """Yield everything that is drawn of the robot. The floor is left out."""
        model = self._model
        for geom in range(model.ngeom):
            hidden = model.geom_group[geom] >= _DRAWN_GROUPS or model.geom_bodyid[geom] == 0
            shape = None if hidden else _surface(model, geom)
            if shape is None:
                continue
            turn = np.empty(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            points = shape.points @ turn.reshape(3, 3).T + model.geom_pos[geom]
            yield Mesh(self._names[model.geom_bodyid[geom]], points, shape.faces, _colour(model, geom))

    def bodies(self) -> list[Body]:
        """Return the bodies and joints, for a display that computes the frames itself. A parent comes before its
        children. A body that is free in space stays where it started."""
        model, bodies = self._model, []
        for index in range(1, model.nbody):
            first = int(model.body_jntadr[index])
            numbers = range(first, first + int(model.body_jntnum[index])) if first >= 0 else range(0)
            joints = tuple(self._joint(number) for number in numbers if self._is_single(number))
            xyz, quat = model.body_pos[index].tolist(), model.body_quat[index].tolist()
            if len(joints) < len(numbers):
                address = int(model.jnt_qposadr[first])
                free = int(model.jnt_type[first]) == int(mujoco.mjtJoint.mjJNT_FREE)
                turn = self._start[address + 3 : address + 7] if free else self._start[address : address + 4]
                xyz, quat = (self._start[address : address + 3] if free else xyz), turn
            frame = Frame(self._names[index], self._names[int(model.body_parentid[index])], tuple(xyz), tuple(quat))
            bodies.append(Body(frame, joints))
        return bodies

    def _is_single(self, joint: int) -> bool:
        return int(self._model.jnt_type[joint]) in _SINGLE

    def _joint(self, number: int) -> Joint:
        model, address = self._model, int(self._model.jnt_qposadr[number])
        return Joint(
            model.joint(number).name,
            int(model.jnt_type[number]) == int(mujoco.mjtJoint.mjJNT_SLIDE),
            tuple(model.jnt_axis[number].tolist()),
            tuple(model.jnt_pos[number].tolist()),
            float(model.qpos0[address]),
            self._start[address],
        )

    def frames(self, positions: Mapping[str, float]) -> list[Frame]:
        """Return the frame of each body.

        Args:
            positions: Position by joint, in radians or metres. Other joints stay where they are. Names that the
                model does not have are ignored: axes that are no joints, such as the speed of a base.
        """
        model, data = self._model, self._data
        for name, value in positions.items():
            if (address := self._addresses.get(name)) is not None:
                data.qpos[address] = value
        mujoco.mj_kinematics(model, data)
        frames = []
        for body in range(1, model.nbody):
            parent = int(model.body_parentid[body])
            back, quat, xyz = np.empty(4), np.empty(4), np.empty(3)
            mujoco.mju_negQuat(back, data.xquat[parent])
            mujoco.mju_rotVecQuat(xyz, data.xpos[body] - data.xpos[parent], back)
            mujoco.mju_mulQuat(quat, back, data.xquat[body])
            x, y, z = xyz.tolist()
            w, i, j, k = quat.tolist()
            frames.append(Frame(self._names[body], self._names[parent], (x, y, z), (w, i, j, k)))
        return frames


async def drawn_model(control: str) -> DrawnModel:
    """Return the model of a running twin.

    Args:
        control: Path of the twin's control socket.

    Raises:
        RuntimeError: The twin did not answer.
    """
    try:
        client = SimulationClient(control)
        try:
            scene = await client.call(p.GetModel(0), p.Model, _ANSWER_S)
            pose = await client.call(p.GetPose(0), p.Pose, _ANSWER_S)
        finally:
            client.close()
    except (WireDown, Refusal) as failure:
        raise RuntimeError(str(failure)) from failure
    model = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": scene.binary})
    return DrawnModel(model, pose.qpos)


def _colour(model: Any, geom: int) -> tuple[float, float, float, float]:
    material = model.geom_matid[geom]
    red, green, blue, alpha = (model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]).tolist()
    return red, green, blue, alpha


def _surface(model: Any, geom: int) -> Outline | None:
    """Return the surface of a shape in its own frame; None for one that has no surface, such as a plane."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom].tolist()
    radius, half = size[0], size[1]
    match model.geom_type[geom]:
        case kinds.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            corner, triangle = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
            points = model.mesh_vert[corner : corner + model.mesh_vertnum[mesh]]
            faces = model.mesh_face[triangle : triangle + model.mesh_facenum[mesh]]
            return Outline(np.asarray(points, np.float64), np.asarray(faces, np.int32))
        case kinds.mjGEOM_BOX:
            return box(_MIDDLE, size, _EDGE * min(size))
        case kinds.mjGEOM_SPHERE:
            return ball(_MIDDLE, (radius,) * 3)
        case kinds.mjGEOM_ELLIPSOID:
            return ball(_MIDDLE, size)
        case kinds.mjGEOM_CAPSULE:
            return rod(_ends(half + radius, radius), smooth=False)
        case kinds.mjGEOM_CYLINDER:
            return rod(_ends(half, radius), _EDGE * min(half, radius), smooth=False)
        case _:
            return None


def _ends(half: float, radius: float) -> list[Station]:
    """Return the two ends of a round shape along z."""
    return [Station((0.0, 0.0, z), (radius, radius)) for z in (-half, half)]
