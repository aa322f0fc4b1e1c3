"""Test how the Robotiq wire moves and reads, on the twin's gripper in memory and virtual time."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.ports.modbus import SILENT_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.wire import READ_S, SOON_S
from tests.drivers.common.memory_port import Permission, virtual

from .rig import Rig, sensor

STOPS_WITHIN_S = 1.2


# -- moving


def test_a_move_arrives_at_its_speed() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.8, speed=0.0)
        assert (await rig.observe_for(1.0)).position[0] == pytest.approx(0.01 + 20 / 85, abs=0.02)
        seen = await rig.observe_for(3.0)
        assert seen.position == (0.8,)
        assert sensor(seen, "aperture_mm") == pytest.approx(17.0)
        assert (sensor(seen, "moving"), sensor(seen, "contact")) == (0.0, 0.0)
        assert rig.written == ["setpoint"]

    virtual(main)


def test_an_object_is_felt_and_held() -> None:
    async def main() -> None:
        rig = await Rig(object_mm=42.5).armed()
        await rig.go(1.0, force=0.5)
        seen = await rig.observe_for(1.0)
        assert seen.position[0] == pytest.approx(0.5, abs=0.01)
        assert sensor(seen, "contact") == 1.0
        assert sensor(seen, "current_a") == pytest.approx(0.64, abs=0.01)
        await rig.go(0.0)
        seen = await rig.observe_for(1.0)
        assert sensor(seen, "contact") == 0.0

    virtual(main)


def test_object_detection_does_not_count_before_the_echo() -> None:
    async def main() -> None:
        rig = await Rig(object_mm=42.5, echo_s=0.03).armed()
        await rig.go(1.0)
        assert sensor(await rig.observe_for(1.0), "contact") == 1.0
        await rig.go(0.2, speed=0.0)
        seen = await rig.wire.read()
        assert rig.twin.gripper.status().contact == p.Contact.CLOSING, (
            "the contact still belongs to the last command"
        )
        assert math.isnan(sensor(seen, "contact")) and math.isnan(sensor(seen, "moving"))
        seen = await rig.observe_for(0.1)
        assert sensor(seen, "moving") == 1.0
        assert seen.faults == {}

    virtual(main)


def test_a_write_stops_at_the_permit() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        with pytest.raises(PermitDenied):
            await rig.wire.write((0.5, 1.0, 1.0), Permission(denied_at=0))
        assert rig.written == []

    virtual(main)


def test_a_reset_gripper_never_gets_a_move() -> None:
    """A setpoint has rACT set. It would activate the gripper, which moves through its whole stroke."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.5)
        await rig.observe_for(1.0)
        rig.twin.power_cycle()
        rig.written.clear()
        with pytest.raises(WireDown, match="no longer activated"):
            await rig.observe_for(1.0)
        with pytest.raises(WireDown, match="not activated"):
            await rig.go(0.7)
        assert (await rig.stop()).safe
        assert rig.written == ["safe"]
        assert rig.twin.gripper.status().activation == 0

    virtual(main)


@pytest.mark.parametrize("away_s", [0.1, 0.15, 0.3, 0.45])
def test_a_supply_that_dips_in_the_middle_of_a_stream_activates_nothing(away_s: float) -> None:
    """The reading from before the dip shows it activated. The object stays in its grip."""

    async def main() -> None:
        rig = await Rig(object_mm=42.5).armed()
        await rig.go(1.0)
        await rig.observe_for(1.0)
        rig.written.clear()
        held = rig.twin.gripper.position
        rig.twin.set_fault(Fault.OFF)
        back_s = trio.current_time() + away_s
        denied = 0
        with pytest.raises(WireDown, match="no longer activated"):
            while True:
                if trio.current_time() >= back_s and rig.twin.fault is Fault.OFF:
                    rig.twin.set_fault(Fault.OK)
                    rig.written.clear()
                await rig.wire.read()
                try:
                    await rig.go(1.0)
                except PermitDenied:
                    denied += 1
                await trio.sleep(0.02)
        assert denied > 0, "commands are refused while the gripper is silent"
        assert rig.written == []
        await trio.sleep(2.0)
        rig.twin.gripper.pass_time()
        assert (rig.twin.gripper.status().activation, rig.twin.gripper.position) == (p.Activation.RESET, held)

    virtual(main)


def test_a_single_setpoint_after_a_dip_activates_nothing() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.OFF)
        await rig.observe_for(0.3)
        rig.twin.set_fault(Fault.OK)
        rig.written.clear()
        with pytest.raises(WireDown, match="write: the gripper is no longer activated"):
            await rig.go(0.5)
        assert rig.written == []

    virtual(main)


