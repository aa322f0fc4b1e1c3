"""Test the conversions of rotations."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.common.kinematics.link_rows import quaternion

ANGLES = st.floats(-179.0, 179.0)


@given(ANGLES, st.floats(-89.0, 89.0), ANGLES)
def test_a_quaternion_is_the_angles_it_was_made_of(roll: float, pitch: float, yaw: float) -> None:
    found = roll_pitch_yaw(quaternion(f"{roll},{pitch},{yaw}"))
    assert [math.degrees(angle) for angle in found] == pytest.approx([roll, pitch, yaw], abs=1e-6)


def test_straight_up_raises_no_error() -> None:
    assert roll_pitch_yaw((math.sqrt(0.5), 0.0, math.sqrt(0.5) + 1e-9, 0.0))[1] == pytest.approx(math.pi / 2)
