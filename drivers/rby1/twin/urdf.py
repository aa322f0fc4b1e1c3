"""Build the URDF that the simulated robot sends, from the links in ``robots.toml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import asin, atan2
from typing import Any

from strands_actors.drivers.common.physics.model_rows import LINK_EXTENT_M, Row, parse_rows

WHEELS = ("right_wheel", "left_wheel")

_INERTIA = '<inertia ixx="{0:g}" iyy="{0:g}" izz="{0:g}" ixy="0" ixz="0" iyz="0"/>'


def urdf_of(table: Mapping[str, Any]) -> str:
    rows = parse_rows(table["model_rows"])
    base = _link("base", float(table["base"]["kg"]), (0.0, 0.0, 0.14))
    wheels = [_wheel(name, side) for name, side in zip(WHEELS, (-0.265, 0.265), strict=True)]
    return "\n".join(['<robot name="RBY1_A">', base, *wheels, *map(_row, rows), "</robot>"])


def _row(row: Row) -> str:
    joint_type = "revolute" if row.joint else "fixed"
    limit = ""
    if row.limits:
        low, high = row.limits
        ends = f'lower="{low}" upper="{high}"'
        limit = f'<limit {ends} velocity="{row.velocity}" effort="{row.effort}" acceleration="10"/>'
    joint = _joint(
        row.joint or f"{row.body}_base", joint_type, row.parent, row.body, row.xyz, _rpy(row.quat), row.axis
    )
    return _link(row.body, row.kg, row.com or (0.0, 0.0, 0.0)) + "\n" + joint.format(limit=limit)


def _wheel(name: str, y_m: float) -> str:
    limit = '<limit velocity="15.7" effort="100" acceleration="3.14"/>'
    joint = _joint(name, "continuous", "base", f"{name}_link", (0.228, y_m, 0.1), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    return _link(f"{name}_link", 1.378, (0.0, 0.0, 0.0)) + "\n" + joint.format(limit=limit)


def _link(name: str, kg: float, com: Sequence[float]) -> str:
    inertia = _INERTIA.format(kg * LINK_EXTENT_M**2 / 12)
    origin = f'<origin xyz="{_words(com)}" rpy="0 0 0"/>'
    return f'<link name="{name}"><inertial><mass value="{kg}"/>{origin}{inertia}</inertial></link>'


def _joint(
    name: str,
    joint_type: str,
    parent: str,
    child: str,
    xyz: Sequence[float],
    rpy: Sequence[float],
    axis: Sequence[float],
) -> str:
    return (
        f'<joint name="{name}" type="{joint_type}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/><axis xyz="{_words(axis)}"/>{{limit}}</joint>'
    )


def _rpy(quat: Sequence[float]) -> tuple[float, float, float]:
    w, x, y, z = quat
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def _words(row: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in row)
