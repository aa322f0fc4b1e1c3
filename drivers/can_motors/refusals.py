"""Refusals of the driver of CAN motors, one function for each text."""

from __future__ import annotations

from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def silent_motor(key: str, motor_id: int, age_ms: float, limit_ms: float) -> Refused:
    age = f"{age_ms:.0f} ms"
    remedy = "check the wires, the power and the id of this motor"
    return Refused(
        Code.STALE, f"{key} (id {motor_id}) has not answered for {age}", remedy, age, f"{limit_ms:.0f} ms"
    )


def gains_in_action() -> Refused:
    remedy = "leave kp and kd out, or make the robot with gains_in_actions=True"
    return Refused(
        MotorCode.GAIN, "the action has gains, and this robot takes them from its table", remedy, "kp, kd"
    )
