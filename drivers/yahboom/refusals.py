"""The texts of the Yahboom driver's refusals: one function for each text."""

from __future__ import annotations

import math

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_NAME_A_JOINT = "name a joint of the arm with it"

# -- actions


def time_alone(key: str) -> Refused:
    return Refused(Code.NO_JOINT, f"{key} alone moves nothing", _NAME_A_JOINT, key)


def time_without_arm(key: str) -> Refused:
    return Refused(Code.NO_JOINT, f"{key} applies only to the arm", _NAME_A_JOINT, key)


def bad_time(key: str, value: str, longest_ms: int) -> Refused:
    remedy = f"give a whole number of milliseconds, 1 to {longest_ms}"
    return Refused(Code.BAD_TIME, f"{key} is {value}", remedy, value, f"1..{longest_ms}")


# -- gates


def no_odometry(age_ms: float, limit: str) -> Refused:
    age = f"{age_ms:.0f} ms"
    remedy = "check the base and rosbridge. Commands are accepted after the next odometry"
    return Refused(Code.STALE, f"no odometry for {age}", remedy, age, limit)


def unknown_arm_positions(unknown: str, keys: str) -> Refused:
    """Return the refusal to move some servos of the arm.

    Args:
        unknown: The servos whose positions are unknown.
        keys: All servos.
    """
    return Refused(
        Code.UNKNOWN_POSE,
        f"the positions of {unknown} are unknown, and all servos are commanded together",
        f"give all of {keys} once, or use the verb home. After that give any of them alone",
        unknown,
        keys,
    )


def past_servo_range(
    key: str,
    value_rad: float,
    servo_deg: float,
    range_deg: tuple[int, int],
    range_rad: tuple[float, float],
) -> Refused:
    """Return the refusal of an arm goal in which a servo is outside its range.

    Args:
        key: The servo.
        value_rad: The refused value.
        servo_deg: The same in degrees of the servo.
        range_deg: The range of the servo, in its degrees.
        range_rad: The accepted values, rounded inwards.
    """
    (low_deg, high_deg), (low_rad, high_rad) = range_deg, range_rad
    hint = "; radians are expected" if abs(value_rad) > math.pi else ""
    reason = f"{key} {value_rad:.4g} rad is {servo_deg:.0f} deg of its servo, past {low_deg}..{high_deg}{hint}"
    limit = f"{low_rad:.4f}..{high_rad:.4f}"
    return Refused(Code.PAST_TRAVEL, reason, f"stay within {limit} rad", f"{value_rad:.4g}", limit)


# -- the verb with servo angles in degrees


def wrong_angle_count(count: int, servo_count: int, ranges: str) -> Refused:
    remedy = _give_angles(servo_count, ranges)
    return Refused(Code.BAD_INPUT, f"joints has {count} numbers", remedy, str(count), str(servo_count))


def past_angle_range(key: str, value: str, range_deg: tuple[int, int], servo_count: int, ranges: str) -> Refused:
    limit = f"{range_deg[0]}..{range_deg[1]}"
    return Refused(Code.PAST_TRAVEL, f"{key} is {value}", _give_angles(servo_count, ranges), value, limit)


def _give_angles(servo_count: int, ranges: str) -> str:
    return f"give {servo_count} servo angles in degrees: {ranges}"
