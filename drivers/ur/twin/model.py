"""Build the simulation model of a UR arm from its table in ``robots.toml``."""

from __future__ import annotations

import math
from typing import Any

from strands_actors.contract.loading import load
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.ur.arms import JOINTS, MOUNTED, Arm

from .looks import looks_of

HOME_RAD = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)
"""Joint positions of the simulated arm at its start in rad: upright, with a bent elbow."""


FLANGE = "wrist_3"
"""The link of the arm that carries a tool. Its frame is the flange of the DH chain."""


def model_table(arm: Arm, gripper: str = "") -> dict[str, Any]:
    """Return the arm as a table from which ``drivers/common/physics/model_rows`` builds the model.

    The centres of mass are the vendor's, rounded.

    Args:
        arm: The arm.
        gripper: Name of the gripper on its flange; empty for none.
    """
    d1, a2, a3, d4, d5, d6 = arm.dh_m
    bodies = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    places = ((0, 0, d1), (0, 0, 0), (a2, 0, 0), (a3, 0, d4), (0, -d5, 0), (0, d6, 0))
    turns = ("0", "90,0,0", "0", "0", "90,0,0", "90,180,180")
    centres = (
        (0, -0.0019, -0.0256),
        (a2 / 2, 0, 0.85 * d4),
        (0.6 * a3, 0, 0.2 * d4),
        (0, -0.016, -0.002),
        (0, 0.016, -0.002),
        (0, 0, -0.02),
    )
    radius, axes = arm.radius_m, arm.axes
    shapes = (
        f"s{radius}",
        f"c{radius}@{a2},0,{0.85 * d4}",
        f"c{0.8 * radius}@{a3},0,{0.2 * d4}",
        f"s{0.8 * radius}",
        f"s{0.8 * radius}",
        f"y{0.7 * radius},0.02",
    )
    rows = [
        " ".join(
            (
                body,
                bodies[joint - 1] if joint else "base",
                JOINTS[joint],
                "z",
                _triple(places[joint]),
                turns[joint],
                f"{axes[joint].low},{axes[joint].high}",
                str(arm.effort_nm[joint]),
                str(axes[joint].speed),
                str(arm.link_kg[joint]),
                _triple(centres[joint]),
                shapes[joint],
            )
        )
        for joint, body in enumerate(bodies)
    ]
    table = {
        "model_rows": "\n".join(rows),
        "looks": looks_of(arm.dh_m, radius),
        "home_rad": HOME_RAD,
        "gravity_compensated": True,  # The controller compensates gravity, or the brakes hold the arm.
        "armature": 0.1 * arm.effort_nm[0] / 150,  # The real value is not published: [assumed].
        "bandwidth": 40.0,
    }
    if not gripper:
        return table
    with_gripper: dict[str, Any] = load(f"{MOUNTED}:with_gripper")(table, FLANGE, gripper)
    return with_gripper


def plant_of(arm: Arm, gripper: str = "") -> Plant:
    """Return the simulated arm, with a gripper on its flange if ``gripper`` is not empty."""
    table = model_table(arm, gripper)
    spec = build(table)
    if gripper:
        load(f"{MOUNTED}:motorise")(spec)
    return Plant(spec, JOINTS, table["bandwidth"], table["home_rad"])


def _triple(numbers: tuple[float, ...]) -> str:
    return ",".join(str(number) for number in numbers)
