"""Parse an action into a target, and refuse targets that the robot must not get. Pure: no I/O. No
value is ever limited silently."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import Axis, finite
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.contract.shown import SHOWN
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .robots import BASE, Servo

TIME = "time_ms"
"""Key of an action beside the axes: the duration of the arm's motion, milliseconds."""

MAX_TIME_MS = 30_000

AXES = 9
ARM_MS, ARM_AT, DRIVES = AXES, AXES + 1, AXES + 2
"""Indices of the values behind a target's axes: the duration of the arm's motion in ms (0 if the action
does not move the arm), the time of that action in seconds, which identifies it, and 1 if the base is
commanded, else 0."""


def parse(
    action: Mapping[str, object],
    robot: str,
    axes: Sequence[Axis],
    index: Mapping[str, int],
    state: GateState,
    time_ms: int,
) -> Candidate | Refused:
    """Parse an action into a target for all axes.

    Args:
        action: The action.
        robot: Name of the robot, for refusals.
        axes: Its axes.
        index: Index of each axis by key.
        state: The last target and the newest observation, by which gates check a command.
        time_ms: Duration of the arm's motion if the action gives no ``time_ms``.
    """
    targets = {key: value for key, value in action.items() if key != TIME}
    if not targets and TIME in action:
        return refusals.time_alone(TIME)
    on_axes = msgspec.structs.replace(state, target=state.target[:AXES])
    candidate = parse_twist(targets, robot, axes, index, on_axes)
    if isinstance(candidate, Refused):
        return candidate
    moves_arm = any(number >= len(BASE) for number in candidate.named)
    drives = candidate.until_ns > 0 or any(number < len(BASE) for number in candidate.named)
    if TIME in action:
        requested_ms = finite(action[TIME])
        if requested_ms is None or requested_ms != int(requested_ms) or not 1 <= requested_ms <= MAX_TIME_MS:
            return refusals.bad_time(TIME, str(action[TIME])[:SHOWN], MAX_TIME_MS)
        if not moves_arm:
            return refusals.time_without_arm(TIME)
        time_ms = int(requested_ms)
    arm = (float(time_ms), state.now_ns / NS) if moves_arm else (0.0, 0.0)
    return msgspec.structs.replace(candidate, values=(*candidate.values, *arm, 1.0 if drives else 0.0))


def all_gates(axes: Sequence[Axis], servos: Sequence[Servo], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates (checks of a command) in the order in which they are applied. The first
    refusal is reported to the caller."""
    return silent(state_ttl_s), whole_arm(servos), servo_range(servos), past_range(axes)


def silent(ttl_s: float) -> GateCheck:
    """Return a gate that refuses commands while no odometry arrives."""
    limit = f"{ttl_s * 1e3:.0f} ms"

    def silent(candidate: Candidate, state: GateState) -> Refused | None:
        age_ns = state.now_ns - state.observation.t_ns
        if age_ns <= ttl_s * NS:
            return None
        return refusals.no_odometry(age_ns / 1e6, limit)

    return silent


def whole_arm(servos: Sequence[Servo]) -> GateCheck:
    """Return a gate that refuses to move some servos while the positions of others are unknown. All
    servos are commanded together, so a servo that the action does not name would jump."""
    keys = ", ".join(servo.key for servo in servos)

    def whole_arm(candidate: Candidate, state: GateState) -> Refused | None:
        if not candidate.values[ARM_MS]:
            return None
        arm = candidate.values[len(BASE) : AXES]
        unknown = ", ".join(servo.key for servo, value in zip(servos, arm, strict=True) if not math.isfinite(value))
        return refusals.unknown_arm_positions(unknown, keys) if unknown else None

    return whole_arm


def servo_range(servos: Sequence[Servo]) -> GateCheck:
    """Return a gate that refuses an arm goal in which a servo is outside its range."""

    def servo_range(candidate: Candidate, state: GateState) -> Refused | None:
        if not candidate.values[ARM_MS]:
            return None
        for index, servo in enumerate(servos, len(BASE)):
            value = candidate.values[index]
            degrees = servo.degrees(value) if index in candidate.named else float(servo.whole_degrees(value))
            if servo.low_deg - 1e-6 <= degrees <= servo.high_deg + 1e-6:
                continue
            low, high = servo.limits_rad
            range_rad = math.ceil(low * 1e4) / 1e4, math.floor(high * 1e4) / 1e4
            range_deg = servo.low_deg, servo.high_deg
            return refusals.past_servo_range(servo.key, value, degrees, range_deg, range_rad)
        return None

    return servo_range
