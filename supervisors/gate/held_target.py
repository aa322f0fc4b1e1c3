"""Compute the target from which a robot continues after a hold. Pure."""

from __future__ import annotations

from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.supervisors.gate.messages import StopReport


def held_target(
    driver: Driver, report: StopReport, before: tuple[float, ...], measured: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the target after a hold, so that the next command moves only the axes that it names.

    Args:
        driver: The driver of the robot.
        report: The report of the hold.
        before: The target before the hold, for an axis that could not be held and still follows it.
        measured: The newest position, for an axis without a position in the report of its hold.
    """
    aimed = list(measured)
    motors = {motor.axis: motor for motor in report.motors}
    for at, axis in enumerate(driver.axes):
        motor = motors.get(axis)
        if motor is not None and motor.target is not None:
            aimed[at] = motor.target
        elif motor is not None and not motor.safe and not _rests(driver, at):
            aimed[at] = before[at]
    return tuple(aimed)


def _rests(driver: Driver, at: int) -> bool:
    """Return True for a velocity axis. Its first target is zero at any position."""
    return bool(driver.table) and driver.table[at].mode is AxisMode.VELOCITY
