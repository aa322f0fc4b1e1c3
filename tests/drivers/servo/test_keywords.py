"""Test the keywords of a servo bus on the drivers page: other ids, and how long it may be silent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.dynamixel import table
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.testing.inline import run_virtual

from .rig import DynamixelRig, FeetechRig, Rig, refused

RIGS = (FeetechRig, DynamixelRig)
OTHERS = (11, 12, 13, 14, 15, 16)


@pytest.mark.parametrize(("new_rig", "register"), [(FeetechRig, feetech.ID), (DynamixelRig, table.ID)])
def test_servos_with_other_ids_are_the_joints_in_their_order(new_rig: Callable[..., Rig], register: Any) -> None:
    async def main() -> None:
        rig = new_rig(motor_ids=OTHERS)
        assert "no servo of" in await refused(rig)  # the usual ids are on the bus
        rig = new_rig(motor_ids=OTHERS)
        for servo, motor_id in zip(rig.bus.servos, OTHERS, strict=True):
            servo.table[register.address] = motor_id
        await rig.armed()
        seen = await rig.cycles(10, write=True)
        assert rig.driver.ids == OTHERS
        assert not seen.faults

    run_virtual(main)


@pytest.mark.parametrize("new_rig", RIGS)
@pytest.mark.parametrize(("options", "allowed_s"), [({}, 0.5), ({"timeout": 1.5}, 1.5)])
def test_a_bus_may_be_silent_for_the_configured_time(
    new_rig: Callable[..., Rig], options: dict[str, Any], allowed_s: float
) -> None:
    async def main() -> None:
        rig = await new_rig(**options).armed()
        rig.filter(lambda packet: False)
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="answers for"):
            await rig.cycles(200)
        assert allowed_s <= trio.current_time() - began_s < allowed_s + 0.4

    run_virtual(main)


def test_a_calibration_must_be_of_the_ids_that_were_given() -> None:
    motor = {"drive_mode": 0, "homing_offset": 0, "range_min": 100, "range_max": 4000}
    usual = Feetech.TABLES.robots["so101"]["joints"]
    calibration = {joint["key"]: {"id": motor_id, **motor} for joint, motor_id in zip(usual, OTHERS, strict=True)}
    resolved = Feetech.resolve("so101", {"calibration": calibration, "motor_ids": OTHERS})
    assert Feetech("so101", "memory", resolved).ids == OTHERS
    with pytest.raises(ValueError, match="id"):
        Feetech.resolve("so101", {"calibration": calibration})
