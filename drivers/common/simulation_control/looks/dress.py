"""Put a robot's looks onto a copy of its model that is only drawn.

The shapes that physics uses stay in this copy, in a group that is not drawn.
"""

from __future__ import annotations

from typing import Any

from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco
from strands_actors.drivers.common.physics.model_rows import LOOKS

from .materials import MATERIALS
from .outlines import Outline, joined
from .rows import parts

HIDDEN_GROUP = 3
"""Group of the shapes that physics uses. A viewer shows it on request."""


UNPAINTED = [0.5, 0.5, 0.5, 1.0]
"""MuJoCo's default colour. It is the same in single precision."""


def is_bare(geom: Any) -> bool:
    """Return True if the model gives the shape no colour, material or mesh."""
    return not geom.material and not geom.meshname and list(geom.rgba) == UNPAINTED


def dress(scene: Any) -> bool:
    """Give the robot of a model the looks that the model carries.

    Objects that were added to the scene have a colour, and stay as they are.

    Args:
        scene: An ``MjSpec`` that is only drawn. It is changed.

    Returns:
        False if the model carries no looks.

    Raises:
        ValueError: The table of looks is wrong, or names a body that the model does not have.
    """
    table = next((text.data for text in scene.texts if text.name == LOOKS), "")
    outlines: dict[tuple[str, str], list[Outline]] = {}
    for part in parts(table):
        outlines.setdefault((part.body, part.material), []).append(part.outline)
    if not outlines:
        return False
    for body in scene.bodies[1:]:
        for geom in filter(is_bare, body.geoms):
            geom.group = HIDDEN_GROUP
    for (body_name, material), surfaces in outlines.items():
        body = scene.body(body_name)
        if body is None:
            raise ValueError(f"the looks name a body {body_name!r} that the model does not have")
        _add(scene, body, material, joined(surfaces))
    return True


def _add(scene: Any, body: Any, material: str, outline: Outline) -> None:
    name = f"looks {body.name} {material}"
    scene.add_mesh(
        default=PLAIN.default,
        name=name,
        uservert=outline.points.ravel(),
        userface=outline.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    geom = body.add_geom(
        default=PLAIN.default,
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        mass=0,
        contype=0,
        conaffinity=0,
    )
    geom.meshname = name
    geom.material = _material(scene, material)


def _material(scene: Any, name: str) -> str:
    full_name = f"looks {name}"
    if scene.material(full_name) is None:
        colour = MATERIALS[name]
        scene.add_material(
            default=PLAIN.default,
            name=full_name,
            rgba=[colour.red, colour.green, colour.blue, colour.alpha],
            specular=colour.specular,
            shininess=colour.shininess,
        )
    return full_name
