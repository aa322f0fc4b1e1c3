"""Test the wire and its stop channel in virtual time, on the twin's robot behind ports in memory."""

from __future__ import annotations

import math

import msgspec
import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.odometry import START, moved
from strands_actors.drivers.stretch.parameters import parameters_of
from strands_actors.drivers.stretch.twin.boards import PimuDecoder, StepperDecoder
from tests.drivers.common.memory_port import Permission, virtual

from .rig import ARM, HEAD, LEFT, LIFT, PIMU, RIGHT, WRIST, Rig

AXES = len(Stretch("stretch3", "", {}).axes)
HOME = (0.5, 0.1, *(0.0,) * 7)


def target(mask: int, **values: float) -> tuple[float, ...]:
    axes = Stretch("stretch3", "", {}).axes
    return (*(values.get(axis, home) for axis, home in zip(axes, HOME, strict=True)), float(mask))


LIFT_ALONE, BASE_ALONE, WRIST_ALONE = 1, 3 << 7, 4


def test_opening_sets_gains_and_limits_and_moves_nothing() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        facts = await wire.open()
        assert facts["model"] == "SE3" and facts["firmware"]["lift"] == "Stepper.v0.7.2p5"
        assert rig.ports_written("setpoint", "safe", "enable") == []
        lift = rig.world.steppers["lift"]
        assert not lift.has(p.Config.SYNC) and lift.has(p.Config.RUNSTOP)
        assert lift.limits == pytest.approx((0.0, 1.1 * rig.config.parameters.lift.rad_per_m))
        assert rig.world.steppers["left_wheel"].limits is None
        seen = await wire.read()
        assert seen.position == pytest.approx(HOME, abs=2e-3)
        assert len(wire.handover()) == 7
        wire.close()
        assert wire.handover() == () and all(port.closed for ports in rig.ports.values() for port in ports)

    virtual(test)


@pytest.mark.parametrize(
    ("board", "info", "why"),
    [
        (LIFT, ("Pimu.3", "Pimu.v0.7.2p6"), "lift is a Pimu board, must be a Stepper"),
        (ARM, ("Stepper.Irma.V1", "Stepper.v0.3.1p0"), "arm has firmware Stepper.v0.3.1p0"),
        (ARM, ("Stepper.3", "Stepper.v0.9.0p9"), "arm has firmware Stepper.v0.9.0p9"),
        (PIMU, ("Pimu.3", "bootloader"), "the firmware's name is 'bootloader'"),
    ],
)
def test_unknown_boards_and_firmware_are_refused(board: str, info: tuple[str, str], why: str) -> None:
    async def test() -> None:
        rig = Rig()
        decoder = rig.decoders[board]
        assert isinstance(decoder, StepperDecoder | PimuDecoder)
        decoder.INFO = info
        with pytest.raises(WireDown, match=why):
            await rig.wire().open()
        assert rig.ports_written("setpoint", "safe", "enable") == []
        assert all(port.closed for ports in rig.ports.values() for port in ports)

    virtual(test)


@pytest.mark.parametrize("board", [LIFT, PIMU, HEAD])
def test_a_board_that_is_mute_or_not_there_is_named(board: str) -> None:
    async def test() -> None:
        rig = Rig()
        rig.mute.add(board)
        name = {LIFT: "lift", PIMU: "pimu", HEAD: "head_pan"}[board]
        with pytest.raises(WireDown, match=f"{name}|no servo of stretch3"):
            await rig.wire().open()
        rig.unplug(board)
        with pytest.raises(WireDown, match=f"/dev/{board}: cannot open"):
            await rig.wire().open()

    virtual(test)


def test_a_board_with_invalid_gains_in_flash_is_named() -> None:
    async def test() -> None:
        rig = Rig()
        decoder = rig.decoders[LEFT]
        assert isinstance(decoder, StepperDecoder)
        do = decoder.do
        decoder.do = lambda call, data: b"\1\2" if call == p.FLASH_GAINS else do(call, data)  # type: ignore[method-assign]
        with pytest.raises(WireDown, match="left_wheel does not report its gains in flash: gains has 81 bytes"):
            await rig.wire().open()

    virtual(test)


def test_saf_011_arming_holds_everything_where_it_is() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        seen = await wire.arm(Permission())
        assert seen.position == pytest.approx(HOME, abs=2e-3)
        assert {motor.mode for motor in rig.world.steppers.values()} == {p.Mode.HOLD}
        assert "setpoint" not in {kind for _, kind, _ in rig.kinds}

    virtual(test)


