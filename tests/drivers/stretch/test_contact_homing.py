"""Test that a joint of the twin that is not homed finds its stop by contact, as on the robot.

The tests take the steps of the vendor's homing routine: lift and arm by a guarded motion beyond the stop, the
wrist by pulse width until it no longer moves. ``test_vendor_client`` runs the routine itself.
"""

from __future__ import annotations

import math

import pytest

from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.common.dynamixel.servo import Servo
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.chains import HOMED
from strands_actors.drivers.stretch.twin.effort import FRICTION_A, TICKS_PER_A
from strands_actors.drivers.stretch.twin.stepper import StepperMotor
from strands_actors.drivers.stretch.twin.world import FAR_STOP_M, World

from .test_twin import Clock

FAR_M = 5.0
"""The vendor's homing routine sends a joint by so much beyond any stop."""


class Bench:
    """A twin after its power was switched on, with commands that need no sync pulse."""

    def __init__(self, robot: str = "stretch3") -> None:
        self.clock = Clock()
        self.world = World(robot, self.clock)
        self.world.power_cycle()
        for motor in self.world.steppers.values():
            motor.gains = motor.gains._replace(config=motor.gains.config & ~int(p.Config.SYNC))

    def run(self, seconds: float) -> None:
        """Let time pass, as with a client that asks all boards every 10 ms."""
        for _ in range(round(seconds / 0.01)):
            self.clock.now_s += 0.01
            self.world.pass_time()
            for bus in self.world.chains:
                bus.pass_time()

    def step(self, joint: str, metres: float, neg_pct: float, pos_pct: float, number: int = 1) -> StepperMotor:
        """Move a joint by a distance, with contact thresholds in percent of the greatest current."""
        motor, own = self.world.steppers[joint], self.world.config.motors[joint]
        top_a = dict(zip(p.GAINS_ORDER, motor.gains.values, strict=True))["iMax_pos"]
        motor.take(
            p.Command(
                p.Mode.STEP_PROFILE,
                metres * own.rad_per_m,
                own.speed_m_s * own.rad_per_m,
                own.acceleration_m_s2 * own.rad_per_m,
                feedforward_a=own.feedforward_a,
                contact_pos_a=pos_pct / 100 * top_a,
                contact_neg_a=neg_pct / 100 * top_a,
                step=number,
            )
        )
        return motor

    def reported_m(self, joint: str) -> float:
        return self.world.steppers[joint].status().position / self.world.config.motors[joint].rad_per_m


@pytest.mark.parametrize(
    ("joint", "towards", "end_m", "thresholds"),
    [("lift", FAR_M, 1.1, (-15.0, 80.0)), ("arm", -FAR_M, 0.0, (-55.0, 55.0))],
)
def test_a_joint_drives_to_its_stop_finds_it_by_its_current_and_sets_its_zero(
    joint: str, towards: float, end_m: float, thresholds: tuple[float, float]
) -> None:
    bench = Bench()
    began_m = bench.world.metres(joint)
    status = bench.world.steppers[joint].status()
    assert not status.has(p.Diag.HOMED) and abs(status.position) < math.tau, "the encoder knows one turn"
    motor = bench.step(joint, towards, *thresholds)
    bench.run(0.6)
    assert motor.status().contacts == 0 and abs(bench.world.metres(joint) - began_m) > 0.02
    bench.run(9.0)
    status = motor.status()
    assert status.has(p.Diag.CONTACT) and status.contacts > 0 and status.mode == p.Mode.SAFETY
    assert bench.world.metres(joint) == pytest.approx(end_m, abs=1e-6)
    assert bench.reported_m(joint) != pytest.approx(end_m, abs=0.05), "the encoder counts from where it was"
    motor.trigger(p.MARK_POSITION | p.SET_HOMED, end_m * bench.world.config.motors[joint].rad_per_m)
    assert bench.reported_m(joint) == pytest.approx(end_m)
    assert bench.world.metres(joint) == pytest.approx(end_m), "marking a position moves nothing"
    motor.take(bench.world.config.goal(joint, 0.3))
    assert not motor.status().has(p.Diag.CONTACT) and motor.status().has(p.Diag.HOMED)
    bench.run(10.0)
    assert bench.world.metres(joint) == pytest.approx(0.3, abs=1e-3) == bench.reported_m(joint)


