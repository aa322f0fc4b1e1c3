"""Test the homing of the wrist's yaw.

It counts whole turns, and loses the count when its servo is reset. It is not moved until it is homed again.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation, WireDown
from strands_actors.drivers.common.dynamixel import protocol as dxl
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.stretch.chains import HOMED
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.twin.world import World
from strands_actors.drivers.stretch.wire import StretchWire
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import Permission, virtual

from .rig import WRIST, Rig

DRIVER = Stretch("stretch3", "", {})
YAW = DRIVER.axes.index("wrist_yaw")
YAW_ID, GRIPPER_ID = 13, 14


def reboot(world: World, servo: int = YAW_ID) -> None:
    world.chains[0].handle(dxl.Packet(servo, dxl.REBOOT, b""))


def refused(action: dict[str, float], seen: Observation, now_ns: int) -> Refused | None:
    state = GateState(now_ns, seen, seen.position, now_ns, False)
    candidate = DRIVER.parse(action, state)
    assert isinstance(candidate, Candidate)
    return next((refusal for gate in DRIVER.gates if (refusal := gate(candidate, state)) is not None), None)


async def read_for(wire: StretchWire, seconds: float) -> Observation:
    seen = await wire.read()
    for _ in range(round(seconds / 0.05)):
        await trio.sleep(0.05)
        seen = await wire.read()
    return seen


def test_saf_014_a_servo_that_was_reset_has_lost_its_turns_and_is_not_moved_until_it_is_homed() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        seen = await wire.arm(Permission())
        assert seen.sensors["homed"][YAW] == 1.0
        reboot(rig.world)
        seen = await read_for(wire, 0.7)
        assert seen.faults["wrist_yaw"] == "limp" and seen.sensors["homed"][YAW] == 0.0
        refusal = refused({"wrist_yaw": 0.1}, seen, seen.t_ns)
        assert refusal is not None and refusal.code == "limp", "the joint must be energised first"
        await wire.make_safe("hold")
        seen = await wire.arm(Permission())
        assert seen.position[YAW] > 2.0, "the joint reports a wrong position"
        refusal = refused({"wrist_yaw": 0.1}, seen, seen.t_ns)
        assert refusal is not None and refusal.code == "not_homed"
        assert refused({"wrist_pitch": 0.1}, seen, seen.t_ns) is None
        await wire.make_safe("hold")
        rig.world.set_homed("wrist_yaw", True)
        seen = await wire.arm(Permission())
        assert seen.position[YAW] == pytest.approx(0.0, abs=0.01)
        assert refused({"wrist_yaw": 0.1}, seen, seen.t_ns) is None

    virtual(test)


def test_saf_014_a_reset_between_a_stop_and_the_next_arming_is_seen() -> None:
    """The servo was not read in the meantime."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await wire.make_safe("stop")
        rig.world.set_runstop(False)
        reboot(rig.world)
        seen = await wire.arm(Permission())
        refusal = refused({"wrist_yaw": 0.1}, seen, seen.t_ns)
        assert refusal is not None and refusal.code == "not_homed"

    virtual(test)


def test_a_servo_that_lost_only_its_torque_is_energised_again_and_still_homed() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        rig.world.chains[0].handle(dxl.Packet(YAW_ID, dxl.WRITE, bytes((t.TORQUE_ENABLE.address, 0, 0))))
        seen = await read_for(wire, 0.7)
        assert seen.faults["wrist_yaw"] == "limp" and seen.sensors["homed"][YAW] == 0.0, (
            "the missing reading may have been a reset"
        )
        await wire.make_safe("hold")
        seen = await wire.arm(Permission())
        assert refused({"wrist_yaw": 0.1}, seen, seen.t_ns) is None

    virtual(test)


def test_a_wrist_with_unknown_homing_is_not_energised() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        servo = rig.world.chains[0].servos[0]
        read = servo.read

        def mute(address: int, size: int) -> tuple[int, bytes]:
            return (dxl.ACCESS_ERROR, b"") if address == HOMED.address else read(address, size)

        servo.read = mute  # type: ignore[method-assign]
        rig.kinds.clear()
        with pytest.raises(WireDown, match=r"wrist_yaw .*does not report whether it is homed"):
            await wire.arm(Permission())
        assert WRIST not in rig.ports_written("enable")

    virtual(test)


@pytest.mark.parametrize(("servo", "at"), [(YAW_ID, 0), (GRIPPER_ID, 3)])
def test_the_twins_servos_that_count_turns_forget_them_without_power(servo: int, at: int) -> None:
    world = World("stretch3", lambda: 0.0)
    found = world.chains[0].servos[at]
    assert found.id == servo and found.read(HOMED.address, 1) == (0, b"\1")
    before = found.get(t.POSITION)
    reboot(world, servo)
    found.sense()
    assert found.read(HOMED.address, 1) == (0, b"\0")
    assert found.get(t.POSITION) == before % 4096
    world.reset()
    found.sense()
    assert found.read(HOMED.address, 1) == (0, b"\1") and found.get(t.POSITION) == before