def test_saf_009_nothing_is_sent_to_a_board_without_a_permit() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        with pytest.raises(PermitDenied):
            await wire.arm(Permission(denied_at=0))
        assert rig.ports_written("safe", "enable", "setpoint") == []
        with pytest.raises(PermitDenied):
            await wire.write(target(LIFT_ALONE, lift=0.6), Permission())
        await wire.arm(Permission())
        before = len(rig.kinds)
        with pytest.raises(PermitDenied):
            await wire.write(target(LIFT_ALONE | BASE_ALONE, lift=0.6, vx=0.1), Permission(denied_at=0))
        assert len(rig.kinds) == before

    virtual(test)


def test_nothing_is_armed_while_the_runstop_is_pressed_or_not_known() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        rig.mute.add(PIMU)
        with pytest.raises(WireDown, match="does not report whether the runstop is pressed"):
            await wire.arm(Permission())
        rig.mute.clear()
        await trio.sleep(0.2)
        rig.world.set_runstop(True)
        with pytest.raises(WireDown, match="the runstop is pressed"):
            await wire.arm(Permission())
        assert rig.ports_written("safe", "enable", "setpoint") == []

    virtual(test)


@pytest.mark.parametrize(
    ("alert", "sensor", "why"),
    [
        (
            p.State.LOW_VOLTAGE,
            "low_battery",
            "the battery is low. Charge it, then release the runstop on the robot",
        ),
        (p.State.OVER_TILT, "tilted", "the robot is tilted. Set it upright, then release the runstop on the robot"),
        (p.State.CLIFF, "at_cliff", "the base has met a cliff. Move it away"),
        (p.State.HIGH_CURRENT, "high_current", "the robot has drawn too much current. Remove what"),
    ],
)
def test_nothing_is_armed_while_the_robot_sets_its_runstop_by_itself(alert: p.State, sensor: str, why: str) -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        assert (await wire.read()).sensors[sensor] == (0.0,)
        rig.world.set_alert(alert, True)
        rig.world.set_runstop(False)  # releasing it has no effect
        with pytest.raises(WireDown, match=why):
            await wire.arm(Permission())
        sensors = (await wire.read()).sensors
        assert (sensors["runstop"], sensors[sensor]) == ((1.0,), (1.0,))
        rig.world.set_alert(alert, False)
        with pytest.raises(WireDown, match="the runstop is pressed"):
            await wire.arm(Permission())
        rig.world.set_runstop(False)
        await wire.arm(Permission())

    virtual(test)


def test_a_setpoint_goes_only_to_the_motors_that_it_names() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        for lift_m, mask, ports in (
            (0.6, LIFT_ALONE, {LIFT}),
            (0.6, BASE_ALONE, {LEFT, RIGHT}),
            (0.6, WRIST_ALONE, {WRIST}),
            (0.7, LIFT_ALONE | BASE_ALONE, {LIFT, LEFT, RIGHT}),
        ):
            rig.kinds.clear()
            await wire.write(target(mask, lift=lift_m, vx=0.1, wrist_yaw=0.1), Permission())
            assert set(rig.ports_written("setpoint", "config")) == ports

    virtual(test)


def test_a_servo_gets_its_profile_again_after_a_hold() -> None:
    """A hold has no profile, so that a servo does not ease into its stop."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        counts = []
        for _ in range(2):
            for _ in range(2):
                before = len(rig.ports[WRIST][0].written)
                await wire.write(target(WRIST_ALONE, wrist_yaw=0.1), Permission())
                counts.append(len(rig.ports[WRIST][0].written) - before)
            await wire.make_safe("hold")
        assert counts == [3, 1, 3, 1]

    virtual(test)


def test_saf_012_a_report_with_an_unchanged_time_does_not_count() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        first = await wire.read()
        await trio.sleep(0.07)
        assert (await wire.read()).stamp_ns[0] > first.stamp_ns[0]
        rig.world.set_fault(Fault.STUCK, 3)  # the lift's board repeats its last answer
        await wire.read()
        stamp_ns = (await wire.read()).stamp_ns[0]
        for _ in range(5):
            await trio.sleep(0.07)
            seen = await wire.read()
        assert seen.stamp_ns[0] == stamp_ns and seen.faults["lift"] == "silent"
        assert seen.stamp_ns[1] > stamp_ns
        with pytest.raises(WireDown, match="lift reports nothing new for"):
            for _ in range(10):
                await trio.sleep(0.07)
                await wire.read()

    virtual(test)


def test_a_board_that_was_reset_is_connected_again() -> None:
    """A reset restores the gains in flash. Gains that were set before are lost."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await trio.sleep(0.1)
        await wire.read()
        rig.world.steppers["left_wheel"].trigger(p.BOARD_RESET, 0.0)
        await trio.sleep(0.05)
        with pytest.raises(WireDown, match="left_wheel was reset"):
            await wire.read()

    virtual(test)


