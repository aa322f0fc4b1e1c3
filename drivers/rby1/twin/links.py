"""The links of the robot by the vendor's names, and their places in the model of the simulated robot.

In the vendor's URDF no link is rotated against its parent at the zero position. In ``robots.toml`` the first links
of the arms are, because a row has only axes along x, y and z. ``frames_of`` gives the rotations between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.kinematics.link_rows import Row

Matrix = Any

FLANGE_M = (0.0, 0.0, -0.1261)
"""Place of the tool in the frame of an arm's last link, from the vendor's URDF."""

_TORSO, _HEAD = "abcdef", {"neck": 0, "head_a": 1, "head_b": 2}


class Place(NamedTuple):
    """A link: a body of the model, a point in the body's frame, and the rotation from the link to the body."""

    body: str
    offset_m: tuple[float, float, float]
    turn: Matrix


def link_of(body: str) -> str:
    """Return the vendor's name of a body."""
    if body in _HEAD:
        return f"link_head_{_HEAD[body]}"
    part, _, rest = body.partition("_")
    if part == "torso":
        return f"link_torso_{_TORSO.index(rest)}"
    return f"link_{part}_arm_{rest}" if rest else body


def frames_of(rows: Sequence[Row]) -> dict[str, Matrix]:
    """Return for each body the rotation from its own frame to the vendor's frame of the link."""
    frames: dict[str, Matrix] = {"base": np.eye(3)}
    for row in rows:
        w, x, y, z = row.quat
        frames[row.body] = frames[row.parent] @ matrix_of(w, x, y, z)
    return frames


def places_of(rows: Sequence[Row]) -> dict[str, Place]:
    """Return the places of all links, with the tools."""
    places = {link_of(body): Place(body, (0.0, 0.0, 0.0), frame.T) for body, frame in frames_of(rows).items()}
    for side in ("right", "left"):
        places[f"ee_{side}"] = Place(f"{side}_6", FLANGE_M, np.eye(3))
    return places


def matrix_of(w: float, x: float, y: float, z: float) -> Matrix:
    """Return the rotation matrix of a unit quaternion."""
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )
