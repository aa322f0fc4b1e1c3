"""Test how the Robotiq wire and its stop channel stop the twin's gripper, in memory and virtual time."""

from __future__ import annotations

from functools import partial

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.faults import Reply
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.client import ECHO_POLLS, HOLD_S, POLL_S, hold
from strands_actors.drivers.robotiq.connect import open_gripper
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.robotiq.wire import RobotiqWire
from tests.drivers.common.memory_port import MemoryPort, Permission, virtual

from .rig import Rig

STOPS_WITHIN_S = 1.2


# -- stop


def test_a_stop_holds_where_it_is_and_is_read_back() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(1.0)
        began_s = trio.current_time()
        report = await rig.stop()
        assert report == MotorReport("gripper", 9, True, True, True)
        assert trio.current_time() - began_s < 0.01
        assert rig.written == ["setpoint", "safe"]
        held = (await rig.observe_for(0.1)).position
        assert (await rig.observe_for(2.0)).position == held
        assert rig.twin.gripper.status().activation == 3, "the gripper keeps its grip"

    virtual(main)


def test_the_stop_leaves_before_anything_is_waited_for() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9)
        rig.silent_from = rig.questions
        await rig.wire.read()
        before = len(rig.ports[0].written)
        began_s = trio.current_time()
        await rig.stop()
        at_s, frame = rig.ports[0].written[before]
        assert at_s == began_s
        assert frame[7:10] == b"\x10\x03\xe8"
        assert rig.written[-1] == "safe"

    virtual(main)


def test_a_stop_that_is_not_taken_is_not_called_success() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9)
        await rig.observe_for(0.1)
        rig.twin.set_fault(Fault.STUCK)
        report = await rig.stop()
        assert report == MotorReport("gripper", 9, True, True, False, "the fingers still move to their target")

    virtual(main)


@pytest.mark.parametrize("channel", ["wire", "root"])
@pytest.mark.parametrize("echo_s", [0.0, 0.02])
def test_saf_005_a_hold_is_not_confirmed_by_an_earlier_status(channel: str, echo_s: float) -> None:
    """The setpoint is still under way inside the gripper, and the hold gets lost. The gripper does not move
    yet, but will."""

    async def main() -> None:
        rig = await Rig(echo_s=echo_s).armed()
        await rig.observe_for(0.4)
        gripper, taken = rig.twin.gripper, rig.twin.gripper.write
        gripper.write = lambda command: taken(command) if command.go_to else None  # type: ignore[method-assign]
        await rig.go(1.0, speed=0.0)
        began_s = trio.current_time()
        report = await (rig.stop() if channel == "wire" else rig.stop_channel())
        assert (report.written, report.acknowledged, report.safe) == (True, True, False)
        assert report.detail == "the fingers still move to their target"
        assert trio.current_time() - began_s < HOLD_S

    virtual(main)


@pytest.mark.parametrize("channel", ["wire", "root"])
def test_saf_005_a_hold_that_gets_lost_is_not_confirmed_by_a_gripper_that_stands(channel: str) -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.observe_for(0.1)
        rig.twin.gripper.write = lambda command: None  # type: ignore[method-assign]
        report = await (rig.stop() if channel == "wire" else rig.stop_channel())
        assert not report.safe
        assert "has not confirmed the hold" in report.detail

    virtual(main)


@pytest.mark.parametrize("channel", ["wire", "root"])
@pytest.mark.parametrize("echo_s", [0.005, 0.02, 0.045])
def test_a_hold_is_confirmed_once_it_is_taken_up(channel: str, echo_s: float) -> None:
    async def main() -> None:
        rig = await Rig(echo_s=echo_s).armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(0.5)
        began_s = trio.current_time()
        report = await (rig.stop() if channel == "wire" else rig.stop_channel())
        assert report == MotorReport("gripper", 9, True, True, True)
        assert echo_s < trio.current_time() - began_s < ECHO_POLLS * POLL_S
        assert rig.written[-1] == "safe"
        status = rig.twin.gripper.status()
        assert not status.going and status.activation == p.Activation.ACTIVE

    virtual(main)


def test_no_hold_follows_a_reset_that_is_still_pending() -> None:
    """A hold behind a reset is the rising edge that activates the gripper."""

    async def main() -> None:
        rig = Rig(activated=True, echo_s=0.08)
        gripper = await open_gripper(rig.driver.config, rig.clock, rig.connect)
        report = await hold(gripper, p.Status(), rig.driver.config)
        assert (report.safe, report.detail) == (False, "the gripper has not carried out the reset")
        assert set(rig.written) == {"safe"}
        await trio.sleep(1.0)
        rig.twin.gripper.pass_time()
        assert rig.twin.gripper.status().activation == p.Activation.RESET

    virtual(main)


