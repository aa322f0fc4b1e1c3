"""Parse an action into a target, and refuse targets that the robot must not get. Pure: no I/O. No
value is ever limited silently."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import SHOWN, Axis, finite
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .robots import BASE, Servo

TIME = "time_ms"
"""Key of an action beside the axes: the duration of the arm's motion, milliseconds."""

MAX_TIME_MS = 30_000

AXES = 9
ARM_MS, ARM_AT, DRIVES = AXES, AXES + 1, AXES + 2
"""Indices of the values behind a target's axes: the duration of the arm's motion in ms (0 if the action
does not move the arm), the time of that action in seconds, which identifies it, and 1 if the base is
commanded, else 0."""

_NO_TIME = "give a whole number of milliseconds, 1 to 30000"


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
        return Refused(Code.NO_JOINT, f"{TIME} alone moves nothing", "name a joint of the arm with it", TIME)
    on_axes = msgspec.structs.replace(state, target=state.target[:AXES])
    candidate = parse_twist(targets, robot, axes, index, on_axes)
    if isinstance(candidate, Refused):
        return candidate
    moves_arm = any(number >= len(BASE) for number in candidate.named)
    drives = candidate.until_ns > 0 or any(number < len(BASE) for number in candidate.named)
    if TIME in action:
        requested_ms = finite(action[TIME])
        if requested_ms is None or requested_ms != int(requested_ms) or not 1 <= requested_ms <= MAX_TIME_MS:
            shown = str(action[TIME])[:SHOWN]
            return Refused(Code.BAD_TIME, f"{TIME} is {shown}", _NO_TIME, shown, f"1..{MAX_TIME_MS}")
        if not moves_arm:
            return Refused(
                Code.NO_JOINT, f"{TIME} applies only to the arm", "name a joint of the arm with it", TIME
            )
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
        age = f"{age_ns / 1e6:.0f} ms"
        return Refused(
            Code.STALE,
            f"no odometry for {age}",
            "check the base and rosbridge. Commands are accepted after the next odometry",
            age,
            limit,
        )

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
        if not unknown:
            return None
        return Refused(
            Code.UNKNOWN_POSE,
            f"the positions of {unknown} are unknown, and all servos are commanded together",
            f"give all of {keys} once, or use the verb home. After that give any of them alone",
            unknown,
            keys,
        )

    return whole_arm


def servo_range(servos: Sequence[Servo]) -> GateCheck:
    """Return a gate that refuses an arm goal in which a servo is outside its range."""

    def servo_range(candidate: Candidate, state: GateState) -> Refused | None:
        if not candidate.values[ARM_MS]:
            return None
        for index, servo in enumerate(servos, len(BASE)):
            value = candidate.values[index]
            degrees = servo.degrees(value) if index in candidate.named else float(servo.whole_degrees(value))
            low, high = servo.limits_rad
            if servo.low_deg - 1e-6 <= degrees <= servo.high_deg + 1e-6:
                continue
            hint = "; radians are expected" if abs(value) > math.pi else ""
            return Refused(
                Code.PAST_TRAVEL,
                f"{servo.key} {value:.4g} rad is {degrees:.0f} deg of its servo, past "
                f"{servo.low_deg}..{servo.high_deg}{hint}",
                f"stay within {math.ceil(low * 1e4) / 1e4:.4f}..{math.floor(high * 1e4) / 1e4:.4f} rad",
                f"{value:.4g}",
                f"{math.ceil(low * 1e4) / 1e4:.4f}..{math.floor(high * 1e4) / 1e4:.4f}",
            )
        return None

    return servo_range
