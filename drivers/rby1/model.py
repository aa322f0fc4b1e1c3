"""Read the ranges and speeds of the joints from the URDF that the robot sends. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.codecs.xml_text import Element, NotXml, parse

MAX_CHARACTERS = 500_000
_DECLARES = ("<!DOCTYPE", "<!ENTITY")


class Limits(msgspec.Struct, frozen=True):
    """Limits of the driven joints, in axis order, in radians and radians per second."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: tuple[float, ...]


def limits_of(urdf: str, joints: Sequence[str]) -> Limits:
    """Return the limits of ``joints``. Raise ``MalformedFrame``, which names the joints without limits."""
    if len(urdf) > MAX_CHARACTERS or any(word in urdf for word in _DECLARES):
        raise MalformedFrame("the robot's model is no plain URDF")
    try:
        root = parse(urdf)
    except NotXml as error:
        raise MalformedFrame(f"the robot's model is no URDF ({error})") from None
    # Read only the joints below the root: a transmission names them again, without limits.
    limits = {joint.get("name"): joint.first("limit") for joint in root.all("joint")}
    rows = [_row(limits.get(name)) for name in joints]
    if missing := [name for name, row in zip(joints, rows, strict=True) if row is None]:
        raise MalformedFrame(f"the robot's model has no limits of {', '.join(missing)}")
    low, high, speed = zip(*(row for row in rows if row is not None), strict=True)
    return Limits(low, high, speed)


def _row(limit: Element | None) -> tuple[float, float, float] | None:
    """Return low, high and speed; None when one is missing or impossible."""
    if limit is None:
        return None
    try:
        low, high, speed = (float(limit.get(name, "nan")) for name in ("lower", "upper", "velocity"))
    except ValueError:
        return None
    good = math.isfinite(low) and math.isfinite(high) and low < high and 0.0 < speed < math.inf
    return (low, high, speed) if good else None
