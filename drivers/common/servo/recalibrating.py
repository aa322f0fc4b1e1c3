"""Write a calibration into servos that was made earlier: that of a file, or the one before the last."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from strands_actors.drivers.common.kit.calibration import MotorCalibration, check, text_of
from strands_actors.drivers.common.kit.calibration_forms import present_form

from .axes import TOP
from .calibrating import Person, Plan, Proposal, Registers, open_servos, write
from .findings import Finding, Kind
from .setup import Setup
from .sweep import LEAST_SHARE, MOST_SHARE


async def put_back(setup: Setup[Any], kept: Registers, keep: Callable[[Registers], None]) -> Proposal:
    """Write the registers that were kept at the last calibration. The present ones are kept in their place.

    Args:
        setup: The servos.
        kept: The registers.
        keep: Called with the present registers when the kept ones were written.

    Raises:
        WireDown: A servo does not answer, or did not keep a value.
    """
    states = await open_servos(setup)
    before = {key: state.registers for key, state in states.items()}

    async def keep_present() -> None:
        keep(before)

    # Not before: a failure must leave the kept values where they are.
    await write(setup, kept, before, keep_present)
    motors = {axis.key: setup.calibration_in(axis, kept[axis.key]) for axis in setup.axes}
    return Proposal(motors, {}, (), before, kept)


async def take_file(
    setup: Setup[Any], person: Person, plan: Plan, source: Path, keep: Callable[[Registers], None]
) -> Proposal:
    """Compare a calibration file with the registers of the servos, and write it if the person confirms.

    Args:
        setup: The servos.
        person: The user interface.
        plan: The facts about the robot.
        source: The file, in the form of any version of LeRobot.
        keep: Called with the present registers before the first one is written.

    Raises:
        WireDown: A servo does not answer, or did not keep a value.
        ValueError: The file cannot be read, or is not of this robot, or the person did not confirm.
    """
    motors, mended = read_file(setup, plan, source)
    states = await open_servos(setup)
    before = {key: state.registers for key, state in states.items()}
    after = {axis.key: setup.registers_of(axis, motors[axis.key], before[axis.key]) for axis in setup.axes}
    findings = [Finding(Kind.MENDED, key) for key in mended]
    for key, registers in after.items():
        findings += [
            Finding(Kind.DIFFERS, key, register=name, file_value=value, servo_value=before[key][name])
            for name, value in registers.items()
            if value != before[key][name]
        ]
    proposal = Proposal(motors, {}, tuple(findings), before, after)
    if not await person.confirm(proposal):
        raise ValueError("not confirmed. Nothing was changed")
    keep(before)
    await write(setup, after, before)
    return proposal


def read_file(setup: Setup[Any], plan: Plan, source: Path) -> tuple[Mapping[str, MotorCalibration], list[str]]:
    """Return the calibration in a file of any version of LeRobot, and the joints that had to be mended.

    Args:
        setup: The servos of the robot; they are not read.
        plan: The facts about the robot.
        source: The file.

    Raises:
        ValueError: The file cannot be read, or is not of this robot. The text names the joint and the field.
    """
    try:
        content = json.loads(text_of(source))
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(
            f"calibration {source}: cannot be read ({error}). Give a lerobot calibration file"
        ) from None
    content, mended = present_form(content, str(source), setup.OFFSET_MOVES_END, plan.max_offset)
    motors = check(content, {axis.key: axis.id for axis in setup.axes}, plan.max_offset, str(source))
    for key, motor in motors.items():
        _check_range(key, motor, plan, source)
    return motors, mended


def _check_range(key: str, motor: MotorCalibration, plan: Plan, source: Path) -> None:
    expected = plan.expected(key)
    if expected is None or key in plan.accepted:
        return
    where = f"calibration {source}: {key}: range_min {motor.range_min} to range_max {motor.range_max}"
    if (motor.range_min, motor.range_max) == (0, TOP):
        raise ValueError(
            f"{where} is a whole turn. The joint passed the end of its encoder when it was calibrated. "
            "Calibrate again"
        )
    counts = motor.range_max - motor.range_min
    if not LEAST_SHARE * expected <= counts <= MOST_SHARE * expected:
        raise ValueError(
            f"{where} is {counts} counts, and the joint has about {expected}. The file may be of another robot. "
            f"Give the file of this one, calibrate again, or add --accept {key}"
        )
