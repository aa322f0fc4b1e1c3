"""Follow joints that a person moves by hand, and choose their calibration. Pure: no I/O, no clock.

A servo's encoder counts from 0 to 4095 and starts at 0 again. A joint may pass this end within its range, since its
horn can be mounted at any angle. So a joint is followed as counts without an end: each reading continues from the
last one by the shorter way. The homing offset is then chosen so that the middle of the joint's range is at half a
turn. Its range lies within one turn of the servo's readings, wherever the encoder's end is.

Counts here are those of the encoder, as the servo reports them without a homing offset. A whole turn more or less
is the same position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from strands_actors.drivers.common.kit.calibration import MotorCalibration

from .axes import COUNTS, TOP
from .findings import Finding, Kind

HALF_TURN = TOP // 2
"""The count at the middle of a joint: half of 4095, as in lerobot."""

LEAST_COUNTS = 200
"""Least travel of a joint, 18 degrees. With less it was not moved at all."""

FASTEST_COUNTS = COUNTS // 4
"""Largest way between two readings. After a longer one it is not certain which way the joint has turned."""

LEAST_SHARE, MOST_SHARE = 0.7, 1.25
"""Range of a joint as a share of its range in the robot's table. Arms that their owners have calibrated were
between 0.9 and 1.2."""

SHIFT_COUNTS = 60
"""Five degrees. Two sweeps of one joint differ by less."""

TOOTH_COUNTS = 50
"""Largest distance from a whole number of teeth, at which a horn was mounted at another tooth."""


class Sweep:
    """The positions of all joints, followed without an end, and how far each has moved."""

    def __init__(self) -> None:
        self.now: dict[str, int] = {}
        self.low: dict[str, int] = {}
        self.high: dict[str, int] = {}
        self.lost: set[str] = set()
        """Joints that moved too far between two readings."""

    def begin(self) -> None:
        """Forget how far the joints have moved. Their positions are kept."""
        self.low, self.high = dict(self.now), dict(self.now)
        self.lost.clear()

    def record(self, encoders: Mapping[str, int]) -> None:
        """Record the next reading.

        Args:
            encoders: The encoder's count of every joint.
        """
        for key, count in encoders.items():
            before = self.now.get(key, count)
            way = (count - before + COUNTS // 2) % COUNTS - COUNTS // 2
            if abs(way) > FASTEST_COUNTS:
                self.lost.add(key)
            self.now[key] = now = before + way
            self.low[key] = min(self.low.get(key, now), now)
            self.high[key] = max(self.high.get(key, now), now)

    def moved(self, key: str) -> int:
        """Return how far a joint has moved since ``begin``, in counts."""
        return self.high[key] - self.low[key]


class Travel:
    """The range of one joint in encoder counts, and the count of its middle."""

    def __init__(self, low: int, high: int, middle: int | None = None) -> None:
        self.low = low
        self.high = high
        self.middle = (low + high) // 2 if middle is None else middle

    @property
    def counts(self) -> int:
        return self.high - self.low

    @property
    def wraps(self) -> bool:
        """Return True if the encoder starts at 0 again within the range."""
        return self.low // COUNTS != self.high // COUNTS

    def inverted(self) -> Travel:
        """Return the same range as the servo counts it in the other direction."""
        return Travel(-self.high, -self.low, -self.middle)


def check_sweep(sweep: Sweep, key: str, expected: int | None, is_accepted: bool) -> Finding | None:
    """Return the problem of the sweep of one joint; None if its range can be used.

    Args:
        sweep: The movements since the person was asked to move this joint.
        key: The joint.
        expected: The joint's range in the robot's table, in counts; None for a joint that turns without an end.
        is_accepted: True if the user accepts a range that differs from the table.
    """
    moved = sweep.moved(key)
    if key in sweep.lost:
        return Finding(Kind.TOO_FAST, key)
    if moved < LEAST_COUNTS:
        other = max(sweep.now, key=sweep.moved)
        if sweep.moved(other) >= LEAST_COUNTS:
            return Finding(Kind.SWAPPED, key, counts=sweep.moved(other), other=other)
        return Finding(Kind.LITTLE, key, counts=moved, expected=expected or COUNTS)
    if expected is None:
        return None
    if moved >= COUNTS:
        return Finding(Kind.TURNS, key, counts=moved, expected=expected)
    if is_accepted or LEAST_SHARE * expected <= moved <= MOST_SHARE * expected:
        return None
    return Finding(Kind.LITTLE if moved < expected else Kind.RATIO, key, counts=moved, expected=expected)


def check_shift(key: str, before: Travel, after: Travel, teeth: int | None) -> Finding | None:
    """Return a finding if both ends of a joint lie elsewhere than at its last calibration, by the same angle.

    Args:
        key: The joint.
        before: Its range at the last calibration.
        after: Its range now.
        teeth: The number of teeth of the servo's horn; None if it is not known.
    """
    shift = (after.middle - before.middle + COUNTS // 2) % COUNTS - COUNTS // 2
    if abs(shift) <= SHIFT_COUNTS or abs(after.counts - before.counts) > SHIFT_COUNTS:
        return None
    tooth = COUNTS / teeth if teeth else 0.0
    steps = round(shift / tooth) if tooth else 0
    fits = steps != 0 and abs(shift - steps * tooth) <= TOOTH_COUNTS
    return Finding(Kind.SHIFTED, key, counts=shift, teeth=steps if fits else 0)


def calibration_of(
    motor_id: int, drive_mode: int, offset: int, travel: Travel | None, sign: int
) -> MotorCalibration:
    """Return the calibration of one joint.

    Args:
        motor_id: The id of its servo.
        drive_mode: 1 if the servo counts in the other direction.
        offset: The homing offset, with which the servo reports half a turn at the middle.
        travel: The joint's range; None for a whole turn.
        sign: 1 if the servo subtracts its homing offset from the encoder's count, -1 if it adds it.
    """
    if travel is None:
        return MotorCalibration(motor_id, drive_mode, offset, 0, TOP)
    middle = travel.middle % COUNTS - sign * offset
    low, high = middle + travel.low - travel.middle, middle + travel.high - travel.middle
    return MotorCalibration(motor_id, drive_mode, offset, max(0, low), min(TOP, high))


def encoder_travel(motor: MotorCalibration, sign: int) -> Travel | None:
    """Return the encoder counts of a calibrated range; None for a whole turn, which has no ends.

    Args:
        motor: The calibration.
        sign: 1 if the servo subtracts its homing offset from the encoder's count, -1 if it adds it.
    """
    if (motor.range_min, motor.range_max) == (0, TOP):
        return None
    shift = sign * motor.homing_offset
    return Travel(motor.range_min + shift, motor.range_max + shift)


def firmware_groups(versions: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the joints of each firmware version, the most frequent version first.

    Args:
        versions: The firmware version of each joint's servo.
    """
    groups: dict[str, list[str]] = {}
    for key, version in versions.items():
        groups.setdefault(version, []).append(key)
    return dict(sorted(groups.items(), key=lambda group: -len(group[1])))


def check_firmware(versions: Iterable[Mapping[str, str]]) -> list[Finding]:
    """Return a finding for each servo with another firmware than most servos of its model.

    Args:
        versions: For each model of servo: the firmware version of each joint's servo.
    """
    findings = []
    for of_model in versions:
        usual, *others = firmware_groups(of_model).items()
        findings += [
            Finding(Kind.FIRMWARE, key, version=version, usual=usual[0]) for version, keys in others for key in keys
        ]
    return findings
