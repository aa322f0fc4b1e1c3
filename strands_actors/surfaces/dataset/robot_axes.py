"""Find which axes a recorded robot has."""

from __future__ import annotations

from strands_actors.contract.axis import AxisMode
from strands_actors.supervisors.instrument import Attached
from strands_actors.surfaces.recording.code import driver_from
from strands_actors.surfaces.recording.errors import RecordingError

from .frames import Axes


def axes_of(attached: Attached) -> Axes:
    """Return the robot's axes. If the robot's driver is not installed here, their units and modes are not
    known."""
    try:
        driver = driver_from(attached)
        table, read_only, cycle_s = driver.table, driver.READ_ONLY_JOINTS, 1 / driver.timing.control_hz
    except RecordingError:
        table, read_only, cycle_s = (), (), 0.0
    units = {axis.key: axis.unit for axis in table}
    return Axes(
        attached.axes,
        frozenset(axis.key for axis in table if axis.mode is AxisMode.VELOCITY),
        tuple(units[key] for key in attached.axes) if units.keys() >= set(attached.axes) else (),
        frozenset(axis.key for axis in table if axis.optional),
        read_only,
        cycle_s,
    )