@pytest.mark.parametrize(("joint", "high_m"), [("lift", 1.1), ("arm", 0.52 + FAR_STOP_M)])
def test_a_goal_for_a_joint_that_is_not_homed_leads_elsewhere_and_to_a_contact(joint: str, high_m: float) -> None:
    bench = Bench()
    motor = bench.world.steppers[joint]
    own = bench.world.config.motors[joint]
    motor.limits = (own.low_m * own.rad_per_m, own.high_m * own.rad_per_m)
    motor.take(bench.world.config.goal(joint, own.high_m - 0.01))
    bench.run(10.0)
    assert bench.world.metres(joint) == pytest.approx(high_m, abs=1e-6)
    assert motor.contacts > 0


def test_the_thresholds_of_the_command_decide_when_a_push_is_a_contact() -> None:
    ended_s = []
    for percent in (20.0, 55.0, 90.0, 101.0):
        bench = Bench()
        motor = bench.step("arm", -FAR_M, -percent, percent)
        while not motor.contacts and bench.clock.now_s < 5.0:
            bench.run(0.01)
        ended_s.append(bench.clock.now_s)
    assert ended_s == sorted(set(ended_s)), "a higher threshold takes longer"
    assert ended_s[2] - ended_s[0] < 0.2
    assert not motor.contacts, "the current cannot exceed the greatest current"
    assert motor.mode == p.Mode.STEP_PROFILE
    status = motor.status()
    assert status.has(p.Diag.CURRENT_LIMIT) and status.effort == pytest.approx(-4.4 * TICKS_PER_A, rel=0.01)
    assert bench.world.metres("arm") == 0.0


def test_a_threshold_below_the_friction_ends_a_motion_that_nothing_blocks() -> None:
    bench = Bench()
    motor = bench.step("arm", 0.1, -55.0, 2.0)
    bench.run(1.0)
    assert motor.contacts > 0 and bench.world.metres("arm") < 0.12


def test_the_effort_is_what_load_friction_and_a_push_need() -> None:
    bench = Bench()
    lift, arm = bench.world.steppers["lift"], bench.world.steppers["arm"]
    assert (lift.status().effort, arm.status().effort) == (0.0, 0.0), "after a restart nothing has torque"
    lift.take(bench.world.config.hold("lift"))
    bench.step("arm", 0.2, -55.0, 55.0)
    bench.run(1.0)
    assert lift.status().effort == pytest.approx(1.2 * TICKS_PER_A, rel=0.01), "it carries its weight"
    assert arm.status().effort == pytest.approx(FRICTION_A * TICKS_PER_A, rel=0.01)
    bench.step("arm", -0.1, -55.0, 55.0, number=2)
    bench.run(1.0)
    assert arm.status().effort == pytest.approx(-FRICTION_A * TICKS_PER_A, rel=0.01)


def test_a_velocity_ends_at_the_stop_too() -> None:
    bench = Bench()
    arm, own = bench.world.steppers["arm"], bench.world.config.motors["arm"]
    positive, negative = own.contact_a
    speed = 0.15 * own.rad_per_m
    arm.take(p.Command(p.Mode.VELOCITY, velocity=speed, contact_pos_a=positive, contact_neg_a=negative))
    bench.run(6.0)
    events = arm.contacts
    assert events > 0 and bench.world.metres("arm") == pytest.approx(0.52 + FAR_STOP_M)
    arm.take(p.Command(p.Mode.VELOCITY, velocity=-speed, contact_pos_a=positive, contact_neg_a=negative))
    bench.run(6.0)
    assert arm.contacts > events and bench.world.metres("arm") == pytest.approx(0.0)


def test_a_new_client_may_begin_its_count_of_steps_again() -> None:
    """A step has a number, and the board carries out each number once. Each command has one, also others."""
    bench = Bench()
    arm = bench.step("arm", 0.05, -55.0, 55.0, number=1)
    bench.run(2.0)
    bench.step("arm", 0.05, -55.0, 55.0, number=1)
    bench.run(2.0)
    assert bench.world.metres("arm") == pytest.approx(0.15, abs=1e-3), "the same number again is no new step"
    arm.take(p.Command(p.Mode.SAFETY))
    bench.step("arm", 0.05, -55.0, 55.0, number=1)
    bench.run(2.0)
    assert bench.world.metres("arm") == pytest.approx(0.2, abs=1e-3)


