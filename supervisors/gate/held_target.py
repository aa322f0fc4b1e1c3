"""From which target a robot goes on after a hold. Pure."""

from __future__ import annotations

from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.supervisors.gate.messages import StopReport


def held_target(
    driver: Driver, report: StopReport, before: tuple[float, ...], measured: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the target after a hold, so that the next command moves what it names and nothing
    else.

    An axis that could not be held where it is keeps its last target (``before``); one that was held
    is not sent elsewhere by an older reading (``measured``).
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
    """Return whether the axis is a velocity's: its first target is rest, wherever it is."""
    return bool(driver.table) and driver.table[at].mode is AxisMode.VELOCITY
