"""The wire on its twin's motors, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.can_motors.protocol import Damiao, Frame, State
from strands_actors.drivers.can_motors.stopping import TIMEOUT_S
from strands_actors.drivers.can_motors.wire import LOST_S
from strands_actors.drivers.common.twin.faults import Fault
from tests.drivers.common.memory_port import Permission, virtual

from .rig import ROBSTRIDE, Rig

ARMS = ({"robot": "openarm"}, {"robot": "bi_openarm"}, {"robot": "mine", "table": ROBSTRIDE})
arms = pytest.mark.parametrize("arm", ARMS, ids=["damiao", "two buses", "robstride"])


@arms
def test_opening_moves_and_configures_nothing(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = Rig(**arm)
        facts = await rig.wire.open()
        assert facts["adapters"] == ["slcan"] * rig.driver.arm.buses
        # Some of a robot's first bytes are for the adapter itself.
        assert set(rig.kinds()) == {"read", "other"}
        seen = await rig.wire.read()
        assert all(map(math.isfinite, seen.position))
        assert rig.states() == {State.DISABLED}

    virtual(main)


def test_an_absent_motor_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.robot.set_fault(Fault.OFF, 3)
        with pytest.raises(WireDown, match=r"no answer from joint_3 \(id 3\) at /dev/can0"):
            await rig.wire.open()
        assert rig.opened[0].closed

    virtual(main)


def test_the_ranges_are_those_that_a_motor_reports() -> None:
    async def main() -> None:
        rig = Rig()
        wide = 25.0
        motor = rig.robot.motor("joint_4")
        motor.ranges = type(motor.ranges)(wide, 10.0, 28.0, 500.0, 5.0)
        motor.parameters = motor.fresh()
        rig.robot.plant.data.qpos[rig.robot.plant._qpos[3]] = 1.2
        await rig.wire.open()
        seen = await rig.wire.read()
        assert rig.wire.session.link.codecs[3].ranges.position == wide
        assert seen.position[3] == pytest.approx(1.2, abs=0.1)

    virtual(main)


@arms
def test_arming_sets_the_timeout_and_holds_each_joint(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = Rig(**arm)
        await rig.wire.open()
        before = (await rig.wire.read()).position
        permit = Permission()
        seen = await rig.wire.arm(permit)
        assert rig.states() == {State.ENABLED}
        assert permit.checks > len(before), "before each motor, and at the end"
        ticks = {int.from_bytes(motor.parameters[motor.timeout], "little") for motor in rig.robot.motors}
        assert ticks == {round(TIMEOUT_S * 20_000)}
        assert "setpoint" not in rig.kinds()
        await rig.rest(0.4)
        after = (await rig.wire.read()).position
        assert after == pytest.approx(before, abs=0.05)
        assert rig.states() == {State.ENABLED}, "feed repeats the hold before the timeout ends"
        assert seen.faults == {}

    virtual(main)


def test_a_stop_during_arming_energises_no_further_motor() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        with pytest.raises(PermitDenied):
            await rig.wire.arm(Permission(denied_at=3))
        assert [motor.state for motor in rig.robot.motors].count(State.ENABLED) == 3
        reports = await rig.wire.make_safe(SafeState.LOWERED)
        assert all(report.safe for report in reports)
        assert rig.states() == {State.DISABLED}

    virtual(main)


def test_a_motor_that_ignores_its_timeout_is_not_energised() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        port = rig.opened[0]
        inner = port.peer

        def deaf(data: bytes) -> Any:
            lines = [line for line in data.split(b"\r") if not line.startswith(b"t7FF805005509")]
            yield from inner(b"\r".join(lines))

        port.peer = deaf
        with pytest.raises(WireDown, match=r"joint_5 \(id 5\) did not confirm its timeout of 0.2 s"):
            await rig.wire.arm(Permission())
        assert rig.states() == {State.DISABLED}

    virtual(main)


def test_a_fault_that_stays_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        motor = rig.robot.motor("joint_2")
        motor.switch(State.OVERLOAD)
        # Clearing does not help as long as the cause is there.
        motor.switch = lambda state: None  # type: ignore[method-assign]
        with pytest.raises(WireDown, match="joint_2 reports overload"):
            await rig.wire.arm(Permission())

    virtual(main)


def test_a_latched_fault_is_cleared_when_the_robot_is_armed() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        rig.robot.motor("joint_2").switch(State.LOST_COMMUNICATION)
        await rig.rest(0.1)
        assert (await rig.wire.read()).faults == {"joint_2": "lost communication"}
        await rig.wire.arm(Permission())
        assert rig.states() == {State.ENABLED}

    virtual(main)


def test_a_joint_outside_its_range_is_not_energised() -> None:
    async def main() -> None:
        rig = Rig("mine", {**ROBSTRIDE, "joints": [{**ROBSTRIDE["joints"][0], "low": 0.5, "high": 1.0}]})
        rig.robot.plant.data.qpos[:] = 0.2
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"joint1 is at 0\.\d+ rad, outside 0.5..1. Move it"):
            await rig.wire.arm(Permission())

    virtual(main)


@arms
def test_setpoints_move_the_arm(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = await Rig(**arm).armed()
        key = rig.driver.axes[0]
        await rig.stream(0.6, **{key: 0.4})
        seen = await rig.wire.read()
        assert seen.position[0] == pytest.approx(0.4, abs=0.1)
        assert set(rig.kinds()) == {"setpoint"}, "each frame of a stream has its feedback, so nothing is asked"

    virtual(main)


def test_gravity_compensation_carries_the_arm() -> None:
    async def main() -> None:
        errors = {}
        for compensated in (False, True):
            rig = await Rig(gravity_compensation=compensated).armed()
            await rig.put(joint_1=1.0, joint_4=1.5)
            await rig.stream(0.5, joint_1=1.0, joint_4=1.5)
            seen = await rig.wire.read()
            errors[compensated] = abs(seen.position[3] - 1.5) + abs(seen.position[0] - 1.0)
        assert errors[True] < 0.2 * errors[False]

    virtual(main)


def test_a_denied_setpoint_is_not_written() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        with pytest.raises(PermitDenied):
            await rig.wire.write(rig.target(), Permission(denied_at=0))
        assert rig.sent() == []
        # Before it is armed, the same holds for any setpoint.
        other = Rig()
        await other.wire.open()
        with pytest.raises(PermitDenied, match="not armed"):
            await other.wire.write(other.target(), Permission())

    virtual(main)


def test_without_feeding_the_motors_switch_off_by_themselves() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.rest(0.2)
        await trio.sleep(TIMEOUT_S + 0.05)
        assert rig.states() == {State.LOST_COMMUNICATION}

    virtual(main)


def test_a_silent_motor_is_named_and_a_silent_bus_is_lost() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.robot.set_fault(Fault.HALF_OPEN, 6)
        await rig.rest(LOST_S + 0.1)
        seen = await rig.wire.read()
        assert seen.faults == {"joint_6": "silent"}
        rig.robot.set_fault(Fault.HALF_OPEN)
        with pytest.raises(WireDown, match=r"no motor has answered for 0\.3 s"):
            await rig.rest(1.0)

    virtual(main)


def test_frames_of_others_on_the_bus_are_ignored() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        link = rig.wire.session.link
        before = list(link.feedback)
        for frame in (Frame(0x55, bytes(8)), Frame(0x11, b""), Frame(0x020005FD, bytes(8), True)):
            index = link._index.get((0, frame.id))
            if index is not None:
                link._take(index, frame, 0)
        assert link.feedback == before
        assert Damiao.ENABLE == 0xFC

    virtual(main)