# -- servos


def switched_to(servo: Servo, mode: int) -> None:
    assert servo.write(t.TORQUE_ENABLE.address, b"\0") == 0
    assert servo.write(t.MODE.address, t.MODE.encode(mode)) == 0
    assert servo.write(t.TORQUE_ENABLE.address, b"\1") == 0


def home_servo(bench: Bench, servo: Servo, pwm: int) -> None:
    """Home a servo as the vendor's ``DynamixelHelloXL430.home`` does, with one stop."""
    switched_to(servo, t.PWM_MODE)
    assert servo.write(t.GOAL_PWM.address, t.GOAL_PWM.encode(pwm)) == 0
    bench.run(1.0)
    assert servo.read(t.MOVING.address, 1) == (0, b"\1")
    bench.run(9.0)
    assert servo.read(t.MOVING.address, 1) == (0, b"\0"), "it has met its stop"
    assert servo.write(t.GOAL_PWM.address, t.GOAL_PWM.encode(0)) == 0
    assert servo.write(t.TORQUE_ENABLE.address, b"\0") == 0
    assert servo.write(t.HOMING_OFFSET.address, t.HOMING_OFFSET.encode(0)) == 0
    servo.sense()
    assert servo.write(t.HOMING_OFFSET.address, t.HOMING_OFFSET.encode(-servo.get(t.POSITION))) == 0
    servo.sense()
    assert servo.get(t.POSITION) == 0 and servo.get(t.HARDWARE_ERROR) == 0
    assert servo.write(HOMED.address, b"\1") == 0
    switched_to(servo, t.EXTENDED_POSITION_MODE)


@pytest.mark.parametrize("robot", ["stretch", "stretch3"])
def test_the_wrist_turns_to_its_stop_and_sets_its_zero(robot: str) -> None:
    bench = Bench(robot)
    yaw, joint = bench.world.chains[0].servos[0], bench.world.config.chains[0].joints[0]
    yaw.sense()
    assert yaw.read(HOMED.address, 1) == (0, b"\0") and 0 <= yaw.get(t.POSITION) < 4096
    home_servo(bench, yaw, -300)
    stop_rad = -joint.zero / joint.scale
    assert bench.world.chains[0].plant.position_rad[0] == pytest.approx(stop_rad, abs=0.02)
    assert yaw.write(t.GOAL_POSITION.address, t.GOAL_POSITION.encode(round(joint.zero))) == 0
    bench.run(5.0)
    assert bench.world.chains[0].plant.position_rad[0] == pytest.approx(0.0, abs=0.02), "zero is forward again"
    bench.world.set_homed("wrist_yaw", True)
    yaw.sense()
    assert yaw.get(t.POSITION) == pytest.approx(joint.zero, abs=40), "the offset in EEPROM counts"


def test_the_gripper_closes_to_its_stop_and_opens_to_the_end_of_its_range() -> None:
    bench = Bench()
    gripper = bench.world.chains[0].servos[3]
    home_servo(bench, gripper, -400)
    assert gripper.write(t.GOAL_POSITION.address, t.GOAL_POSITION.encode(9102)) == 0
    bench.run(6.0)
    gripper.sense()
    assert gripper.get(t.POSITION) == pytest.approx(9102, abs=20)


def test_the_gears_stop_a_servo_that_loses_its_torque() -> None:
    bench = Bench()
    yaw = bench.world.chains[0].servos[0]
    switched_to(yaw, t.PWM_MODE)
    assert yaw.write(t.GOAL_PWM.address, t.GOAL_PWM.encode(-300)) == 0
    bench.run(0.5)
    assert bench.world.chains[0].plant.velocity_rad_s[0] > 1.0
    assert yaw.write(t.TORQUE_ENABLE.address, b"\0") == 0
    bench.run(0.1)
    assert bench.world.chains[0].plant.velocity_rad_s[0] == pytest.approx(0.0, abs=5e-4)
