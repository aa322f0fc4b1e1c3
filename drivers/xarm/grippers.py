"""The grippers that an xArm may have on its flange, with their links in the model of the arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from strands_actors.drivers.common.kinematics.hand_rows import parallel_rows

Gripper = Literal["xarm_gripper", "xarm_vacuum"]
"""The values of the option ``gripper``."""

GRIPPER: Gripper = "xarm_gripper"
VACUUM: Gripper = "xarm_vacuum"

FLANGE, LINK = "link7", "hand"
FINGERS = ("left_finger_joint", "right_finger_joint")
TRAVEL_M = 0.0425
"""The way of each finger: 85 mm between both when open."""

TOOL_M: Mapping[str, float] = {GRIPPER: 0.172, VACUUM: 0.116}
"""Distance of the point between the fingers, and of the suction cups, from the flange, as the vendor has them."""

PULSES = 850
"""Position of an open gripper; 0 is closed."""
FASTEST = 5000
"""The highest speed of the gripper, in the unit of its register."""
TOP_PERCENT_S: Mapping[str, float] = {GRIPPER: 118.0, VACUUM: math.inf}
"""Top speed of the axis in percent per second [assumed]. The valve of the vacuum gripper switches."""

HAND_ID = 8
"""Number of the gripper in reports, as on the tool's bus. The joints have 1 to 7."""

_ROWS: Mapping[str, str] = {
    GRIPPER: parallel_rows(
        LINK,
        FLANGE,
        body="0,0,0 0 - - - .70 - b.035,.06,.045@0,0,.045",
        place="0,0,.14",
        finger=".05 b.012,.006,.035",
        travel_m=TRAVEL_M,
    ),
    VACUUM: f"{LINK} {FLANGE} - - 0,0,0 0 - - - .61 - y.03,.058@0,0,.058",
}
_LOOKS: Mapping[str, str] = {
    GRIPPER: f"""
{LINK}        graphite can 0,0,0:.036 0,0,.03:.036
{LINK}        white    box 0,0,.06 .035,.06,.035 .012
left_finger  graphite box 0,.006,0 .012,.006,.035 .003
right_finger graphite box 0,-.006,0 .012,.006,.035 .003
""",
    VACUUM: f"""
{LINK} white    can 0,0,0:.036 0,0,.07:.036
{LINK} graphite can 0,0,.07:.03 0,0,.116:.02
""",
}
"""Masses are the vendor's, shapes [assumed]."""


def with_gripper(table: Mapping[str, Any], gripper: str) -> Mapping[str, Any]:
    """Return the table of an arm with the links of a gripper on its flange; unchanged if ``gripper`` is empty."""
    if not gripper:
        return table
    return {
        **table,
        "model_rows": f"{table['model_rows']}\n{_ROWS[gripper]}",
        "looks": f"{table['looks']}\n{_LOOKS[gripper]}",
    }
