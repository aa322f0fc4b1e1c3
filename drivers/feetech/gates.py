"""What is refused before it reaches a Feetech bus."""

from __future__ import annotations

from strands_actors.drivers.common.gates import (
    Axes,
    motor_fault,
    past_travel,
    stale,
    temperature,
    too_fast,
    voltage,
)
from strands_actors.runtime.contract import GateCheck

FAULT_CODES = {"limp": "limp", "overload": "limp", "voltage": "voltage", "overheat": "temperature"}
REMEDIES = {"limp": "take the load off, then stop and resume to energise it again"}


def all_gates(axes: Axes, state_ttl_s: float) -> tuple[GateCheck, ...]:
    """In the order in which they are asked: the first that refuses answers."""
    return (
        past_travel(axes),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, FAULT_CODES, REMEDIES),
        too_fast(axes),
    )