# -- a stop in an unknown state of the gripper


@pytest.mark.parametrize("away_s", [0.1, 0.15, 0.3, 0.45])
def test_saf_005_a_stop_after_a_dip_of_the_supply_activates_nothing(away_s: float) -> None:
    """An earlier reading shows it activated. A hold would move its fingers."""

    async def main() -> None:
        rig = await Rig(object_mm=42.5).armed()
        await rig.go(1.0)
        await rig.observe_for(1.0)
        held = rig.twin.gripper.position
        rig.twin.set_fault(Fault.OFF)
        await rig.observe_for(away_s)
        rig.twin.set_fault(Fault.OK)
        rig.written.clear()
        assert await rig.stop() == MotorReport("gripper", 9, True, True, True)
        assert rig.written == ["safe"], "no request sets rACT again"
        await trio.sleep(2.0)
        rig.twin.gripper.pass_time()
        assert (rig.twin.gripper.status().activation, rig.twin.gripper.position) == (p.Activation.RESET, held)

    virtual(main)


def test_saf_005_a_stop_behind_a_lost_answer_asks_first_and_holds() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(0.5)
        lost = rig.questions + 1
        rig.delay_s = lambda number: 60.0 if number == lost else 0.001
        await rig.observe_for(0.06)
        before = len(rig.ports[0].written)
        began_s = trio.current_time()
        assert await rig.stop() == MotorReport("gripper", 9, True, True, True)
        at_s, frame = rig.ports[0].written[before + 1]
        assert frame[7:10] == b"\x10\x03\xe8"
        assert at_s - began_s < 0.005
        status = rig.twin.gripper.status()
        assert not status.going and status.activation == p.Activation.ACTIVE, "the gripper keeps its activation"

    virtual(main)


def test_saf_005_a_gripper_with_a_link_in_one_direction_is_stopped_within_the_bound() -> None:
    """The gripper may have been reset, so no hold is sent. A reset stops its fingers and activates nothing."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(0.5)
        rig.silent_from = rig.questions
        await rig.observe_for(0.15)
        before = len(rig.ports[0].written)
        began_s = trio.current_time()
        report = await rig.stop()
        assert (report.written, report.safe) == (True, False) and report.detail
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        at_s, frame = next(each for each in rig.ports[0].written[before:] if each[1][7] == 0x10)
        assert at_s - began_s < rig.driver.bound_s / 2
        assert frame[13] == 0, "rACT is 0: a reset"
        assert set(rig.written[1:]) == {"safe"}

    virtual(main)


def test_a_stop_without_a_connection_names_why() -> None:
    async def main() -> None:
        rig = Rig()
        assert (await rig.stop()).detail == "not connected"
        await rig.armed()
        rig.ports[0].unplugged = True
        report = await rig.stop()
        assert not report.written and "the port is gone" in report.detail
        with pytest.raises(WireDown):
            await rig.wire.read()

    virtual(main)


# -- the stop channel


@pytest.mark.parametrize("number", range(3), ids=["noise", "a lost end", "a wrong byte"])
def test_saf_005_a_stop_is_written_to_a_gripper_that_is_not_understood(number: int) -> None:
    """Its connection ended over invalid answers, and its answers on a new one are invalid, too."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(1.0, speed=0.0)
        await rig.observe_for(0.2)
        rig.twin.set_fault(Fault.GARBAGE)
        rig.wire.close()
        rig.written.clear()
        for _ in range(number):  # each answer is damaged in another way
            rig.twin.faults.apply(Reply(0.0, b"answer"))
        (report,) = await rig.wire.reach("hold")
        assert rig.written[:1] == ["safe"]
        assert (report.written, report.safe) == (True, False), "without a valid answer the stop is not confirmed"
        assert rig.ports[-1].closed

    virtual(main)


def test_saf_022_a_silent_gripper_is_reset() -> None:
    """The gripper may have lost power. A hold would activate it and move its fingers. A reset does not. It
    also stops a gripper that receives requests while its answers are lost."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.wire.close()
        rig.written.clear()
        rig.silent_from = rig.questions
        (report,) = await rig.wire.reach("hold")
        assert (rig.written[0], report.written, report.safe) == ("safe", True, False)
        assert not p.Command.from_registers(rig.twin.output()).activate
        assert await RobotiqWire(rig.driver.config, rig.clock, rig.connect).reach("hold") == (), (
            "the wire was never connected"
        )

    virtual(main)


def test_saf_020_a_gripper_whose_answers_alone_are_lost_is_stopped_on_the_old_connection() -> None:
    """A new connection needs an answer, so nothing can be sent there."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(1.0, speed=0.0)
        await rig.observe_for(0.2)
        rig.written.clear()
        rig.silent_from, began_s = rig.questions, trio.current_time()

        async def unanswered(host: str, port: int) -> MemoryPort:
            assert rig.written == ["safe"] and trio.current_time() - began_s < 0.05
            raise WireDown("no answer")

        rig.wire._open = partial(open_gripper, rig.driver.config, rig.clock, unanswered)
        (report,) = await rig.wire.reach("hold")
        assert not report.safe and rig.ports[0].closed
        assert not rig.twin.gripper.driven

    virtual(main)


