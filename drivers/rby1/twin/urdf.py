"""Build the URDF that the simulated robot sends, from the links in ``robots.toml``.

Names and frames of links and joints are those of the vendor's model 1.2. The rows of ``robots.toml`` have the tool
and its fingers in the last links of the arms. Here they are links of their own, as in the vendor's model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import pi
from typing import Any

from strands_actors.drivers.common.kinematics.link_rows import Row, parse_rows
from strands_actors.drivers.common.physics.model_rows import LINK_EXTENT_M

from .collisions import CAPSULES
from .links import FLANGE_M, frames_of, link_of

WHEELS = ("right_wheel", "left_wheel")
AXLE_M, TRACK_M, RADIUS_M = 0.228, 0.53, 0.1
"""Place of the axle before the base's origin, distance of the wheels, and their radius, from the vendor's model."""

_HAND_KG, _HAND_COM = 0.42751673, (0.00024951, -0.00019562, -0.10711314)
_TOOL_KG, _TOOL_COM = 0.46704998, (0.00212703, 0.00000615, -0.04287176)
_FINGER_KG, _FINGER_COM = 0.03326999, (0.00278346, -0.00000329, -0.02570112)
"""Masses of an arm's last link, of the tool and of each finger, from the vendor's model."""

_INERTIA = '<inertia ixx="{0:g}" iyy="{0:g}" izz="{0:g}" ixy="0" ixz="0" iyz="0"/>'
_MOBILE = (
    f'<mobile type="differential" xyz="{AXLE_M} 0 0" rpy="0 0 0" joints="{" ".join(WHEELS)}" '
    f'params="{TRACK_M} {RADIUS_M}"/>'
)


def urdf_of(table: Mapping[str, Any]) -> str:
    rows = parse_rows(table["model_rows"])
    frames = frames_of(rows)
    base = _link("base", float(table["base"]["kg"]), (0.0, 0.0, 0.14))
    wheels = [_wheel(name, side) for name, side in zip(WHEELS, (-TRACK_M / 2, TRACK_M / 2), strict=True)]
    tools = [part for side in ("right", "left") for part in _tool(side)]
    links = [_row(row, frames) for row in rows]
    return "\n".join(['<robot name="RBY1_A_v1.2">', _MOBILE, base, *wheels, *links, *tools, "</robot>"])


def _row(row: Row, frames: Mapping[str, Any]) -> str:
    name, frame = link_of(row.body), frames[row.body]
    limit = ""
    if row.limits:
        low, high = row.limits
        ends = f'lower="{low}" upper="{high}"'
        acceleration = 5 if name.startswith("link_torso") else 10
        limit = f'<limit {ends} velocity="{row.velocity}" effort="{row.effort}" acceleration="{acceleration}"/>'
    hand = row.body.endswith("_6")
    com = _HAND_COM if hand else tuple(frame @ (row.com or (0.0, 0.0, 0.0)))
    joint = _joint(
        row.joint or "head_base",
        "revolute" if row.joint else "fixed",
        link_of(row.parent),
        name,
        tuple(frames[row.parent] @ row.xyz),
        0.0,
        tuple(frame @ row.axis),
        limit,
    )
    return _link(name, _HAND_KG if hand else row.kg, com) + "\n" + joint


def _tool(side: str) -> Iterator[str]:
    """Yield the tool of an arm and its two fingers. The fingers of the simulated robot do not move."""
    name = f"ee_{side}"
    yield _link(name, _TOOL_KG, _TOOL_COM)
    yield _joint(f"tool_{side}", "fixed", f"link_{side}_arm_6", name, FLANGE_M)
    for number, x_m, yaw_rad in ((1, 0.003, 0.0), (2, -0.003, pi)):
        finger = f"{side[0]}{number}"
        yield _link(f"ee_finger_{finger}", _FINGER_KG, _FINGER_COM)
        yield _joint(f"gripper_finger_{finger}", "fixed", name, f"ee_finger_{finger}", (x_m, 0.0, -0.075), yaw_rad)


def _wheel(name: str, y_m: float) -> str:
    limit = '<limit velocity="15.707963268" effort="100" acceleration="3.141592"/>'
    link = f"wheel_{name[0]}"
    place = (AXLE_M, y_m, RADIUS_M)
    joint = _joint(name, "continuous", "base", link, place, 0.0, (0.0, -1.0, 0.0), limit)
    return _link(link, 1.378, (0.0, 0.0, 0.0)) + "\n" + joint


def _link(name: str, kg: float, com: Sequence[float]) -> str:
    inertia = _INERTIA.format(kg * LINK_EXTENT_M**2 / 12)
    origin = f'<origin xyz="{_words(com)}" rpy="0 0 0"/>'
    shapes = "".join(capsule.urdf() for capsule in CAPSULES if capsule.link == name)
    return f'<link name="{name}"><inertial><mass value="{kg}"/>{origin}{inertia}</inertial>{shapes}</link>'


def _joint(
    name: str,
    joint_type: str,
    parent: str,
    child: str,
    xyz: Sequence[float],
    yaw_rad: float = 0.0,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    limit: str = "",
) -> str:
    return (
        f'<joint name="{name}" type="{joint_type}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_words(xyz)}" rpy="0 0 {yaw_rad:.9g}"/><axis xyz="{_words(axis)}"/>{limit}</joint>'
    )


def _words(row: Sequence[float]) -> str:
    # Adding zero turns a negative zero into a positive one.
    return " ".join(f"{round(value, 9) + 0.0:.9g}" for value in row)
