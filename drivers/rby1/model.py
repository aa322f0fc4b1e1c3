"""Read the ranges and speeds of the joints from the URDF that the robot sends. Pure: no I/O."""

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
    """Return the limits of ``joints`` from the URDF. Raise ``MalformedFrame`` with the names of
    joints without limits."""
    if len(urdf) > MAX_CHARACTERS or any(word in urdf for word in _DECLARES):
        raise MalformedFrame("the robot's model is not a plain URDF")
    try:
        root = parse(urdf)
    except NotXml as error:
        raise MalformedFrame(f"the robot's model is not a URDF ({error})") from None
    # Read only the joints that are direct children of the root. A transmission repeats their names without
    # limits.
    limits = {joint.get("name"): joint.first("limit") for joint in root.all("joint")}
    rows = [_row(limits.get(name)) for name in joints]
    if missing := [name for name, row in zip(joints, rows, strict=True) if row is None]:
        raise MalformedFrame(f"the robot's model has no limits of {', '.join(missing)}")
    low, high, speed = zip(*(row for row in rows if row is not None), strict=True)
    return Limits(low, high, speed)


def _row(limit: Element | None) -> tuple[float, float, float] | None:
    """Return a joint's low limit, high limit and speed; None if one of them is missing or
    impossible."""
    if limit is None:
        return None
    try:
        low, high, speed = (float(limit.get(name, "nan")) for name in ("lower", "upper", "velocity"))
    except ValueError:
        return None
    good = math.isfinite(low) and math.isfinite(high) and low < high and 0.0 < speed < math.inf
    return (low, high, speed) if good else None
