"""Change the scenery of a running simulation: objects, cameras, saved states, and the position of the robot.

Each change compiles the model again. Moving bodies continue with their positions and speeds.
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

LIGHT = "strands_actors light"
"""Name of the numbers in a model that state its light: brightness, azimuth and elevation in degrees."""

TOUCHES = 3
"""Objects touch the floor (1), links (2) and each other."""


class Refused(Exception):
    """The change is refused. The exception's text has the reason and the accepted values."""


class Object(NamedTuple):
    name: str
    shape: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]  # quaternion w, x, y, z
    size: tuple[float, ...]
    color: tuple[float, ...]  # red, green, blue, opacity; 0 to 1
    mass_kg: float
    fixed: bool
    mesh: str = ""


class Camera(NamedTuple):
    name: str
    position: tuple[float, ...]
    target: tuple[float, ...]
    fov_deg: float
    body: str = ""  # name of the body that carries the camera; empty if it is fixed in the world


class Scenery:
    """The scenery around one simulated body (objects, cameras, saved states, place of the robot). ``changed`` is
    called after each change of the model."""

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

    def add_object(self, requested: Object) -> None:
        """Raise ``Refused``."""
        if requested.name in self.objects:
            raise Refused(f"there is a body {requested.name!r} already. Choose another name")
        geom_type, count, meaning = SHAPES.get(requested.shape, (None, 0, ""))
        if geom_type is None:
            raise Refused(f"the shape is {requested.shape!r}. Use one of {', '.join(SHAPES)}")
        if len(requested.size) != count:
            raise Refused(f"a {requested.shape} has {count} numbers as size ({meaning}), not {len(requested.size)}")
        spec, plain = self._jointed.spec, PLAIN.default
        added: list[Any] = []
        if requested.shape == "mesh":
            file = _mesh_file(requested.mesh)
            added.append(spec.add_mesh(default=plain, name=requested.name, file=file, scale=list(requested.size)))
        material = spec.add_material(default=plain, name=f"object {requested.name}", rgba=list(requested.color))
        body = spec.worldbody.add_body(
            name=requested.name, pos=list(requested.position), quat=list(requested.orientation)
        )
        added += [material, body]
        if not requested.fixed:
            body.add_freejoint(name=requested.name)
        geom = body.add_geom(
            default=plain,
            name=requested.name,
            type=geom_type,
            contype=TOUCHES,
            conaffinity=TOUCHES,
            mass=requested.mass_kg,
        )
        geom.material = material.name
        if requested.shape == "mesh":
            geom.meshname = requested.name
        else:
            geom.size = _half(requested.shape, requested.size)
        self._compile(added)

    def poses(self) -> dict[str, tuple[float, ...]]:
        """Return position (m) and orientation (w, x, y, z) of each object that was added."""
        jointed = self._jointed
        names = [name for name in self.objects if jointed.spec.material(f"object {name}") is not None]
        bodies = {name: jointed.data.body(name) for name in names}
        return {name: (*body.xpos.tolist(), *body.xquat.tolist()) for name, body in bodies.items()}

    def set_light(self, light: tuple[float, float, float]) -> None:
        """Set the light of pictures: brightness (1 is the usual light), azimuth and elevation in degrees."""
        numbers = self._jointed.spec.numeric(LIGHT)
        if numbers is None:
            numbers = self._jointed.spec.add_numeric(name=LIGHT, size=len(light))
        numbers.data = light
        self._compile([])

    def pause(self, on: bool) -> None:
        """Stop the simulated time, so that it advances only by steps, or let it run again."""
        self._jointed.pause(on)

    def remove_object(self, name: str) -> None:
        """Remove an object. Raise ``Refused`` if no object with this name was added."""
        spec = self._jointed.spec
        material = spec.material(f"object {name}")
        if material is None:
            raise Refused(f"no object {name!r} was added to this simulation")
        spec.delete(spec.body(name))
        spec.delete(material)
        mesh = spec.mesh(name)
        if mesh is not None:
            spec.delete(mesh)
        self._compile([])

    def add_camera(self, requested: Camera) -> None:
        """Raise ``Refused``."""
        spec = self._jointed.spec
        if requested.name in self.cameras:
            raise Refused(f"there is a camera {requested.name!r} already. Choose another name")
        carrier = spec.body(requested.body) if requested.body else spec.worldbody
        if carrier is None:
            raise Refused(f"there is no body {requested.body!r}. Use one of {', '.join(self.objects)}")
        away = np.subtract(requested.target, requested.position)
        if not np.linalg.norm(away) > 1e-9:
            raise Refused("the camera's position is its target. Give another position")
        camera = carrier.add_camera(
            default=PLAIN.default,
            name=requested.name,
            pos=list(requested.position),
            quat=_looking(away),
            fovy=requested.fov_deg,
        )
        self._compile([camera])

    def place(self, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Move the robot's base to this position and orientation, together with everything that is fixed to the
        world. The simulation then starts again in its initial state."""
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
        """Save the state of all moving parts under a name."""
        jointed = self._jointed
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(jointed.model, signature))
        mujoco.mj_getState(jointed.model, jointed.data, state, signature)
        self._saved[name] = state

    def load(self, name: str) -> None:
        """Return to a saved state. Raise ``Refused`` if there is no such state, or objects have changed since."""
        jointed = self._jointed
        state = self._saved.get(name)
        if state is None:
            names = ", ".join(self._saved) or "none"
            raise Refused(f"no state {name!r} was saved. Saved states: {names}")
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        if len(state) != mujoco.mj_stateSize(jointed.model, signature):
            raise Refused(f"objects were added or removed since the state {name!r} was saved. save the state again")
        time_s = float(jointed.data.time)
        mujoco.mj_setState(jointed.model, jointed.data, state, signature)
        jointed.set_clock_back(time_s - float(jointed.data.time))
        mujoco.mj_forward(jointed.model, jointed.data)

    def _compile(self, added: list[Any]) -> None:
        """Compile the model with the added elements. If this fails, remove them again and raise ``Refused``."""
        try:
            self._jointed.recompile()
        except ValueError as error:
            for element in reversed(added):
                self._jointed.spec.delete(element)
            raise Refused(f"the model does not accept the change: {' '.join(str(error).split())}") from None
        self.changed()


def _outermost(body: Any) -> Any:
    """Return the outermost frame (``MjsFrame``) around a body, or the body itself if it has no frame."""
    element = body
    while element.frame is not None:
        element = element.frame
    return element


def scenery_of(body: object) -> Scenery:
    """Return the scenery of a simulated body. Raise ``Refused`` if it has no scenery."""
    scenery: Scenery | None = getattr(body, "scenery", None)
    if scenery is None:
        raise Refused("this robot's simulation takes no objects and no cameras")
    return scenery


def _half(shape: str, size: Sequence[float]) -> list[float]:
    return [*(value / 2 for value in size), 0.0, 0.0][:3]


def _mesh_file(path: str) -> str:
    place = Path(path).expanduser()
    if not place.is_file():
        raise Refused(f"there is no mesh file {path!r}. Give mesh_path=, a file that ends with .stl, .obj or .msh")
    return str(place.resolve())


def _looking(away: Any) -> list[float]:
    """Return the orientation of an upright camera that looks in the direction ``away``."""
    forward = away / np.linalg.norm(away)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1 - 1e-6 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    quat = np.zeros(4)
    columns = np.column_stack([right, np.cross(right, forward), -forward])
    mujoco.mju_mat2Quat(quat, columns.flatten())
    if not math.isfinite(float(quat.sum())):
        raise Refused("the camera's position and target give no direction. Give another target")
    turned: list[float] = quat.tolist()
    return turned
