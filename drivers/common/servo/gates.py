"""What is refused before it reaches a bus of servos."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.contract.driver import GateCheck
from strands_actors.drivers.common.gates import (
    Axes,
    motor_fault,
    past_travel,
    stale,
    temperature,
    too_fast,
    voltage,
)


def all_gates(
    axes: Axes, state_ttl_s: float, fault_codes: Mapping[str, str], remedies: Mapping[str, str]
) -> tuple[GateCheck, ...]:
    """In the order in which they are asked: the first that refuses answers. ``fault_codes``, ``remedies``: as
    ``motor_fault`` takes them."""
    return (
        past_travel(axes),
        stale(axes, state_ttl_s),
        voltage(axes),
        temperature(axes),
        motor_fault(axes, fault_codes, remedies),
        too_fast(axes),
    )