def test_saf_013_the_gates_learn_that_the_wheels_have_no_watchdog() -> None:
    async def test() -> None:
        common = parameters_of("stretch3")
        gains = common.right.gains
        off = gains._replace(config=gains.config & ~int(p.Config.VELOCITY_WATCHDOG))
        rig = Rig(right=msgspec.structs.replace(common.right, gains=off))
        wire = rig.wire()
        facts = await wire.open()
        assert facts["velocity_watchdog"]["right_wheel"] == {"acknowledged": False, "in_flash": True}
        assert (await wire.read()).sensors["wheel_watchdog"] == (0.0,)
        assert not rig.world.steppers["right_wheel"].has(p.Config.VELOCITY_WATCHDOG)

    virtual(test)


def test_the_twins_watchdog_stops_the_wheels_and_lift_and_arm_go_on() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await wire.write(target(LIFT_ALONE | BASE_ALONE, lift=0.6, vx=0.1), Permission())
        for _ in range(9):
            await trio.sleep(0.1)
            rig.world.pass_time()
        assert rig.world.metres_per_s("left_wheel") == pytest.approx(0.1)
        for _ in range(2):
            await trio.sleep(0.1)
            rig.world.pass_time()
        assert rig.world.steppers["left_wheel"].mode == p.Mode.SAFETY
        assert 0.0 < rig.world.metres_per_s("left_wheel") < 0.1, "a released wheel rolls out"
        for _ in range(12):
            await trio.sleep(0.1)
            rig.world.pass_time()
        assert rig.world.metres_per_s("left_wheel") == 0.0
        assert rig.world.metres("lift") == pytest.approx(0.6, abs=1e-3)

    virtual(test)


@pytest.mark.parametrize("by", ["wire", "stop_channel"])
@pytest.mark.parametrize("safe_state", ["hold", "stop"])
def test_saf_005_every_board_gets_the_stop_before_any_is_read(by: str, safe_state: str) -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        mask = LIFT_ALONE | BASE_ALONE | WRIST_ALONE
        await wire.write(target(mask, lift=0.9, vx=0.2, wrist_yaw=2.0), Permission())
        await trio.sleep(0.2)
        await wire.read()
        lift_m = rig.world.metres("lift")
        rig.kinds.clear()
        safer = wire if by == "wire" else rig.stop_channel()
        reports = await safer.make_safe(safe_state)
        assert all(report.safe for report in reports), reports
        boards = {LEFT, RIGHT, LIFT, ARM} | ({PIMU} if safe_state == "stop" else set())
        first = {name: kind for name, kind, _ in reversed(rig.kinds) if name in boards}
        assert first == dict.fromkeys(boards, "safe")
        assert "setpoint" not in {kind for _, kind, _ in rig.kinds}
        assert rig.world.safe_state == safe_state and rig.world.runstop == (safe_state == "stop")
        await trio.sleep(0.5)
        rig.world.pass_time()
        assert rig.world.metres_per_s("left_wheel") == pytest.approx(0.0, abs=1e-3)
        assert rig.world.metres("lift") == pytest.approx(lift_m, abs=0.01)
        assert rig.commands(LEFT)[2].kind == "safe" and rig.commands(LEFT)[2].mode == p.Mode.VELOCITY

    virtual(test)


def test_saf_005_a_board_that_does_not_answer_is_named_and_the_others_are_confirmed() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await wire.write(target(BASE_ALONE, vx=0.2), Permission())
        rig.mute.add(RIGHT)
        began_s = trio.current_time()
        reports = {report.axis: report for report in await wire.make_safe("hold")}
        assert trio.current_time() - began_s < 1.5
        assert not reports["right_wheel"].safe and reports["right_wheel"].written
        assert reports["right_wheel"].detail == "silent"
        assert all(report.safe for axis, report in reports.items() if axis != "right_wheel")
        assert rig.commands(RIGHT)[-1].mode == p.Mode.VELOCITY, "the wheel gets the command all the same"

    virtual(test)


