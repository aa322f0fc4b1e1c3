"""Test how the Robotiq wire is opened and armed, on the twin's gripper in memory and virtual time."""

from __future__ import annotations

import json
import subprocess
import sys

import msgspec
import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.wire import RobotiqWire
from tests.drivers.common.memory_port import Permission, virtual

from .rig import Rig, refused, sensor

OPENS_WITHIN_S = 1.2


# -- open


def test_open_moves_nothing_and_identifies_the_gripper() -> None:
    async def main() -> None:
        rig = Rig()
        facts = await rig.wire.open()
        assert facts == {"port": "192.0.2.10", "unit_id": 9, "stroke_mm": 85.0}
        json.dumps(facts)
        assert rig.written == []
        seen = await rig.wire.read()
        assert (sensor(seen, "activation"), sensor(seen, "fault")) == (0, 0)
        assert rig.wire.handover() == ()

    virtual(main)


def test_another_unit_is_refused_by_name() -> None:
    async def main() -> None:
        rig = Rig({"unit_id": 0})
        with pytest.raises(WireDown, match="gateway no response") as down:
            await rig.wire.open()
        assert "unit_id" in str(down.value)
        assert rig.ports[0].closed, "a wire that did not open keeps no connection"

    virtual(main)


def test_a_silent_gripper_is_named_within_its_bound() -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.set_fault(Fault.OFF)
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="no answer"):
            await rig.wire.open()
        assert trio.current_time() - began_s < OPENS_WITHIN_S
        assert rig.ports[0].closed

    virtual(main)


def test_a_port_that_is_no_address_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        config = msgspec.structs.replace(rig.driver.config, port="ttyUSB0:x")
        with pytest.raises(WireDown, match="Give an address"):
            await RobotiqWire(config, rig.clock, rig.connect).open()

    virtual(main)


# -- arm


def test_arming_activates_and_waits_for_it() -> None:
    async def main() -> None:
        rig = Rig(activation_s=3.0)
        await rig.wire.open()
        began_s = trio.current_time()
        seen = await rig.wire.arm(Permission())
        assert 3.0 <= trio.current_time() - began_s < 3.2
        assert sensor(seen, "activation") == 3
        assert rig.written == ["safe", "enable", "safe"]

    virtual(main)


def test_arming_an_active_gripper_moves_nothing() -> None:
    async def main() -> None:
        rig = Rig(activated=True, object_mm=30)
        rig.twin.write(0, p.Command(go_to=True, position=200).registers())
        await rig.wire.open()
        await rig.observe_for(1.0)
        held = (await rig.wire.read()).position
        rig.written.clear()
        seen = await rig.wire.arm(Permission())
        assert rig.written == ["safe"]
        assert seen.position == held
        assert rig.twin.gripper.status().request == rig.twin.gripper.status().position

    virtual(main)


def test_activation_can_be_withheld() -> None:
    async def main() -> None:
        rig = Rig({"activate": False})
        await rig.wire.open()
        assert "whole stroke" in await refused(rig)
        assert rig.written == []

    virtual(main)


def test_an_activation_that_does_not_end_is_named() -> None:
    async def main() -> None:
        rig = Rig(activation_s=99.0)
        await rig.wire.open()
        began_s = trio.current_time()
        assert "did not finish its activation within 10 s (gSTA 1" in await refused(rig)
        assert trio.current_time() - began_s < rig.driver.timing.arm_s
        assert (await rig.stop()).safe
        assert rig.twin.gripper.status().activation == 0, "only a reset ends an activation"

    virtual(main)


def test_major_faults_are_cleared_by_activation() -> None:
    async def main() -> None:
        rig = Rig(activated=True, gflt=0x0E)
        await rig.wire.open()
        assert (await rig.wire.read()).faults == {"gripper": "over-current (gFLT 14)"}
        seen = await rig.wire.arm(Permission())
        assert seen.faults == {}
        assert "enable" in rig.written

    virtual(main)


def test_a_minor_fault_stays_and_is_named() -> None:
    async def main() -> None:
        rig = Rig(gflt=0x08)
        await rig.wire.open()
        assert (await rig.wire.arm(Permission())).faults == {"gripper": "over temperature (gFLT 8)"}

    virtual(main)


def test_an_automatic_release_is_waited_out_by_people() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        rig.twin.write(0, p.Command(go_to=True, position=200).registers())
        await rig.wire.open()
        await rig.observe_for(0.5)
        rig.twin.write(0, p.Command(release=True).registers())
        assert "automatic release is running" in await refused(rig)
        report = await rig.stop()
        assert (report.written, report.acknowledged, report.safe) == (True, True, False)
        assert "the fingers open" in report.detail

    virtual(main)


def test_arming_is_refused_when_the_gripper_does_not_take_the_position() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        await rig.wire.open()
        rig.twin.set_fault(Fault.WRONG)
        assert "does not confirm the hold" in await refused(rig)

    virtual(main)


@pytest.mark.parametrize("denied_at", range(12))
def test_a_stop_during_arming_wins(denied_at: int) -> None:
    async def main() -> None:
        rig = Rig(activation_s=0.3)
        await rig.wire.open()
        with pytest.raises(PermitDenied):
            await rig.wire.arm(Permission(denied_at=denied_at))
        assert (await rig.stop()).safe
        status = rig.twin.gripper.status()
        assert status.activation != p.Activation.ACTIVATING and not status.going

    virtual(main)


# -- its cost

LEAN = """
import sys
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.kernel.clock import MonotonicClock
driver = Robotiq("robotiq_2f85", "192.0.2.10", {})
before = "pymodbus" in sys.modules
driver.open_wire(MonotonicClock())
driver.stop_channel((), MonotonicClock())
print(before, *sorted(name for name in ("pymodbus", "numpy", "mujoco", "serial") if name in sys.modules))
"""


def test_pymodbus_is_loaded_when_it_is_needed_and_nothing_heavy_ever() -> None:
    done = subprocess.run([sys.executable, "-c", LEAN], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "pymodbus", "serial"], (
        "pyserial is loaded early, because a stop must not import"
    )
