"""Plan a motion along a path. A path is rows of targets at a fixed rate, from a dataset or a planner.

Pure: no clock, no I/O. The robot moves to the first row as ``move_to`` does. It then moves along the rows at
its control rate, at constant speed between two rows. The driver's gates (its checks of range and speed) check
each step before anything moves. The speeds of a row are sent unchanged, and zero is sent after the last row.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Driver
from strands_actors.kernel.messages import Refused

from . import refusals
from .motions import (
    LONGEST_S,
    Motion,
    RobotReading,
    arrived,
    is_place,
    plan_move,
    refuse_action,
    refuse_targets,
    state_of,
)

MOVE_ALONG = "move_along"
"""The verb of a motion along a path."""
APPROACH_S = 2.0
"""Time in seconds for the motion to the first row, unless a joint needs longer."""
MOST_HZ = 1000.0
ROUNDING = 1e-9


class Path(NamedTuple):
    """Rows of targets. All rows have the same joints.

    Attributes:
        joints: Names of the joints of a row.
        places: The joints that are commanded by position. The others are commanded by speed.
        rows: Targets in the driver's units, in the order of ``joints``.
        hz: Rows per second.
    """

    joints: tuple[str, ...]
    places: frozenset[str]
    rows: Sequence[tuple[float, ...]]
    hz: float

    @property
    def last(self) -> int:
        """Return the index of the last row."""
        return len(self.rows) - 1

    @property
    def has_speeds(self) -> bool:
        return len(self.places) < len(self.joints)

    def steps(self, period_s: float) -> int:
        """Return how many control periods the rows take.

        The positions of a row are reached at the row's time. Its speeds are sent until the next row. One more
        step sets the speeds to zero.
        """
        rows = self.last + self.has_speeds
        return max(1, math.ceil(rows / self.hz / period_s - ROUNDING)) + self.has_speeds

    def row_targets(self, row: int) -> dict[str, float]:
        """Return the targets of one row by joint."""
        return dict(zip(self.joints, self.rows[row], strict=True))


def read_path(driver: Driver, rows: object, hz: object) -> Path | Refused:
    """Return the user's rows as a path, or a refusal. The robot's state is not checked here."""
    rate = finite(hz)
    if rate is None or not 0 < rate <= MOST_HZ:
        return refusals.bad_row_rate(hz, MOST_HZ).about(MOVE_ALONG)
    if not isinstance(rows, Sequence) or not rows or not all(isinstance(row, Mapping) and row for row in rows):
        return refusals.no_rows().about(MOVE_ALONG)
    joints = tuple(str(name).removesuffix(".pos") for name in rows[0])
    targets: list[tuple[float, ...]] = []
    for number, row in enumerate(rows):
        named = {str(name).removesuffix(".pos"): finite(value) for name, value in row.items()}
        if named.keys() != set(joints):
            return refusals.other_joints(number).about(MOVE_ALONG)
        values = [named[joint] for joint in joints]
        if None in values:
            return refusals.incomplete_row(number, joints[values.index(None)]).about(MOVE_ALONG)
        targets.append(tuple(value for value in values if value is not None))
    if (seconds := (len(targets) - 1) / rate) > LONGEST_S:
        return refusals.path_too_long(seconds, LONGEST_S).about(MOVE_ALONG)
    if unknown := [joint for joint in joints if joint not in driver.axes]:
        return refusals.unknown_joint(driver.robot, unknown[0], ", ".join(driver.axes)).about(MOVE_ALONG)
    places = frozenset(joint for joint in joints if is_place(driver, driver.axes.index(joint)))
    refusal = refuse_targets(driver, dict.fromkeys(places, 0.0)) if places else None
    return Path(joints, places, targets, rate) if refusal is None else refusal.about(MOVE_ALONG)


def check_along(driver: Driver, motion: Motion, path: Path, reading: RobotReading) -> Iterator[Refused | None]:
    """Check each step along the rows with the robot's gates, as if the robot followed without delay.

    The motion to the first row was checked when it was planned.

    Returns:
        The refusal of each step, or None.
    """
    state = state_of(reading, motion.period_s)
    steps_before = motion.n_steps - path.steps(motion.period_s)
    before = path.row_targets(0)
    for step in range(steps_before + 1, motion.n_steps + 1):
        then = motion.action(step)
        result = arrived(driver, before, state)
        if not isinstance(result, Refused):
            accepted = refuse_action(driver, then, result)
            result = accepted if isinstance(accepted, Refused) else result
        if isinstance(result, Refused):
            at_s = (step - steps_before) * motion.period_s
            yield replace(result, reason=f"at {at_s:.2f} s: {result.reason}", verb=MOVE_ALONG)
        else:
            yield None
        before = then


def plan_along(driver: Driver, path: Path, reading: RobotReading, period_s: float) -> Motion | Refused:
    """Plan the motion to the first row, then along all rows.

    Returns:
        The motion, or a refusal if the robot cannot go to the first row.
    """
    first = path.row_targets(0)
    approach: Motion | Refused | None = None
    if path.places:
        targets = {joint: first[joint] for joint in path.places}
        approach = plan_move(driver, targets, APPROACH_S, reading, period_s, may_take_longer=True)
    if isinstance(approach, Refused):
        return approach.about(MOVE_ALONG)
    steps_before = 0 if approach is None else approach.n_steps
    n_steps = steps_before + path.steps(period_s)
    zero_speeds = {
        axis.key: axis.rest for axis in driver.table if axis.key in first and axis.key not in path.places
    }

    def action(step: int) -> dict[str, float]:
        if approach is not None and step <= steps_before:
            return approach.action(step)
        if zero_speeds and step == n_steps:
            return path.row_targets(-1) | zero_speeds
        return _between_rows(path, (step - steps_before) * period_s * path.hz, period_s)

    return Motion(
        MOVE_ALONG,
        period_s,
        n_steps,
        action,
        keeps=bool(path.places),
        begins_apart=approach is not None and approach.begins_apart,
    )


def _between_rows(path: Path, along: float, period_s: float) -> dict[str, float]:
    """Return the command of one control period.

    A position is interpolated between two rows, for the end of the period. A speed is that of the row in which
    the period begins.

    Args:
        path: The path.
        along: Position on the path at the end of the period, in rows with a fraction.
        period_s: The control period.
    """
    row = min(int(along + ROUNDING), path.last)
    share = min(1.0, along - row)
    start, end = path.row_targets(row), path.row_targets(min(row + 1, path.last))
    speeds = path.row_targets(min(int(along - period_s * path.hz + ROUNDING), path.last)) if path.has_speeds else {}
    return {
        joint: start[joint] + (end[joint] - start[joint]) * share if joint in path.places else speeds[joint]
        for joint in path.joints
    }


__all__ = ["MOVE_ALONG", "Path", "check_along", "plan_along", "read_path"]
