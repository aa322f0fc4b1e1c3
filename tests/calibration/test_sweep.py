"""The pure part of a calibration: joints are followed across the end of their encoder, and faults are named."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.servo.findings import Finding, Kind, text_of
from strands_actors.drivers.common.servo.sweep import (
    Sweep,
    Travel,
    calibration_of,
    check_firmware,
    check_shift,
    check_sweep,
)

from .hands import JOINTS, setup_of

TURN, TOP = 4096, 4095
EXPECTED = 2000


def swept(*counts: int, joint: str = "elbow_flex", **others: int) -> Sweep:
    """Return the sweep of one joint through these counts of its encoder, which wraps. ``others`` moved so far."""
    sweep = Sweep()
    for begin, end in pairwise(counts):
        step = 1 if end > begin else -1
        for count in [*range(begin, end, 50 * step), end]:
            sweep.record({joint: count % TURN, **dict.fromkeys(others, 0)})
    sweep.record({joint: counts[-1] % TURN, **others})
    return sweep


@given(st.integers(0, TOP), st.integers(200, 4000), st.booleans(), st.sampled_from(["so101", "koch"]))
def test_the_range_lies_in_one_turn_wherever_the_encoder_ends(
    start: int, width: int, down: bool, robot: str
) -> None:
    setup = setup_of(robot, "/dev/null")
    path = (start, start - width, start) if down else (start, start + width, start)
    sweep = swept(*path)
    assert sweep.moved("elbow_flex") == width and not sweep.lost
    travel = Travel(sweep.low["elbow_flex"], sweep.high["elbow_flex"])
    if travel.wraps and not setup.OFFSET_MOVES_END:
        return
    offset = setup.offset_to_middle(travel.middle % TURN)
    limit = 2047 if robot == "so101" else 1 << 20
    offset = max(-limit, min(limit, offset))
    motor = calibration_of(3, 0, offset, travel, setup.OFFSET_SIGN)
    assert 0 <= motor.range_min < motor.range_max <= TOP and motor.range_max - motor.range_min in (width, width - 1)
    for count in (travel.low, travel.middle, travel.high):
        reported = (count % TURN) - setup.OFFSET_SIGN * offset
        reported = reported % TURN if setup.OFFSET_MOVES_END else reported
        assert motor.range_min - 1 <= reported <= motor.range_max + 1


@pytest.mark.parametrize(
    ("sweep", "kind"),
    [
        (swept(1000, 3000), None),
        (swept(3500, 3500 + 2000), None),
        (swept(1000, 1050), Kind.LITTLE),
        (swept(1000, 2000), Kind.LITTLE),
        (swept(1000, 4000), Kind.RATIO),
        (swept(1000, 6000), Kind.TURNS),
        (swept(1000, 1010, wrist_flex=900), Kind.SWAPPED),
        (swept(1000, 3000, wrist_flex=900), None),
    ],
)
def test_what_is_wrong_with_a_sweep_is_named(sweep: Sweep, kind: Kind | None) -> None:
    finding = check_sweep(sweep, "elbow_flex", EXPECTED, is_accepted=False)
    assert (finding and finding.kind) == kind
    if finding is not None:
        assert "elbow_flex" in text_of(finding)


def test_a_joint_that_jumps_between_two_readings_is_not_guessed() -> None:
    sweep = Sweep()
    for count in (100, 900, 2000, 3000):
        sweep.record({"elbow_flex": count})
    finding = check_sweep(sweep, "elbow_flex", EXPECTED, is_accepted=True)
    assert finding is not None and text_of(finding).endswith("Move it slower")


def test_another_range_can_be_accepted_but_not_one_that_turns() -> None:
    assert check_sweep(swept(0, 900), "elbow_flex", EXPECTED, is_accepted=True) is None
    assert check_sweep(swept(0, 4500), "elbow_flex", EXPECTED, is_accepted=True) is not None
    assert check_sweep(swept(0, 9000), "elbow_flex", None, is_accepted=False) is None, "it turns without an end"


@pytest.mark.parametrize(
    ("shift", "teeth", "expected"),
    [(0, 25, None), (30, 25, None), (164, 25, 1), (-328, 25, -2), (90, 25, 0), (164, None, 0), (TURN, 25, None)],
)
def test_a_horn_at_another_tooth_is_named(shift: int, teeth: int | None, expected: int | None) -> None:
    finding = check_shift("gripper", Travel(1000, 3000), Travel(1000 + shift, 3000 + shift), teeth)
    assert (finding and finding.teeth) == expected
    if expected == 1:
        assert finding is not None and "Its horn sits 1 tooth further" in text_of(finding)


def test_a_range_that_grew_is_no_other_tooth() -> None:
    assert check_shift("gripper", Travel(1000, 3000), Travel(1000, 3300), 25) is None


def test_the_servo_with_another_firmware_than_most_is_named() -> None:
    versions = dict.fromkeys(JOINTS, "3.10") | {"gripper": "3.9"}
    (finding,) = check_firmware([versions])
    assert finding == Finding(Kind.FIRMWARE, "gripper", version="3.9", usual="3.10")
    assert check_firmware([dict.fromkeys(JOINTS, "3.10"), {"other": "1.0"}]) == [], "models differ"
