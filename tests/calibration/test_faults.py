"""Twins that were built with a fault: the calibration names it, or allows for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.servo.findings import Kind
from strands_actors.drivers.common.servo.setup import Setup
from strands_actors.testing import Twin

from .hands import ENDS, Hands, at_servos, calibrate_as_built_first, plan_of, registers_of, sweep

LAST = 4095


def built(robot: str, folder: Path, assembly: str) -> Twin:
    return Twin(robot, folder, by_hand=True, options={"assembly": assembly})


@pytest.mark.parametrize(
    ("robot", "assembly", "ends", "text"),
    [
        ("so101", "1:ratio=1.5", ENDS, r"shoulder_pan was swept over .* seems to have another gear ratio"),
        ("so101", "1:ratio=1.0", (0.0, 0.25), r"shoulder_pan was swept over 14\.\d degrees.* until both stops"),
        ("so101", "1:id=2,2:id=1", ENDS, r"shoulder_pan was to move, and the servo of shoulder_lift moved"),
        (
            "so101",
            "3:firmware=3.9",
            ENDS,
            r"servo of elbow_flex has firmware 3\.9, and most of its kind have 3\.10",
        ),
        ("koch", "1:firmware=51", ENDS, r"firmware 5"),
        ("koch", "2:turned=175", ENDS, r"encoder of shoulder_lift starts at 0 again .* no offset can change that"),
        ("koch", "1:id=2,2:id=1", ENDS, r"shoulder_pan was to move, and the servo of shoulder_lift moved"),
    ],
)
def test_a_fault_is_named_and_nothing_is_written(
    robot: str, assembly: str, ends: tuple[float, float], text: str, tmp_path: Path
) -> None:
    with built(robot, tmp_path, assembly) as twin:
        before = registers_of(robot, twin)
        with pytest.raises(ValueError, match=text):
            sweep(robot, twin, Hands(twin, ends))
        assert registers_of(robot, twin) == before


def test_a_servo_of_another_model_is_named(tmp_path: Path) -> None:
    """A leader of a Koch has servos with another gear ratio, which have another model number."""
    with (
        Twin("koch_leader", tmp_path, by_hand=True) as twin,
        pytest.raises(WireDown, match="is a XL330-M077, must"),
    ):
        sweep("koch", twin, Hands(twin))


def test_a_joint_that_passes_the_end_of_its_encoder_is_calibrated_within_one_turn(tmp_path: Path) -> None:
    with built("so101", tmp_path, "1:turned=170,6:turned=-175") as twin:
        proposal = sweep("so101", twin, Hands(twin))
        assert [(each.kind, each.joint) for each in proposal.findings] == [(Kind.WRAPS, "shoulder_pan")]
        for motor in proposal.motors.values():
            assert 0 <= motor.range_min < motor.range_max <= LAST
        twin.power_cycle()

        async def positions(setup: Setup[object]) -> dict[str, int]:
            await setup.open()
            return await setup.positions()

        for joint, count in at_servos("so101", twin, positions).items():
            motor = proposal.motors[joint]
            assert motor.range_min - 30 <= count <= motor.range_max + 30, joint


def test_a_horn_that_sits_one_tooth_further_than_before_is_named(tmp_path: Path) -> None:
    with built("so101", tmp_path, "3:turned=14.4") as twin:
        calibrate_as_built_first(twin)
        proposal = sweep("so101", twin, Hands(twin))
    assert [(each.kind, each.joint, each.teeth) for each in proposal.findings] == [(Kind.SHIFTED, "elbow_flex", 1)]


def test_different_firmware_can_be_accepted_and_without_a_confirmation_no_register_is_written(
    tmp_path: Path,
) -> None:
    with built("so101", tmp_path, "3:firmware=3.9") as twin:
        before = registers_of("so101", twin)
        hands = Hands(twin, confirms=False)
        with pytest.raises(ValueError, match="not confirmed"):
            sweep(
                "so101", twin, hands, plan_of("so101", accepted=("firmware",)), keep=lambda _: pytest.fail("kept")
            )
        assert registers_of("so101", twin) == before
    assert hands.proposal is not None and hands.proposal.findings == ()


@pytest.mark.parametrize("wrong", ["9:turned=1", "1:turn=1", "1:turned", "1:ratio=a"])
def test_an_assembly_that_is_none_is_refused(wrong: str, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="assembly"), built("so101", tmp_path, wrong):
        pass
