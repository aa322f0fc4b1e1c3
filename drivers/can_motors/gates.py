"""The conditions and gates of an arm of CAN motors: pure functions."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.contract.driver import (
    Candidate,
    Condition,
    ConditionCheck,
    GateCheck,
    GateState,
    OnResume,
    Reason,
)
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit import refusals as motor_refusals
from strands_actors.drivers.common.kit.motor_targets import KP
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import State
from .robots import Arm

FAULT_CODES: Mapping[State, MotorCode] = {
    State.DISABLED: MotorCode.LIMP,
    State.OVERVOLTAGE: MotorCode.VOLTAGE,
    State.UNDERVOLTAGE: MotorCode.VOLTAGE,
    State.HOT_DRIVER: MotorCode.TEMPERATURE,
    State.HOT_MOTOR: MotorCode.TEMPERATURE,
    State.LOST_COMMUNICATION: MotorCode.WATCHDOG,
}
"""The code of the refusal for a motor's state; ``FAULT`` for any other fault."""


def conditions(arm: Arm, state_ttl_s: float) -> tuple[Condition, ...]:
    """Return the conditions, which are checked while the arm is energised. The first broken one is reported.

    A motor without torque, or one that is too hot, damps the arm. For a silent motor the arm's table decides: the
    arm is damped, or the other motors hold.
    """
    damps = arm.on_silence == "damp"
    return (
        Condition(energised(arm), safe_state=SafeState.DAMP, always=True, on_resume=OnResume.ARM_ANEW),
        Condition(cool(arm), safe_state=SafeState.DAMP, always=True),
        Condition(
            answering(arm, state_ttl_s),
            reason=Reason.FAULT,
            safe_state=SafeState.DAMP if damps else SafeState.HOLD,
            always=damps,
            on_resume=OnResume.ARM_ANEW,
            is_silence=True,
        ),
    )


def energised(arm: Arm) -> ConditionCheck:
    def energised(observation: Observation, now_ns: int) -> Refused | None:
        if not any(observation.sensors.get("armed", ())):
            return None
        for motor, number in zip(arm.motors, observation.sensors["motor_state"], strict=True):
            if number != State.ENABLED:
                state = State(round(number))
                code = FAULT_CODES.get(state, MotorCode.FAULT)
                word = "limp" if state is State.DISABLED else state.name.lower().replace("_", " ")
                return motor_refusals.motor_fault(code, motor.key, (word,))
        return None

    return energised


def cool(arm: Arm) -> ConditionCheck:
    def cool(observation: Observation, now_ns: int) -> Refused | None:
        for name in ("driver_temperature_c", "rotor_temperature_c"):
            for motor, celsius in zip(arm.motors, observation.sensors.get(name, ()), strict=False):
                if celsius >= arm.hot_c:
                    return motor_refusals.too_hot(motor.key, celsius, arm.hot_c)
        return None

    return cool


def answering(arm: Arm, ttl_s: float) -> ConditionCheck:
    ttl_ns = round(ttl_s * NS)

    def answering(observation: Observation, now_ns: int) -> Refused | None:
        for motor, stamp_ns, position in zip(arm.motors, observation.stamp_ns, observation.position, strict=True):
            if now_ns - stamp_ns > ttl_ns or not math.isfinite(position):
                return refusals.silent_motor(motor.key, motor.id, (now_ns - stamp_ns) / 1e6, ttl_s * 1e3)
        return None

    return answering


def table_gains(arm: Arm) -> GateCheck:
    """Refuse gains in an action: they are a part of the arm's table."""
    count = len(arm.motors)
    usual = (*(motor.kp for motor in arm.motors), *(motor.kd for motor in arm.motors))

    def table_gains(candidate: Candidate, state: GateState) -> Refused | None:
        if candidate.values[KP * count :] == usual:
            return None
        return refusals.gains_in_action()

    return table_gains