def test_a_setpoint_behind_a_lost_answer_asks_first_and_leaves() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        lost = rig.questions + 1
        rig.delay_s = lambda number: 60.0 if number == lost else 0.001
        await rig.observe_for(0.06)
        began_s = trio.current_time()
        await rig.go(0.5)
        assert trio.current_time() - began_s < 0.005
        assert rig.written == ["setpoint"]
        assert (await rig.observe_for(1.0)).position[0] == pytest.approx(0.5, abs=0.003)

    virtual(main)


def test_a_setpoint_behind_a_late_answer_waits_for_that() -> None:
    """Every answer takes 60 ms. A new request would be answered too late, the pending one is not."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.DELAYED)
        for number in range(40):
            await rig.wire.read()
            await trio.sleep(0.02)
            began_s = trio.current_time()
            await rig.go(number / 40)
            assert trio.current_time() - began_s <= SOON_S
        assert rig.written == ["setpoint"] * 40

    virtual(main)


def test_a_target_changed_by_another_client_is_reported() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.4)
        assert (await rig.observe_for(1.0)).faults == {}
        rig.twin.write(0, p.Command(go_to=True, position=7).registers())
        assert "unconfirmed" in (await rig.observe_for(0.1)).faults["gripper"]
        await rig.go(0.4)
        assert (await rig.observe_for(0.1)).faults == {}

    virtual(main)


# -- answers that are late or missing


@pytest.mark.parametrize("late", range(1, 20))
def test_one_late_answer_shifts_nothing(late: int) -> None:
    """An earlier version never recovered, and refused every later command and stop."""

    async def main() -> None:
        rig = Rig(activated=True)
        rig.delay_s = lambda number: 0.2 if number == late else 0.001
        await rig.armed()
        await rig.go(0.4)
        await rig.observe_for(0.5)
        await rig.go(0.6)
        seen = await rig.observe_for(1.0)
        assert seen.position == (0.6,)
        assert seen.faults == {}
        report = await rig.stop()
        assert report.safe and report.detail == ""
        assert len(rig.ports) == 1

    virtual(main)


def test_with_every_answer_late_it_still_drives() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        await rig.wire.open()
        rig.twin.set_fault(Fault.DELAYED)
        await rig.wire.arm(Permission())
        await rig.go(0.6)
        began_s = trio.current_time()
        seen = await rig.observe_for(1.0)
        assert seen.position == (0.6,)
        assert trio.current_time() - seen.t_ns / 1e9 < rig.driver.timing.state_ttl_s
        assert (await rig.stop()).safe
        assert trio.current_time() - began_s < 1.5

    virtual(main)


def test_a_reading_is_never_waited_for_long() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.silent_from = rig.questions
        first = await rig.wire.read()
        began_s = trio.current_time()
        while True:
            asked_s = trio.current_time()
            try:
                seen = await rig.wire.read()
            except WireDown as down:
                assert "no answer for" in str(down)
                break
            assert trio.current_time() - asked_s <= READ_S + 0.001
            assert seen.t_ns == first.t_ns, "an old reading keeps its time stamp"
        assert trio.current_time() - began_s < SILENT_S + 0.2

    virtual(main)


def test_a_gripper_that_answers_two_of_three_is_driven() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.INTERMITTENT)
        await rig.go(0.6)
        assert (await rig.observe_for(2.0)).position == (0.6,)
        assert (await rig.stop()).safe

    virtual(main)


def test_damaged_answers_end_the_connection() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.GARBAGE)
        with pytest.raises(WireDown):
            await rig.observe_for(1.0)

    virtual(main)


def test_a_command_that_was_not_accepted_is_reported() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.STUCK)
        await rig.go(0.5)
        seen = await rig.observe_for(0.2)
        assert seen.faults == {"gripper": "unconfirmed: sent 128, it repeats 3"}
        assert math.isnan(sensor(seen, "contact"))
        rig.twin.set_fault(Fault.OK)
        assert (await rig.observe_for(1.0)).faults == {}

    virtual(main)


@pytest.mark.parametrize("silent_from", range(40))
def test_silence_at_any_point_of_connect_and_of_a_move_is_bounded(silent_from: int) -> None:
    async def main() -> None:
        rig = Rig(activation_s=0.5)
        rig.silent_from = silent_from
        began_s = trio.current_time()
        with pytest.raises(WireDown):
            await rig.wire.open()
            with trio.fail_after(rig.driver.timing.arm_s):
                await rig.wire.arm(Permission())
            await rig.go(0.5)
            await rig.observe_for(60)
        silent_s = trio.current_time() - began_s
        assert silent_s < 4.0
        began_s = trio.current_time()
        report = await rig.stop()
        assert not report.safe and report.detail
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        rig.silent_from = None
        rig.wire.close()
        await rig.armed()
        await rig.go(0.3)
        assert (await rig.observe_for(2.0)).position[0] == pytest.approx(0.3, abs=0.003)

    virtual(main)