def test_saf_020_lost_ports_are_tried_and_then_reopened() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await wire.write(target(LIFT_ALONE | BASE_ALONE, lift=0.9, vx=0.2), Permission())
        rig.unplug(LIFT)
        reports = {report.axis: report for report in await wire.reach("hold")}
        assert not reports["lift"].safe and "cannot open" in reports["lift"].detail
        assert reports["left_wheel"].safe and reports["arm"].safe
        assert all(port.closed for ports in rig.ports.values() for port in ports), (
            "all ports are closed, so another wire can open them"
        )
        rig.gone.clear()
        reports = {report.axis: report for report in await rig.wire().reach("hold")}
        assert reports["lift"].safe and rig.commands(LIFT)[-1].mode == p.Mode.HOLD

    virtual(test)


def test_saf_005_a_wheel_that_rolls_on_is_not_reported_as_stopped() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        motor = rig.world.steppers["left_wheel"]
        take = motor.take
        motor.take = lambda command: None if command.kind == "safe" else take(command)  # type: ignore[method-assign]
        await wire.write(target(BASE_ALONE, vx=0.2), Permission())
        for _ in range(8):
            await trio.sleep(0.05)
            await wire.write(target(BASE_ALONE, vx=0.2), Permission())
            rig.world.pass_time()
        motor.watchdog_s = math.inf
        reports = {report.axis: report for report in await wire.make_safe("hold")}
        assert not reports["left_wheel"].safe and "still turns" in reports["left_wheel"].detail
        assert reports["right_wheel"].safe

    virtual(test)


@pytest.mark.parametrize("by", ["wire", "stop_channel"])
def test_saf_005_an_earlier_report_of_a_hung_board_confirms_no_stop(by: str) -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await trio.sleep(0.05)
        rig.world.set_fault(Fault.STUCK, 1)  # the left wheel keeps answering that it holds
        safer = wire if by == "wire" else rig.stop_channel()
        reports = {report.axis: report for report in await safer.make_safe("hold")}
        assert not reports["left_wheel"].safe and reports["left_wheel"].detail == "reports nothing new"
        assert all(report.safe for axis, report in reports.items() if axis != "left_wheel")
        rig.world.set_fault(Fault.OK, None)
        assert all(report.safe for report in await safer.make_safe("hold"))

    virtual(test)


def test_saf_005_a_report_from_before_a_board_took_the_stop_proves_nothing() -> None:
    """Otherwise a wheel that held would stay at velocity zero until its watchdog releases it."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        motor = rig.world.steppers["left_wheel"]
        before, status = motor.status(), motor.status
        motor.status = lambda: before if motor.mode == p.Mode.VELOCITY else status()  # type: ignore[method-assign]
        assert all(report.safe for report in await wire.make_safe("hold"))
        assert motor.mode == p.Mode.HOLD

    virtual(test)


def test_saf_012_a_power_board_report_with_an_unchanged_time_does_not_count() -> None:
    """The runstop is read from this report."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.read()
        rig.world.set_fault(Fault.STUCK, 5)
        for _ in range(4):
            await trio.sleep(0.07)
            await wire.read()
        with pytest.raises(WireDown, match="pimu reports nothing new for"):
            for _ in range(10):
                await trio.sleep(0.07)
                await wire.read()

    virtual(test)


def test_a_power_board_that_was_reset_is_connected_again() -> None:
    """Until it is configured, its runstop may not stop the motors."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await trio.sleep(0.1)
        await wire.read()
        rig.world.reset_pimu()
        rig.world.stops_at_runstop = False
        await trio.sleep(0.05)
        with pytest.raises(WireDown, match="pimu was reset"):
            await wire.read()
        await wire.open()
        assert rig.world.stops_at_runstop
        await wire.read()

    virtual(test)


def test_odometry_on_an_arc() -> None:
    assert moved(START, 1.0, 1.0, 0.3153) == (1.0, 0.0, 0.0)
    quarter = math.pi / 2 * 0.3153 / 2
    turned = moved(START, -quarter, quarter, 0.3153)
    assert turned == pytest.approx((0.0, 0.0, math.pi / 2))
    outer, inner = math.pi / 2 * (1 + 0.3153 / 2), math.pi / 2 * (1 - 0.3153 / 2)
    assert moved(START, inner, outer, 0.3153) == pytest.approx((1.0, 1.0, math.pi / 2)), "a quarter of a circle"
