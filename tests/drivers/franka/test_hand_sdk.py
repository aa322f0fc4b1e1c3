"""Test the vendor's unmodified clients against the hand of the twin. Both speak version 3 of its protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

from .test_twin_sdk import run, twin_of

HAND = """
homed = hand.homing()
moved = hand.move(0.03, 0.05)
at = hand.read_once().width
empty = hand.grasp(0.03, 0.05, 20.0, 0.005, 0.005)
closed = hand.read_once()
opened = hand.move(0.08, 0.1)
state = hand.read_once()
try:
    hand.move(0.2, 0.1)
    too_wide = "accepted"
except Exception as error:
    too_wide = str(error)
end(homed=homed, moved=moved, at=at, empty=empty, closed=closed.width, grasped=closed.is_grasped, opened=opened,
    width=state.width, most=state.max_width, stopped=hand.stop(), too_wide=too_wide)
"""
CLIENTS = {
    "panda": "from panda_py import libfranka\nhand = libfranka.Gripper(host)\n",
    "fr3": "import pylibfranka\nhand = pylibfranka.Gripper(host)\n",
}


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param("panda", marks=pytest.mark.needs("panda-python")),
        pytest.param("fr3", marks=pytest.mark.needs("pylibfranka")),
    ],
)
def test_the_vendors_client_homes_moves_and_closes_the_hand(robot: str, tmp_path: Path) -> None:
    with twin_of(robot, tmp_path, gripper="franka_hand") as twin:
        told = run(twin, CLIENTS[robot] + HAND)
        kinds = [kind for kind, _ in twin.logged("host")]
    assert told["homed"] and told["moved"] and told["opened"] and told["stopped"]
    assert told["at"] == pytest.approx(0.03, abs=0.001)
    assert not told["empty"] and not told["grasped"], "a grasp of nothing does not succeed"
    assert told["closed"] == pytest.approx(0.0, abs=0.002)
    assert told["width"] == pytest.approx(0.08, abs=0.001) and told["most"] == pytest.approx(0.08)
    assert "failed" in told["too_wide"], "a width past the largest one is refused"
    assert kinds.count("setpoint") == 5 and kinds.count("safe") == 1
