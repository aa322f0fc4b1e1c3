"""Decorate a model for pictures: light, ground, sky, colours, motors at the joints, and the camera's view."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco
from strands_actors.drivers.common.physics.scenery import LIGHT

from .looks.dress import dress, is_bare
from .wrist import add_wrist

MAX_WIDTH, MAX_HEIGHT = 2560, 1600

GRAPHITE = (0.17, 0.19, 0.22, 1.0)
SHELL = (0.90, 0.90, 0.88, 1.0)
ACCENT = (0.96, 0.47, 0.13, 1.0)

CAMERAS = {"": (135.0, -22.0), "front": (180.0, -12.0), "side": (90.0, -12.0), "top": (180.0, -89.0)}
"""Azimuth and elevation of the camera's line of sight in degrees. It points at the middle of the robot."""

_SLACK = 1.15
"""The camera moves back when the robot reaches further than this multiple of the view's radius."""

_ROOM = 1.0
"""Factor of the camera's distance. No margin is needed, since a robot looks smaller than the ball around
it."""


MAIN_LAMP_DEG = (-52.1, 55.2)
"""Azimuth and elevation of the direction from which the main lamp shines."""

SKY, GROUND = "strands_actors sky", "strands_actors ground"
"""Names that no model uses for its sky and ground."""


class View(NamedTuple):
    """A sphere around the whole robot, at which the camera looks. Lengths are in metres."""

    middle: tuple[float, float, float]
    radius: float


def decorate(spec: Any, view: View) -> Any:
    """Return a copy of a model, decorated for ``view`` and not compiled yet. It has the same joints."""
    scene = spec.copy()
    scene.stat.center, scene.stat.extent = view.middle, view.radius
    scene.visual.global_.azimuth, scene.visual.global_.elevation = CAMERAS[""]
    scene.visual.quality.offsamples = 4
    scene.visual.quality.shadowsize = 4096
    # The clip distance of shadows is a multiple of the model's extent. With a smaller value, the edge of the shadow
    # map shows as speckles on the ground.
    scene.visual.map.shadowclip = 4
    scene.visual.headlight.ambient = [0.30, 0.30, 0.32]
    scene.visual.headlight.diffuse = [0.30, 0.30, 0.30]
    scene.visual.headlight.specular = [0.0, 0.0, 0.0]
    scene.visual.rgba.haze = [0.80, 0.85, 0.90, 1.0]
    _add_sky_and_ground(scene)
    _add_lights(scene, view)
    if not dress(scene):
        for body in scene.bodies[1:]:
            _colour(body)
    add_wrist(scene)
    return scene


def view_of(model: Any, data: Any) -> View:
    """Return a view of everything except the ground, in the pose of ``data``."""
    kept = [index for index in range(model.ngeom) if model.geom_type[index] != mujoco.mjtGeom.mjGEOM_PLANE]
    if not kept:
        return View((0.0, 0.0, 0.0), 1.0)
    places, sizes = data.geom_xpos[kept], model.geom_rbound[kept][:, None]
    low, high = (places - sizes).min(axis=0), (places + sizes).max(axis=0)
    low[2] = min(max(low[2], 0.0), high[2])
    middle = (low + high) / 2
    return View(
        (float(middle[0]), float(middle[1]), float(middle[2])),
        float(np.max(np.linalg.norm(places - middle, axis=1) + sizes[:, 0])),
    )


def widened(view: View, model: Any, data: Any) -> View:
    """Return ``view``, with a larger radius if the robot would not fit into it in its present pose."""
    now = view_of(model, data)
    away = math.dist(view.middle, now.middle)
    return view if away + now.radius <= view.radius * _SLACK else view._replace(radius=away + now.radius)


def look(eye: Any, model: Any, view: View, width: int, height: int, camera: str = "") -> None:
    """Place an ``MjvCamera`` so that it shows the whole ``view``.

    Args:
        eye: The camera, which is changed.
        model: The compiled model.
        view: The view.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
        camera: The direction of the camera, a key of ``CAMERAS``.
    """
    eye.type = mujoco.mjtCamera.mjCAMERA_FREE
    eye.lookat[:] = view.middle
    eye.distance = _distance_m(model, view, width, height)
    eye.azimuth, eye.elevation = CAMERAS[camera]


