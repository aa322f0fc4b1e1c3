"""Test the twin: how its boards handle any bytes, and the order in which it reports them."""

from __future__ import annotations

import random
import time
from collections import deque
from functools import partial
from pathlib import Path

import pytest
import serial

from strands_actors.drivers.common.dynamixel import protocol as dxl
from strands_actors.drivers.common.twin import Exchange, Fault
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.twin.boards import ReceivedFrame
from strands_actors.drivers.stretch.twin.server import commands_first, decoders_of
from strands_actors.drivers.stretch.twin.world import World
from strands_actors.testing import Twin
from tests.answers import until
from tests.drivers.disturbed import DISTURBED


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def world() -> World:
    return World("stretch3", Clock())


def test_20_000_disturbed_frames_move_nothing_and_raise_nothing() -> None:
    """Damaged calls of every kind except commands. A board accepts only whole frames."""
    chance = random.Random(11)
    robot = world()
    decoders = [decoder for decoder, _ in decoders_of(robot).values()]
    calls = [
        f.pull(p.STATUS),
        f.push(bytes((p.TRIGGER,))),
        f.push(b"\x63\1\2"),
        *f.pushes(b"\x05" * 130),
        dxl.ping(13),
    ]
    for _ in range(DISTURBED):
        data = bytearray(chance.choice(calls))
        for _ in range(chance.randrange(3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        for heard in chance.choice(decoders).frames(bytes(data) + chance.randbytes(chance.randrange(4)), 115_200):
            assert all(len(reply.data) < 200 for reply in heard.act().replies)
    assert all(motor.velocity == 0.0 for motor in robot.steppers.values())


def heard(kind: str, said: list[str]) -> ReceivedFrame:
    return ReceivedFrame(kind, partial(_say, kind, said))


def _say(kind: str, said: list[str]) -> Exchange:
    said.append(kind)
    return Exchange(kind, b"", ())


def test_a_sweep_reports_commands_before_stops_and_keeps_each_ports_order() -> None:
    said: list[str] = []
    waiting = {
        "a": deque([heard("safe", said), heard("read", said)]),
        "b": deque([heard("setpoint", said), heard("safe", said), heard("setpoint", said)]),
    }
    order = [(name, one.kind) for name, one in commands_first(waiting)]
    assert order == [("b", "setpoint"), ("a", "safe"), ("a", "read"), ("b", "safe"), ("b", "setpoint")]


@pytest.mark.parametrize("fault", [Fault.OFF, Fault.STUCK])
def test_a_motor_that_is_off_or_stuck_does_not_move(fault: Fault) -> None:
    robot = world()
    clock = robot.now_s
    assert isinstance(clock, Clock)
    lift = robot.steppers["lift"]
    robot.set_fault(fault, 3)
    lift.take(robot.config.goal("lift", 0.6))
    clock.now_s += 0.2
    robot.pass_time()
    if fault is Fault.STUCK:
        assert robot.metres("lift") == pytest.approx(0.5)
    else:
        assert not lift.homed, "without power the lift loses its position"
    robot.set_fault(Fault.OK, None)
    assert not lift.stuck


def test_the_runstop_lets_go_of_arm_and_wheels_and_holds_the_lift() -> None:
    robot = world()
    for name in ("lift", "arm"):
        robot.steppers[name].take(robot.config.goal(name, 0.3))
    assert robot.safe_state == ""
    robot.set_runstop(True)
    assert robot.safe_state == "stop"
    assert {motor.mode for motor in robot.steppers.values()} == {p.Mode.SAFETY}
    assert all(motor.status().has(p.Diag.RUNSTOP) for motor in robot.steppers.values())
    robot.steppers["arm"].take(robot.config.goal("arm", 0.3))
    assert robot.steppers["arm"].mode == p.Mode.SAFETY, "the arm accepts no command"
    robot.set_runstop(False)
    assert robot.steppers["arm"].mode == p.Mode.SAFETY, "the arm does not continue an old command"


@pytest.mark.parametrize("mode", [p.Mode.VELOCITY, p.Mode.VELOCITY_PROFILE])
def test_the_wheels_watchdog_lets_go_after_a_second_until_the_next_command(mode: p.Mode) -> None:
    robot = world()
    wheel = robot.steppers["left_wheel"]
    drives = p.Command(mode, velocity=5.0, acceleration=20.0)
    wheel.gains = wheel.gains._replace(config=wheel.gains.config & ~int(p.Config.SYNC))
    wheel.take(drives)
    robot.run(0.99)
    assert (wheel.mode, wheel.velocity) == (mode, pytest.approx(5.0))
    robot.run(0.02)
    assert wheel.mode == p.Mode.SAFETY and wheel.velocity > 4.0, "the wheel does not brake"
    robot.run(0.5)
    assert wheel.velocity == 0.0 and not wheel.status().has(p.Diag.RUNSTOP)
    wheel.take(drives)
    robot.run(0.5)
    assert (wheel.mode, wheel.velocity) == (mode, pytest.approx(5.0))


@pytest.mark.parametrize("is_guarded", [True, False])
def test_a_motor_that_pushes_is_stopped_by_its_board_until_the_next_command(is_guarded: bool) -> None:
    robot = world()
    arm, goal = robot.steppers["arm"], robot.config.goal("arm", 0.4)
    config = arm.gains.config & ~int(p.Config.SYNC)
    arm.gains = arm.gains._replace(config=config if is_guarded else config & ~int(p.Config.GUARDED))
    robot.set_contact("arm", True)
    events = 0
    for _ in range(2):
        arm.take(goal)
        assert not arm.status().has(p.Diag.CONTACT)
        robot.run(0.5)
        assert robot.metres("arm") == pytest.approx(0.1)
        assert arm.status().has(p.Diag.CONTACT) is is_guarded
        assert (arm.status().contacts > events) is is_guarded
        events = arm.status().contacts
        assert arm.mode == (p.Mode.SAFETY if is_guarded else p.Mode.POSITION_PROFILE)
    arm.take(robot.config.goal("arm", 0.05))
    robot.run(2.0)
    assert robot.metres("arm") == pytest.approx(0.05, abs=1e-3), "the arm may move back"
    robot.set_contact("arm", False)
    arm.take(goal)
    robot.run(4.0)
    assert robot.metres("arm") == pytest.approx(0.4, abs=1e-3)
    with pytest.raises(ValueError, match="wrist_yaw cannot meet an obstacle here"):
        robot.set_contact("wrist_yaw", True)


def test_limits_that_are_narrowed_on_the_way_hold_for_the_goal_too() -> None:
    robot = world()
    lift = robot.steppers["lift"]
    lift.gains = lift.gains._replace(config=lift.gains.config & ~int(p.Config.SYNC))
    lift.take(robot.config.goal("lift", 0.7))
    scale = robot.config.motors["lift"].rad_per_m
    lift.limits = (0.0, 0.52 * scale)
    robot.run(4.0)
    assert robot.metres("lift") == pytest.approx(0.52, abs=1e-3)


def test_a_robot_is_at_rest_when_every_moving_motor_got_a_stop() -> None:
    robot = world()
    robot.steppers["lift"].take(robot.config.goal("lift", 0.6))
    robot.dirty_servos.add(13)
    robot.steppers["left_wheel"].take(robot.config.stand("left_wheel"))
    assert robot.safe_state == ""
    robot.steppers["lift"].take(robot.config.hold("lift"))
    assert robot.safe_state == "", "a servo still moves"
    robot.dirty_servos.clear()
    assert robot.safe_state == "hold"


def test_homing_is_a_matter_of_three_joints() -> None:
    robot = world()
    robot.set_homed("lift", False)
    robot.set_homed("wrist_yaw", False)
    assert not robot.steppers["lift"].homed
    with pytest.raises(ValueError, match="head_pan needs no homing"):
        robot.set_homed("head_pan", False)


def test_the_robot_moves_on_while_no_client_asks(tmp_path: Path) -> None:
    """The vendor's programs send a goal and sleep until it must be there."""
    with Twin("stretch3", tmp_path) as twin:
        one = Stretch("stretch3", twin.port, {}).config
        with serial.Serial(one.usb("arm"), timeout=0.05) as port:
            arm = one.motors["arm"]
            config = arm.gains.config & ~int(p.Config.SYNC)
            for frame in (
                *f.pushes(arm.gains._replace(config=config).call(5)),
                f.push(one.goal("arm", 0.2).call()),
            ):
                port.write(frame)
            time.sleep(1.5)
            port.reset_input_buffer()
            port.write(f.pull(p.STATUS))
            (reply,) = until(lambda: list(f.Decoder().feed(port.read(200))), "its status")
    assert p.parse_stepper_status(reply.data[1:]).position / arm.rad_per_m > 0.15