@pytest.mark.parametrize("by", ["wire", "stop channel"])
def test_saf_008_a_reset_that_is_read_late_is_followed_by_no_hold(by: str) -> None:
    """After a pause the gripper answers a new connection first, and then reads the resets that waited. A hold has
    the bit rACT set, so after a reset it would activate the gripper."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(1.0, speed=0.0)
        await rig.observe_for(0.2)
        rig.unread = []
        await trio.sleep(0.1)  # until the status is old
        report = await rig.stop()
        assert report.written and not report.safe
        rig.written.clear()

        async def connect(host: str, port: int) -> MemoryPort:
            rig.read_on_after(1)
            return await rig.connect(host, port)

        if by == "wire":
            rig.wire._open = partial(open_gripper, rig.driver.config, rig.clock, connect)
            await rig.wire.reach("hold")
        else:
            channel = RobotiqStopChannel(rig.driver.config, (), rig.clock, connect)
            (report,) = await channel.make_safe("hold")
            assert report.safe
        await trio.sleep(0.5)
        assert "safe" in rig.written and "enable" not in rig.written
        assert not p.Command.from_registers(rig.twin.output()).activate

    virtual(main)


def test_a_gripper_that_answers_again_is_held_by_its_status() -> None:
    """A stop does not activate a gripper that was without power in the meantime."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.wire.close()
        rig.twin.power_cycle()
        rig.written.clear()
        await rig.wire.reach("hold")
        assert "enable" not in rig.written
        assert "setpoint" not in rig.written

    virtual(main)


def test_the_stop_channel_stops_a_move_on_its_own_connection() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(0.5)
        assert (await rig.stop_channel()).safe
        assert len(rig.ports) == 2
        assert rig.written == ["setpoint", "safe"]
        status = rig.twin.gripper.status()
        assert not status.going and status.activation == 3

    virtual(main)


def test_the_stop_channel_ends_an_activation() -> None:
    async def main() -> None:
        rig = Rig(activation_s=5.0)
        await rig.wire.open()
        with trio.move_on_after(0.5):
            await rig.wire.arm(Permission())
        assert rig.twin.gripper.status().activation == p.Activation.ACTIVATING
        assert (await rig.stop_channel()).safe
        assert rig.twin.gripper.status().activation == p.Activation.RESET

    virtual(main)


def test_the_stop_channel_never_activates() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.power_cycle()
        assert (await rig.stop_channel()).safe
        assert "enable" not in rig.written
        assert rig.twin.gripper.status().activation == p.Activation.RESET

    virtual(main)


def test_the_stop_channel_to_a_silent_gripper_is_bounded_and_honest() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.OFF)
        began_s = trio.current_time()
        report = await rig.stop_channel()
        assert not report.safe and report.detail
        assert trio.current_time() - began_s < STOPS_WITHIN_S

    virtual(main)


def test_saf_022_the_stop_channel_resets_a_gripper_after_a_lost_connection() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.wire.close()
        rig.written.clear()
        connect, lost = rig.connect, 0

        async def gone() -> bytes:
            raise WireDown("the connection is gone")

        async def lose_the_first(host: str, port: int) -> MemoryPort:
            nonlocal lost
            stream = await connect(host, port)
            if not lost:
                stream.read = gone  # type: ignore[method-assign]
            lost += 1
            return stream

        channel = RobotiqStopChannel(rig.driver.config, (), rig.clock, lose_the_first)
        (report,) = await channel.make_safe(SafeState.HOLD)
        assert (lost, rig.written[0], report.written) == (2, "safe", True)
        assert not p.Command.from_registers(rig.twin.output()).activate

    virtual(main)


def test_the_stop_channel_without_a_way_is_honest() -> None:
    async def main() -> None:
        rig = Rig()

        async def no_way(host: str, port: int) -> MemoryPort:
            raise WireDown("192.0.2.10:502: cannot connect (refused)")

        (report,) = await RobotiqStopChannel(rig.driver.config, (), rig.clock, no_way).make_safe("hold")
        assert report == MotorReport("gripper", 9, False, False, False, "192.0.2.10:502: cannot connect (refused)")

    virtual(main)
