"""The scenery of a simulation, which can change while it runs: objects, cameras, saved states, and the place of
the robot.

Each change compiles the model anew. Moving bodies continue from their positions and speeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.physics.jointed import Jointed
from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco

SHAPES = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3, "x, y, z: full extents"),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1, "diameter"),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2, "diameter, height"),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, 2, "diameter, height of the straight part"),
    "mesh": (mujoco.mjtGeom.mjGEOM_MESH, 3, "scale in x, y, z"),
}
"""For each shape: MuJoCo's type, the count of numbers in its size, and their meaning, in metres."""

TOUCHES = 3
"""Objects touch the floor (1), links (2) and each other."""


class Refused(Exception):
    """A change is refused. The text has the reason and the accepted values."""


class Object(NamedTuple):
    name: str
    shape: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]  # w, x, y, z
    size: tuple[float, ...]
    color: tuple[float, ...]  # r, g, b, a; 0 to 1
    mass_kg: float
    fixed: bool
    mesh: str = ""


class Camera(NamedTuple):
    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov_deg: float
    body: str = ""  # The carrier of the camera. Empty: the world.


class Scenery:
    """The scenery of one body. ``changed`` is called after each change of the model."""

    def __init__(self, jointed: Jointed) -> None:
        self._jointed = jointed
        self._saved: dict[str, Any] = {}
        self.changed: Callable[[], None] = lambda: None

    # -- objects and cameras

    @property
    def objects(self) -> list[str]:
        """The names of all bodies, including the robot's links."""
        return [body.name for body in self._jointed.spec.bodies[1:]]

    @property
    def cameras(self) -> list[str]:
        return [camera.name for camera in self._jointed.spec.cameras]

    def add_object(self, wanted: Object) -> None:
        """Raise ``Refused``."""
        if wanted.name in self.objects:
            raise Refused(f"there is a body {wanted.name!r} already. choose another name")
        kind, count, meaning = SHAPES.get(wanted.shape, (None, 0, ""))
        if kind is None:
            raise Refused(f"the shape is {wanted.shape!r}. use one of {', '.join(SHAPES)}")
        if len(wanted.size) != count:
            raise Refused(f"a {wanted.shape} has {count} numbers as size ({meaning}), not {len(wanted.size)}")
        spec, plain = self._jointed.spec, PLAIN.default
        added: list[Any] = []
        if wanted.shape == "mesh":
            file = _mesh_file(wanted.mesh)
            added.append(spec.add_mesh(default=plain, name=wanted.name, file=file, scale=list(wanted.size)))
        material = spec.add_material(default=plain, name=f"object {wanted.name}", rgba=list(wanted.color))
        body = spec.worldbody.add_body(name=wanted.name, pos=list(wanted.position), quat=list(wanted.orientation))
        added += [material, body]
        if not wanted.fixed:
            body.add_freejoint(name=wanted.name)
        geom = body.add_geom(
            default=plain, name=wanted.name, type=kind, contype=TOUCHES, conaffinity=TOUCHES, mass=wanted.mass_kg
        )
        geom.material = material.name
        if wanted.shape == "mesh":
            geom.meshname = wanted.name
        else:
            geom.size = _half(wanted.shape, wanted.size)
        self._compile(added)

    def remove_object(self, name: str) -> None:
        """Raise ``Refused`` for a name that was not added."""
        spec = self._jointed.spec
        material = spec.material(f"object {name}")
        if material is None:
            raise Refused(f"no object {name!r} was added here")
        spec.delete(spec.body(name))
        spec.delete(material)
        mesh = spec.mesh(name)
        if mesh is not None:
            spec.delete(mesh)
        self._compile([])

    def add_camera(self, wanted: Camera) -> None:
        """Raise ``Refused``."""
        spec = self._jointed.spec
        if wanted.name in self.cameras:
            raise Refused(f"there is a camera {wanted.name!r} already. choose another name")
        carrier = spec.body(wanted.body) if wanted.body else spec.worldbody
        if carrier is None:
            raise Refused(f"there is no body {wanted.body!r}. there are {', '.join(self.objects)}")
        away = np.subtract(wanted.target, wanted.position)
        if not np.linalg.norm(away) > 1e-9:
            raise Refused("the camera stands at its target. give it another position")
        camera = carrier.add_camera(
            default=PLAIN.default,
            name=wanted.name,
            pos=list(wanted.position),
            quat=_looking(away),
            fovy=wanted.fov_deg,
        )
        self._compile([camera])

    def place(self, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Put the robot's base there, with all that stands on it."""
        jointed = self._jointed
        turn = np.asarray(orientation) / np.linalg.norm(orientation)
        outermost = [_outermost(body) for body in jointed.spec.worldbody.bodies]
        place = jointed.spec.worldbody.add_frame(pos=list(position), quat=turn.tolist())
        for element in outermost:
            element.set_frame(place)
        jointed.placed = np.asarray(position, float), turn
        self._compile([])
        self._jointed.begin_anew()

    # -- saved states

    def save(self, name: str) -> None:
        """Keep everything that moves, under a name."""
        jointed = self._jointed
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(jointed.model, kind))
        mujoco.mj_getState(jointed.model, jointed.data, state, kind)
        self._saved[name] = state

    def load(self, name: str) -> None:
        """Raise ``Refused`` for a name that was not saved, or when the scene has changed since."""
        jointed = self._jointed
        state = self._saved.get(name)
        if state is None:
            known = ", ".join(self._saved) or "none"
            raise Refused(f"no state {name!r} was saved. there are {known}")
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        if len(state) != mujoco.mj_stateSize(jointed.model, kind):
            raise Refused(f"objects came or went since the state {name!r} was saved. save it anew")
        time_s = float(jointed.data.time)
        mujoco.mj_setState(jointed.model, jointed.data, state, kind)
        jointed.set_clock_back(time_s - float(jointed.data.time))
        mujoco.mj_forward(jointed.model, jointed.data)

    def _compile(self, added: list[Any]) -> None:
        """Take what was added into the model, or leave both as they were."""
        try:
            self._jointed.recompile()
        except ValueError as error:
            for element in reversed(added):
                self._jointed.spec.delete(element)
            raise Refused(f"the model does not take it: {' '.join(str(error).split())}") from None
        self.changed()


def _outermost(body: Any) -> Any:
    """Return the frame that a body stands in, the outermost of nested ones, or the body itself."""
    element = body
    while element.frame is not None:
        element = element.frame
    return element


def scenery_of(body: object) -> Scenery:
    """Raise ``Refused`` for a body without one."""
    scenery: Scenery | None = getattr(body, "scenery", None)
    if scenery is None:
        raise Refused("nothing can be put into this robot's simulation")
    return scenery


def _half(shape: str, size: Sequence[float]) -> list[float]:
    return [*(value / 2 for value in size), 0.0, 0.0][:3]


def _mesh_file(path: str) -> str:
    place = Path(path).expanduser()
    if not place.is_file():
        raise Refused(f"there is no mesh {path!r}. give mesh_path=, a file that ends with .stl, .obj or .msh")
    return str(place.resolve())


def _looking(away: Any) -> list[float]:
    """Return the orientation of a camera that looks along ``away``, upright."""
    forward = away / np.linalg.norm(away)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1 - 1e-6 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    quat = np.zeros(4)
    columns = np.column_stack([right, np.cross(right, forward), -forward])
    mujoco.mju_mat2Quat(quat, columns.flatten())
    if not math.isfinite(float(quat.sum())):
        raise Refused("the camera looks nowhere. give another target")
    turned: list[float] = quat.tolist()
    return turned
