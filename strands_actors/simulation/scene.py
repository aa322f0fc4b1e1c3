"""What a caller puts into a simulation, checked: objects, cameras, and where the robot stands. In
the words of the drivers page's package."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

ORIGIN = (0.0, 0.0, 0.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)

SIZES: Mapping[str, tuple[float, ...]] = {
    "box": (0.05, 0.05, 0.05),
    "sphere": (0.05,),
    "cylinder": (0.05, 0.1),
    "capsule": (0.05, 0.1),
    "mesh": (1.0, 1.0, 1.0),
}
"""Full extents in metres, of an object that says none: something that a gripper can hold."""

GREY = (0.5, 0.5, 0.5, 1.0)


def object_fields(
    name: object,
    shape: object,
    position: object,
    orientation: object,
    size: object,
    color: object,
    mass: object,
    is_static: object,
    mesh_path: object,
) -> dict[str, Any]:
    """Return what goes to the simulation. Raise ``ValueError``."""
    if mesh_path is not None and shape == "box":
        shape = "mesh"
    if shape not in SIZES:
        raise ValueError(f"add_object: shape is {shape!r}. use one of {', '.join(SIZES)}")
    if (shape == "mesh") != (mesh_path is not None):
        raise ValueError("add_object: mesh_path= is the file of shape='mesh', which needs it")
    if is_static not in (None, True, False):
        raise ValueError(f"add_object: is_static is {is_static!r}. give True or False")
    mass_kg = _number("add_object", "mass", mass)
    if mass_kg <= 0:
        raise ValueError(f"add_object: mass is {mass!r}. give kilograms, above 0")
    sizes = _row("add_object", "size", size, SIZES[str(shape)])
    if min(sizes) <= 0:
        raise ValueError(f"add_object: size is {size!r}. give metres, above 0")
    colors = _row("add_object", "color", color, GREY, counts=(3, 4))
    if not all(0 <= part <= 1 for part in colors):
        raise ValueError(f"add_object: color is {color!r}. give r, g, b and a, 0 to 1")
    return {
        "name": _name("add_object", name),
        "shape": shape,
        "position": _row("add_object", "position", position, ORIGIN),
        "orientation": turned("add_object", orientation),
        "size": sizes,
        "color": colors if len(colors) == 4 else (*colors, 1.0),
        "mass_kg": mass_kg,
        "fixed": bool(is_static),
        "mesh": "" if mesh_path is None else str(mesh_path),
    }


def camera_fields(
    name: object, position: object, target: object, fov: object, parent_body: object
) -> dict[str, Any]:
    """Return what goes to the simulation. Raise ``ValueError``."""
    fov_deg = _number("add_camera", "fov", fov)
    if not 0 < fov_deg < 180:
        raise ValueError(f"add_camera: fov is {fov!r}. give degrees, above 0 and below 180")
    return {
        "name": _name("add_camera", name),
        "position": _row("add_camera", "position", position, (0.5, 0.5, 0.5)),
        "target": _row("add_camera", "target", target, ORIGIN),
        "fov_deg": fov_deg,
        "body": "" if parent_body is None else str(parent_body),
    }


def check_size(verb: str, width: object, height: object) -> None:
    """Raise ``ValueError`` for a picture that nobody can draw."""
    if not all(isinstance(size, int) and size > 0 for size in (width, height)):
        raise ValueError(f"{verb}: a picture of {width!r} x {height!r}. give whole numbers above 0")


def placement(position: object, orientation: object) -> dict[str, Any] | None:
    """Return where the robot's base stands; None: where its model has it. Raise ``ValueError``."""
    if position is None and orientation is None:
        return None
    return {
        "position": _row("Robot", "position", position, ORIGIN),
        "orientation": turned("Robot", orientation),
    }


def turned(who: str, orientation: object) -> tuple[float, ...]:
    """Return a quaternion w, x, y, z. Raise ``ValueError``."""
    quat = _row(who, "orientation", orientation, UPRIGHT)
    if not math.hypot(*quat) > 1e-6:
        raise ValueError(f"{who}: orientation is {orientation!r}. give a quaternion w, x, y, z that is not zero")
    return quat


def state_name(who: str, name: object) -> str:
    return _name(who, name)


def _name(who: str, name: object) -> str:
    if not isinstance(name, str) or not name.strip() or len(name) > 64:
        raise ValueError(f"{who}: the name is {name!r}. give text of at most 64 letters")
    return name


def _row(
    who: str, what: str, given: object, default: tuple[float, ...], counts: Sequence[int] = ()
) -> tuple[float, ...]:
    if given is None:
        return default
    wanted = counts or (len(default),)
    values = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else _listed(given)
    if len(values) not in wanted:
        raise ValueError(f"{who}: {what} is {given!r}. give {' or '.join(map(str, wanted))} numbers")
    return tuple(_number(who, what, value) for value in values)


def _listed(given: object) -> tuple[object, ...]:
    """Return the numbers of an array; none for what is no row."""
    values = getattr(given, "tolist", lambda: None)()
    return tuple(values) if isinstance(values, list) else ()


def _number(who: str, what: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise ValueError(f"{who}: {what} is {given!r}. give finite numbers")
    return float(given)
