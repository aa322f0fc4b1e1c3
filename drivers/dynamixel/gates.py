"""What is refused before it reaches a Dynamixel bus."""

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

from .table import HARDWARE_BITS
from .watchdog import TRIPPED

UNNAMED = "hardware alert"
"""The alert bit was seen, and which alert it is not yet read."""

FAULT_CODES = {**dict.fromkeys((*HARDWARE_BITS.values(), UNNAMED), "alert"), TRIPPED: "watchdog", "limp": "limp"}
REMEDIES = {
    "alert": "clear the cause, reboot the servo with the arm supported, then stop and resume",
    "watchdog": "stop and resume to clear it",
    "limp": "take the load off, then stop and resume to energise it again",
}


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
