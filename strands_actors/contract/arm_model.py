"""The model of an arm, from which poses of its tool are computed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

TABLE_BUILDER = "strands_actors.drivers.common.physics.model_rows:build"
"""Builds a model from rows of links (``drivers/common/kinematics/link_rows``)."""


class ArmModel(msgspec.Struct, frozen=True):
    """Where the links of an arm are, and which point of it is the tool.

    The frame of the base is the frame in which the model stands. The frame of the tool is fixed to ``link``.

    Attributes:
        table: The input of ``builder``. A table of rows has ``model_rows``, and perhaps ``base``.
        joints: Keys of the axes that move the tool. The joints of the model have the same names.
        link: The body that carries the tool. Empty: ``site`` carries it.
        tool_xyz: Position of the tool in the frame of ``link``, in metres.
        tool_quat: Orientation of the tool in the frame of ``link``, as w, x, y, z.
        site: Name of the site of the model that is the tool, in place of ``link``.
        home: Joint positions in rad from which a search may start, in the order of ``joints``.
        ranges: Least and greatest position of each joint in rad, in place of the ranges of the axes.
        builder: ``module:function`` that returns the model of ``table`` as an ``MjSpec``.
    """

    table: Mapping[str, Any]
    joints: tuple[str, ...]
    link: str = ""
    tool_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tool_quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    site: str = ""
    home: tuple[float, ...] = ()
    ranges: tuple[tuple[float, float], ...] = ()
    builder: str = TABLE_BUILDER


def arm_table(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a robot's table that describes its links, with the base at the origin."""
    base = {name: value for name, value in table.get("base", {}).items() if name != "xyz"}
    return {"model_rows": table["model_rows"], "base": base}


__all__ = ["TABLE_BUILDER", "ArmModel", "arm_table"]
