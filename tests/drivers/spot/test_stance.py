"""Test how the twin puts its feet to places (``StanceCommand``)."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.feedback import (
    GOING_TO_STANCE,
    OVERRIDDEN,
    PROCESSING,
    STANCED,
    TIMED_OUT,
    TOO_FAR_AWAY,
)
from strands_actors.drivers.spot.twin.stance import FEET
from tests.drivers.common.memory_port import virtual

from .test_hand import accepted, let_pass, standing
from .test_twin import base_feedback, mobility, send

Places = Sequence[tuple[float, float]]
WIDE: Places = ((0.3, 0.3), (0.3, -0.3), (-0.3, 0.3), (-0.3, -0.3))
"""The places of the vendor's example ``stance_in_place``."""


def stance(twin: SpotTwin, places: Places, frame: str = "odom", seconds: float = 5.0, **content: object) -> Message:
    feet = [
        {"key": foot, "value": {"x": x, "y": y}} for foot, (x, y) in zip(FEET[: len(places)], places, strict=True)
    ]
    request = {
        "end_time": p.stamp(twin.robot_ns() + round(seconds * p.NS)),
        "stance": {"se2_frame_name": frame, "foot_positions": feet, "accuracy": 0.05, **content},
    }
    return mobility("stance_request", request)


def feet_in_odom(twin: SpotTwin) -> list[tuple[float, float]]:
    """Return where the feet are, from what the robot reports of its joints and its pose."""
    body = twin.mechanism.odometry.inverse().compose(twin.mechanism.body_pose)
    places = []
    for foot in twin.state()["foot_state"]:
        x, y, z = (foot["foot_position_rt_body"][axis] for axis in "xyz")
        placed = body.compose(body._replace(xyz=(x, y, z), rotation=(1.0, 0.0, 0.0, 0.0)))
        places.append(placed.xyz[:2])
    return places


def test_the_feet_go_to_their_places_one_after_the_other() -> None:
    async def test() -> None:
        twin = standing()
        number = accepted(twin, stance(twin, WIDE))
        assert base_feedback(twin, number) == {"status": PROCESSING, "stance_feedback": {"status": GOING_TO_STANCE}}
        await let_pass(twin, 0.6)
        first, *_, last = feet_in_odom(twin)
        assert first == pytest.approx(WIDE[0], abs=0.01), "the first foot is there"
        assert last[1] == pytest.approx(-0.166, abs=0.02), "the last one has not moved"
        assert twin.state()["behavior_state"]["state"] == 4  # STATE_STEPPING
        await let_pass(twin, 1.2)
        assert base_feedback(twin, number)["stance_feedback"]["status"] == STANCED
        for foot, place in zip(feet_in_odom(twin), WIDE, strict=True):
            assert foot == pytest.approx(place, abs=0.01)
        assert twin.state()["behavior_state"]["state"] == 3  # STATE_STANDING

    virtual(test)


def test_the_body_moves_and_turns_with_the_feet_and_reports_its_speed() -> None:
    async def test() -> None:
        twin = standing()
        accepted(twin, stance(twin, [(x + 0.2, y + 0.3 * x) for x, y in WIDE]))
        await let_pass(twin, 0.5)
        assert twin.state()["kinematic_state"]["velocity_of_body_in_odom"]["linear"]["x"] > 0.05
        await let_pass(twin, 2.0)
        assert twin.mechanism.x_m == pytest.approx(0.2, abs=0.05)
        assert twin.mechanism.yaw_rad == pytest.approx(0.29, abs=0.02)
        assert twin.state()["kinematic_state"]["velocity_of_body_in_odom"]["linear"]["x"] == 0.0
        twin.mechanism.halt()
        accepted(twin, mobility("stand_request"))
        await let_pass(twin, 1.0)
        assert feet_in_odom(twin)[0] == pytest.approx((0.5, 0.39), abs=0.02), "it stands on these feet"

    virtual(test)


def test_a_stance_that_is_too_far_away_moves_nothing_and_says_so() -> None:
    async def test() -> None:
        for places in ([(x + 1.0, y) for x, y in WIDE], [(x, 3 * y) for x, y in WIDE]):
            twin = standing()
            before = feet_in_odom(twin)
            number = accepted(twin, stance(twin, places))
            await let_pass(twin, 1.0)
            assert base_feedback(twin, number)["stance_feedback"]["status"] == TOO_FAR_AWAY
            assert feet_in_odom(twin) == before and not twin.mechanism.walks

    virtual(test)


def test_a_stance_ends_at_its_time_and_at_another_command() -> None:
    async def test() -> None:
        twin = standing()
        number = accepted(twin, stance(twin, WIDE, seconds=0.6))
        await let_pass(twin, 1.0)
        assert base_feedback(twin, number) == {"status": TIMED_OUT, "stance_feedback": {"status": GOING_TO_STANCE}}
        halfway = feet_in_odom(twin)
        await let_pass(twin, 1.0)
        assert feet_in_odom(twin) == halfway
        number = accepted(twin, stance(twin, WIDE))
        await let_pass(twin, 0.2)
        accepted(twin, mobility("stop_request"))
        assert base_feedback(twin, number)["status"] == OVERRIDDEN
        await let_pass(twin, 0.1)
        stopped = feet_in_odom(twin)
        await let_pass(twin, 1.0)
        assert feet_in_odom(twin) == stopped

    virtual(test)


def test_a_sitting_robot_stands_up_first_and_a_walk_ends_the_stance() -> None:
    async def test() -> None:
        twin = standing()
        twin.mechanism.up, twin.mechanism.wants_up = 0.0, False
        number = accepted(twin, stance(twin, WIDE, frame="body"))
        await let_pass(twin, 1.8)
        assert not twin.mechanism.stands and twin.mechanism.posture.feet == twin.mechanism.posture.default_feet
        await let_pass(twin, 0.4)
        assert feet_in_odom(twin)[3][1] == pytest.approx(-0.166, abs=0.02), "the last foot waits for its turn"
        await let_pass(twin, 1.8)
        assert base_feedback(twin, number)["stance_feedback"]["status"] == STANCED
        end = {"end_time": p.stamp(twin.robot_ns() + p.NS), "se2_frame_name": "body"}
        accepted(twin, mobility("se2_velocity_request", {**end, "velocity": {"linear": {"x": 0.2}}}))
        await let_pass(twin, 1.2)
        assert twin.mechanism.posture.feet == twin.mechanism.posture.default_feet

    virtual(test)


def test_a_stance_that_cannot_be_read_is_refused() -> None:
    async def test() -> None:
        twin = standing()
        assert send(twin, stance(twin, WIDE[:3])) == (p.Command.INVALID_REQUEST, 0)
        assert send(twin, stance(twin, WIDE, frame="gpe")) == (p.Command.UNKNOWN_FRAME, 0)
        assert send(twin, stance(twin, WIDE, seconds=-1.0)) == (p.Command.EXPIRED, 0)
        assert twin.mechanism.stance is None

    virtual(test)
