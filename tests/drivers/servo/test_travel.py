"""Test that goals outside the limits in a servo's own registers are refused.

Without a calibration these may be narrower than the range of the model. The servo would then stop at them
without an error.
"""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.dynamixel import table
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import virtual

from .rig import DynamixelRig, FeetechRig, Rig

LOW, HIGH = 1600, 2500
"""Counts, around the middle of a turn at 2048: -39.4 to 39.8 degrees."""


def narrow(rig: Rig) -> None:
    """Set the limits of the first servo, as another program may have done."""
    servo = rig.servo(1)
    if isinstance(rig, FeetechRig):
        for register, count in ((feetech.MIN_POSITION, LOW), (feetech.MAX_POSITION, HIGH)):
            servo.table[register.address : register.address + 2] = count.to_bytes(2, "little")
        return
    servo.table[table.MODE.address] = table.POSITION_MODE
    servo.table[52:56], servo.table[48:52] = LOW.to_bytes(4, "little"), HIGH.to_bytes(4, "little")


def decide(rig: Rig, degrees: float, seen: Observation) -> Candidate | Refused:
    now_ns = rig.clock.now_ns()
    at = GateState(now_ns, seen, rig.driver.first_target(seen), now_ns, False)
    candidate = rig.driver.parse({rig.driver.joints[0].key: degrees}, at)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in rig.driver.gates if (no := gate(candidate, at))), candidate)


@pytest.mark.parametrize("rig_class", [FeetechRig, DynamixelRig])
def test_a_goal_that_the_servo_would_not_go_to_is_refused(rig_class: type[Rig]) -> None:
    async def main() -> None:
        rig = rig_class()
        assert rig.driver.joints[0].limits[1] > 90, "without a calibration the model's range applies"
        narrow(rig)
        await rig.armed()
        seen = await rig.wire.read()
        for beyond in (90.0, 39.9, -39.5):
            refused = decide(rig, beyond, seen)
            assert isinstance(refused, Refused) and refused.code == "past_travel", refused
            assert "-39.3..39.7" in f"{refused.limit}", refused
        for within in (39.7, -39.3, 0.0):
            assert isinstance(decide(rig, within, seen), Candidate)

    virtual(main)
