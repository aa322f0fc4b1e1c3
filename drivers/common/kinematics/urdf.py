"""Write the description of a robot (URDF) from the rows of its links. Pure.

The rows are those of ``link_rows``, from which the twin is built. The names of links
have no prefix, and the first one is ``base``. Shapes are the coarse ones of the twin. URDF has no capsule, so a
capsule becomes a cylinder of the same length.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from xml.sax.saxutils import quoteattr

from .link_rows import Row, numbers, parse_rows

BASE = "base"
_ZERO = (0.0, 0.0, 0.0)
_INERTIA_KG_M2 = 1e-4
"""The rows have no moments of inertia. A small one is written, since programs refuse zero."""


def urdf_of(robot: str, link_rows: str) -> str:
    """Return the URDF of a robot.

    Args:
        robot: The name of the robot.
        link_rows: One row for each moving link, in metres and radians.

    Raises:
        ValueError: A row is malformed.
    """
    rows = parse_rows(link_rows)
    parts = [f'<link name="{BASE}"/>']
    for row in rows:
        children = [child for child in rows if child.parent == row.body]
        parts += [_link(row, children), _joint(row)]
    return "\n".join(['<?xml version="1.0"?>', f"<robot name={quoteattr(robot)}>", *parts, "</robot>", ""])


def _link(row: Row, children: Sequence[Row]) -> str:
    moments = " ".join(f'{name}="{_INERTIA_KG_M2 * row.kg:g}"' for name in ("ixx", "iyy", "izz"))
    mass = (
        f'<inertial><origin xyz="{_words(row.com or _ZERO)}"/><mass value="{row.kg:g}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    shape = "".join(f"<{use}>{shape}</{use}>" for shape in _shape(row, children) for use in ("visual", "collision"))
    return f"<link name={quoteattr(row.body)}>{mass}{shape}</link>"


def _shape(row: Row, children: Sequence[Row]) -> Iterator[str]:
    """Yield the shape of a link, if it has one."""
    if row.geom is None:
        return
    form, (shape, _, place) = row.geom[0], row.geom[1:].partition("@")
    sizes = numbers(shape)
    point = numbers(place) if place else None
    if form == "b":
        size = _words([2 * half for half in sizes])
        yield f'<origin xyz="{_words(point or _ZERO)}"/><geometry><box size="{size}"/></geometry>'
    elif form == "s":
        yield f'<origin xyz="{_words(point or _ZERO)}"/><geometry><sphere radius="{sizes[0]:g}"/></geometry>'
    elif form == "y":
        size = f'radius="{sizes[0]:g}" length="{2 * sizes[1]:g}"'
        yield f'<origin xyz="{_words(point or _ZERO)}"/><geometry><cylinder {size}/></geometry>'
    else:  # A capsule from the origin to a point, or to the first child.
        end = point or (children[0].xyz if children else _ZERO)
        length = math.dist(_ZERO, end)
        if length > 0.0:
            middle = _words([value / 2 for value in end])
            origin = f'<origin xyz="{middle}" rpy="{_words(_towards(end))}"/>'
            yield f'{origin}<geometry><cylinder radius="{sizes[0]:g}" length="{length:g}"/></geometry>'


def _joint(row: Row) -> str:
    name = row.joint or f"{row.body}_mount"
    places = f"<parent link={quoteattr(row.parent)}/><child link={quoteattr(row.body)}/>"
    origin = f'<origin xyz="{_words(row.xyz)}" rpy="{_words(rpy_of(row.quat))}"/>'
    if row.joint is None:
        return f'<joint name={quoteattr(name)} type="fixed">{places}{origin}</joint>'
    effort, velocity = row.effort or 0.0, row.velocity or 0.0
    bounds = "" if row.limits is None else f'lower="{row.limits[0]:g}" upper="{row.limits[1]:g}" '
    limit = f'<limit {bounds}effort="{effort:g}" velocity="{velocity:g}"/>'
    kind = ("prismatic" if row.slide else "revolute") if row.limits else "continuous"
    axis = f'<axis xyz="{_words(row.axis)}"/>'
    return f'<joint name={quoteattr(name)} type="{kind}">{places}{origin}{axis}{limit}</joint>'


def rpy_of(quat: Sequence[float]) -> tuple[float, float, float]:
    """Return the angles about the fixed axes x, y and z for a quaternion w, x, y, z, in radians."""
    length = math.sqrt(sum(value * value for value in quat))
    w, x, y, z = (value / length for value in quat)
    sine = 2 * (w * y - z * x)
    if abs(sine) > 1 - 1e-9:  # Pitched by 90 degrees, where roll and yaw are about the same axis.
        return 0.0, math.copysign(math.pi / 2, sine), -2 * math.copysign(1.0, sine) * math.atan2(x, w)
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(sine),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def _towards(point: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation that turns the axis of a cylinder (z) towards a point."""
    x, y, z = point
    return 0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)


def _words(values: Sequence[float]) -> str:
    # Adding zero turns a negative zero into a positive one.
    return " ".join(f"{round(value, 9) + 0.0:.9g}" for value in values)
