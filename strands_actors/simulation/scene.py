"""Check the objects, cameras and robot placement that a caller puts into a simulation. The argument names are
the same as in strands-robots."""

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
"""Default size of an object by shape: full extents in metres, so that a gripper can hold it."""

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
    """Check the arguments of ``SimRobot.add_object``, and return the object's fields for the simulation. Raise
    ``ValueError`` for a wrong argument."""
    if mesh_path is not None and shape == "box":
        shape = "mesh"
    if shape not in SIZES:
        raise ValueError(f"shape is {shape!r}. Use one of {', '.join(SIZES)}")
    if (shape == "mesh") != (mesh_path is not None):
        raise ValueError("shape='mesh' and mesh_path= belong together. Give both, or neither")
    if is_static not in (None, True, False):
        raise ValueError(f"is_static is {is_static!r}. Give True or False")
    mass_kg = _number("mass", mass)
    if mass_kg <= 0:
        raise ValueError(f"mass is {mass!r}. Give kilograms, above 0")
    sizes = _row("size", size, SIZES[str(shape)])
    if min(sizes) <= 0:
        raise ValueError(f"size is {size!r}. Give metres, above 0")
    colors = _row("color", color, GREY, counts=(3, 4))
    if not all(0 <= part <= 1 for part in colors):
        raise ValueError(f"color is {color!r}. Give red, green, blue and, if wanted, alpha, each from 0 to 1")
    return {
        "name": _name(name),
        "shape": shape,
        "position": _row("position", position, ORIGIN),
        "orientation": turned(orientation),
        "size": sizes,
        "color": colors if len(colors) == 4 else (*colors, 1.0),
        "mass_kg": mass_kg,
        "fixed": bool(is_static),
        "mesh": "" if mesh_path is None else str(mesh_path),
    }


def camera_fields(
    name: object, position: object, target: object, fov: object, parent_body: object
) -> dict[str, Any]:
    """Check the arguments of ``SimRobot.add_camera``, and return the camera's fields for the simulation. Raise
    ``ValueError`` for a wrong argument."""
    fov_deg = _number("fov", fov)
    if not 0 < fov_deg < 180:
        raise ValueError(f"fov is {fov!r}. Give degrees, above 0 and below 180")
    return {
        "name": _name(name),
        "position": _row("position", position, (0.5, 0.5, 0.5)),
        "target": _row("target", target, ORIGIN),
        "fov_deg": fov_deg,
        "body": "" if parent_body is None else str(parent_body),
    }


def light_fields(brightness: object, azimuth: object, elevation: object) -> dict[str, Any]:
    """Check the arguments of ``SimRobot.set_light``, and return the fields for the simulation. Raise ``ValueError``
    for a wrong argument."""
    bright = _number("brightness", brightness)
    height = _number("elevation", elevation)
    if not 0 <= bright <= 10:
        raise ValueError(f"brightness is {brightness!r}. Give a number from 0 (dark) to 10; 1 is the usual light")
    if not 0 < height <= 90:
        raise ValueError(f"elevation is {elevation!r}. Give degrees, above 0 and at most 90")
    return {"brightness": bright, "azimuth_deg": _number("azimuth", azimuth), "elevation_deg": height}


def check_size(width: object, height: object) -> None:
    """Raise ``ValueError`` unless width and height are whole numbers above 0."""
    if not all(isinstance(size, int) and size > 0 for size in (width, height)):
        raise ValueError(
            f"the picture's size is {width!r} x {height!r}. Give width and height as whole numbers above 0"
        )


def placement(position: object, orientation: object) -> dict[str, Any] | None:
    """Return the position and orientation of the robot's base. Return None if neither is given. Then the base
    stays where the model puts it. Raise ``ValueError`` for a wrong argument."""
    if position is None and orientation is None:
        return None
    return {
        "position": _row("position", position, ORIGIN),
        "orientation": turned(orientation),
    }


def turned(orientation: object) -> tuple[float, ...]:
    """Return an orientation as a quaternion w, x, y, z; None means upright. Raise ``ValueError`` for a wrong
    argument."""
    quat = _row("orientation", orientation, UPRIGHT)
    if not math.hypot(*quat) > 1e-6:
        raise ValueError(f"orientation is {orientation!r}. Give a quaternion w, x, y, z that is not zero")
    return quat


def state_name(name: object) -> str:
    return _name(name)


def _name(name: object) -> str:
    if not isinstance(name, str) or not name.strip() or len(name) > 64:
        raise ValueError(f"the name is {name!r}. Give a text of 1 to 64 characters")
    return name


def _row(name: str, given: object, default: tuple[float, ...], counts: Sequence[int] = ()) -> tuple[float, ...]:
    if given is None:
        return default
    allowed = counts or (len(default),)
    values = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else _listed(given)
    if len(values) not in allowed:
        raise ValueError(f"{name} is {given!r}. Give {' or '.join(map(str, allowed))} numbers")
    return tuple(_number(name, value) for value in values)


def _listed(value: object) -> tuple[object, ...]:
    """Return the numbers of a one-dimensional array; empty for any other object."""
    values = getattr(value, "tolist", lambda: None)()
    return tuple(values) if isinstance(values, list) else ()


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}. Give finite numbers")
    return float(value)
