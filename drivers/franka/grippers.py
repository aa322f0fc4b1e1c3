"""The hand that a Franka arm may have on its flange, with its links in the model of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from strands_actors.drivers.common.kinematics.hand_rows import parallel_rows
from strands_actors.drivers.common.kit.hand import FULL

from .arms import FLANGE_M, Arm, model_table

Gripper = Literal["franka_hand"]
"""The values of the option ``gripper``."""

LAST_LINK, LINK = "link7", "hand"
FINGERS = ("left_finger_joint", "right_finger_joint")
TRAVEL_M = 0.04
"""The way of each finger: 80 mm between both when open."""
WIDTH_M = 2 * TRAVEL_M

TOOL_M = 0.1034
"""Distance of the point between the finger tips from the flange, as in the vendor's description."""

FASTEST_M_S, SLOWEST_M_S = 0.1, 0.005
"""Speeds of the width at 100 and at 0 percent. The vendor's data sheet has 50 mm/s for each finger. The lower one
is [assumed]."""
STRONGEST_N, WEAKEST_N = 70.0, 5.0
"""Forces of a grasp at 100 and at 0 percent. The first is the continuous force of the vendor's data sheet, the
other one is [assumed]."""

HAND_ID = 8
"""Number of the hand in reports. The joints have 1 to 7."""
TOP_PERCENT_S = FULL * FASTEST_M_S / WIDTH_M

_ROWS = parallel_rows(
    LINK,
    LAST_LINK,
    body=f"0,0,{FLANGE_M} 0,0,-45 - - - .73 0,0,.03 b.0315,.1025,.033@0,0,.033",
    place="0,0,.0584",
    finger=".015 b.01,.008,.027",
    travel_m=TRAVEL_M,
)
_LOOKS = f"""
{LINK}        white    box 0,0,.012 .032,.070,.012 .010
{LINK}        white    box 0,0,.045 .028,.102,.021 .012
left_finger  graphite box 0,.008,.012 .010,.008,.014 .003
left_finger  silver   box 0,.006,.038 .009,.006,.016 .002
right_finger graphite box 0,-.008,.012 .010,.008,.014 .003
right_finger silver   box 0,-.006,.038 .009,.006,.016 .002
"""
"""Mass and dimensions are the vendor's, shapes [assumed]."""


def table_of(arm: Arm, gripper: str) -> Mapping[str, Any]:
    """Return the table of an arm's model, with the hand on its flange if ``gripper`` is not empty."""
    table = model_table(arm)
    if not gripper:
        return table
    return {**table, "model_rows": f"{table['model_rows']}\n{_ROWS}", "looks": f"{table['looks']}\n{_LOOKS}"}


def share(percent: float, low: float, high: float) -> float:
    """Return the value between ``low`` (0 %) and ``high`` (100 %)."""
    return low + (high - low) * percent / FULL
