"""Compute the target from which the robot continues after a hold. Pure."""

from __future__ import annotations

from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.supervisors.gate.messages import StopReport


def target_after_hold(
    driver: Driver, report: StopReport, before: tuple[float, ...], measured: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the target after a hold, so that the next command moves only the axes that it names.

    Args:
        driver: The driver of the robot.
        report: The report of the hold.
        before: The target before the hold. It is kept for an axis that could not be held, since that axis still
            moves there.
        measured: The newest position. It is used for an axis whose report of the hold has no position.
    """
    aimed = list(measured)
    motors = {motor.axis: motor for motor in report.motors}
    for index, axis in enumerate(driver.axes):
        motor = motors.get(axis)
        if motor is not None and motor.target is not None:
            aimed[index] = motor.target
        elif motor is not None and not motor.safe and not _rests(driver, index):
            aimed[index] = before[index]
    return tuple(aimed)


def _rests(driver: Driver, index: int) -> bool:
    """Return True if the target of this axis after a hold is zero, because it is a velocity."""
    return bool(driver.table) and driver.table[index].mode is AxisMode.VELOCITY