def _distance_m(model: Any, view: View, width: int, height: int) -> float:
    """Return the distance of the camera, in metres, at which the whole ``view`` fits into the picture."""
    half = math.radians(float(model.vis.global_.fovy)) / 2
    narrow = min(half, math.atan(math.tan(half) * width / height))
    return view.radius * _ROOM / math.sin(narrow)


def _add_sky_and_ground(scene: Any) -> None:
    kinds, patterns = mujoco.mjtTexture, mujoco.mjtBuiltin
    scene.add_texture(
        name=SKY,
        type=kinds.mjTEXTURE_SKYBOX,
        builtin=patterns.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.68, 0.82],
        rgb2=[0.93, 0.95, 0.97],
        width=256,
        height=1536,
    )
    scene.add_texture(
        name=GROUND,
        type=kinds.mjTEXTURE_2D,
        builtin=patterns.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.76, 0.78, 0.80],
        rgb2=[0.70, 0.72, 0.75],
        markrgb=[0.60, 0.62, 0.66],
        width=256,
        height=256,
    )
    ground = scene.add_material(
        default=PLAIN.default, name=GROUND, texrepeat=[5, 5], texuniform=True, reflectance=0.08
    )
    ground.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = GROUND
    for geom in scene.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.material = GROUND
            # Size 0 makes the ground plane infinite.
            geom.size = [0, 0, 0.05]


def _add_lights(scene: Any, view: View) -> None:
    """Add a lamp above the robot on one side, and a weaker lamp on the other side. The distance of the lamps
    depends on the size of the robot."""
    middle = np.asarray(view.middle)
    chosen = scene.numeric(LIGHT)
    brightness, azimuth_deg, elevation_deg = (1.0, *MAIN_LAMP_DEG) if chosen is None else chosen.data
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    main = [-level * math.cos(azimuth), -level * math.sin(azimuth), -math.sin(elevation)]
    for towards, share, shadow in ((main, 0.6, True), ([-0.6, -0.6, -0.5], 0.2, False)):
        strength = min(1.0, share * brightness)
        scene.worldbody.add_light(
            default=PLAIN.default,
            pos=middle - np.asarray(towards) * view.radius * 5,
            dir=towards,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            castshadow=shadow,
            diffuse=[strength] * 3,
            specular=[0.25 * shadow] * 3,
        )


def _colour(body: Any) -> None:
    """Colour the parts of a body: base and motors dark, links light, the last link in the accent colour. Do nothing
    if the model defines colours for the body."""
    shapes = list(body.geoms)
    moves = list(body.joints)
    if not all(map(is_bare, shapes)):
        return
    for geom in shapes:
        geom.rgba = GRAPHITE if not moves else SHELL if list(body.bodies) else ACCENT
    for joint in moves:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and shapes:
            behind = list(body.parent.geoms) if body.parent.name != "world" else []
            behind = [geom for geom in behind if not geom.meshname]
            _add_motor(body, joint, min(map(_thickness, [shapes[0], *behind])))


def _add_motor(body: Any, joint: Any, radius: float) -> None:
    """Add a cylinder without mass around the joint's axis, which looks like a motor."""
    place, axis = np.asarray(joint.pos), np.asarray(joint.axis)
    reach = axis / np.linalg.norm(axis) * radius * 1.15
    body.add_geom(
        default=PLAIN.default,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[*(place - reach), *(place + reach)],
        size=[radius * 1.12, 0, 0],
        rgba=GRAPHITE,
        mass=0,
        contype=0,
        conaffinity=0,
    )


def _thickness(geom: Any) -> float:
    """Return half the thickness of a link, measured across its length."""
    sizes = [float(size) for size in geom.size if size > 0]
    if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
        return sorted(sizes)[1] if len(sizes) > 1 else 0.02
    return sizes[0] if sizes else 0.02
