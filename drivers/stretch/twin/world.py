"""Simulate the robot: four stepper motors, the power board, two chains of servos, and a floor."""

from __future__ import annotations

import math
import time
import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.common.dynamixel.servo import Servo
from strands_actors.drivers.common.dynamixel.twin import DynamixelBus
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.stepped import Stepped
from strands_actors.drivers.common.twin import Fault, Faults
from strands_actors.drivers.common.twin.servo_bus import COUNTS, COUNTS_PER_RAD
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.chains import HOMED
from strands_actors.drivers.stretch.config import ARM, LEFT, LIFT, PIMU, RIGHT, STEPPERS, StretchConfig
from strands_actors.drivers.stretch.odometry import START, moved
from strands_actors.drivers.stretch.parameters import Chain, Joint, Motor, parameters_of
from strands_actors.drivers.stretch.robots import nominal_of, robot_of
from strands_actors.drivers.stretch.safing import number_of

from .calls import BEEP, BOARD_RESET, BUZZER_OFF, BUZZER_ON, FAN_OFF, FAN_ON
from .stepper import ANYWHERE, StepperMotor

GRIPPER = "stretch_gripper"
PIMU_NUMBER = number_of(PIMU)
WACC, WACC_NUMBER = "wacc", 6
SERVO_V = 12.0
SERVO_MODEL, BY_CURRENT_MODEL = 1060, 1020
"""XL430-W250; XM430-W350 for a joint with an effort limit by current [assumed]."""
BY_CURRENT = ("wrist_pitch",)
"""``use_pos_current_ctrl`` of the vendor's parameters."""
BATTERY_RAW = 655.0
"""12.8 V"""
CURRENT_RAW = 170.0

FAR_STOP_M = 0.005
"""Distance from an end of the range of lift and arm to the mechanical stop that homing does not use [assumed].
Homing marks the other stop as the other end of the range: the upper one of the lift, the inner one of the arm."""
GEAR_NM = 0.5
"""Friction of the gears of a servo, which stops a joint without torque within 0.1 s [assumed]. A servo with torque
overcomes it, and reaches its goal all the same."""
PAD_COUNTS = 100
"""``range_pad_t`` of the vendor's parameters: distance from the end of a servo's range to its second stop."""


class TurningServo(Servo):
    """A servo that counts its turns. ``zero`` is the origin of the count after homing. Without power the servo
    loses the count of turns and the mark in RAM that it is homed."""

    def __init__(self, plant: Plant, index: int, servo_id: int, zero: float, scale: float) -> None:
        super().__init__(plant, index, servo_id, SERVO_MODEL, t.EXTENDED_POSITION_MODE, SERVO_V)
        self._zero = self.zero_count = zero
        self.counts_per_rad = scale

    def power_cycle(self) -> None:
        self._forget_turns()
        super().power_cycle()

    def _forget_turns(self) -> None:
        self.zero_count -= COUNTS * math.floor(self._count() / COUNTS)

    def home(self) -> None:
        """Set the origin of the count, and mark the servo as homed, as the robot's homing routine leaves it."""
        self.zero_count = self._zero - self.get(t.HOMING_OFFSET)
        self.sense()
        self.put(t.GOAL_POSITION, self.get(t.POSITION))
        self.write(HOMED.address, b"\1")

    def forget_home(self) -> None:
        """Remove the mark that the servo is homed. It knows its angle within one turn only."""
        self._forget_turns()
        self.sense()
        self.put(t.GOAL_POSITION, self.get(t.POSITION))
        self.write(HOMED.address, b"\0")


class GearedPlant(Plant):
    """Servos whose gears stop a joint that has no torque."""

    def _pass_to(self, index: int, commander: Commander) -> None:
        super()._pass_to(index, commander)
        self.model.dof_frictionloss[self._dof[index]] = GEAR_NM if commander is Commander.NONE else 0.0


@cache
def body_table() -> Mapping[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath("body.toml").read_text("utf-8"))


class World(Stepped):
    """The simulated robot. At the start lift, arm, wrist and head are in their home pose."""

    STEP_S = 0.002

    def __init__(self, robot: str, now_s: Callable[[], float] = time.monotonic) -> None:
        table, self.parameters = robot_of(robot), parameters_of(robot)
        self.config = StretchConfig(robot, self.parameters)
        super().__init__(now_s)
        self.faults = Faults()
        self._home = dict(zip(self.config.joints, table.home, strict=False))
        self.steppers = {
            name: StepperMotor(
                name,
                number_of(name),
                motor.gains,
                self._home.get(name, 0.0) * motor.rad_per_m,
                table.watchdog_s,
                _stops(name, motor),
                motor.feedforward_a,
            )
            for name, motor in self.config.motors.items()
        }
        number = table.tools[self.parameters.tool].gripper
        words = nominal_of(robot)[GRIPPER]
        gripper = _Gripper(number, float(words["zero_t"]), float(words["range_t"][1])) if number else None
        self.chains = (
            _bus(self.parameters.wrist, self._home, "arm_end", "wrist_rows", gripper, now_s),
            _bus(self.parameters.head, self._home, "mast", "head_rows", None, now_s),
        )
        self.dirty_servos: set[int] = set()
        """Servos that got a goal since they were last held."""
        self.runstop = False
        self.alerts = p.State(0)
        self.switched = p.State(0)
        """Fan and buzzer, if they are on."""
        self.beeps = 0
        self.stops_at_runstop = True
        self.syncs = 0
        self.pose = START
        self._pimu_began_s = 0.0

    # -- faults

    def set_runstop(self, on: bool) -> None:
        """Set or release the runstop (the robot's stop button). While the power board reports an alert, it sets
        the runstop again at once."""
        on = self.runstop = on or bool(self.alerts)
        for motor in self.steppers.values():
            motor.runstop(on and self.stops_at_runstop)

    def set_alert(self, alert: p.State, on: bool) -> None:
        self.alerts = self.alerts | alert if on else self.alerts & ~alert
        self.set_runstop(self.runstop)

    def set_homed(self, joint: str, on: bool) -> None:
        """Set whether a joint is homed. Without homing it does not know its position. Raise ``ValueError`` for a
        joint that needs no homing."""
        self.pass_time()
        if joint in (LIFT, ARM):
            motor = self.steppers[joint]
            (motor.home if on else motor.forget_home)()
            return
        for chain, bus in zip(self.config.chains, self.chains, strict=True):
            for index, candidate in enumerate(chain.joints):
                servo = bus.servos[index]
                if candidate.key == joint and candidate.needs_homing and isinstance(servo, TurningServo):
                    (servo.home if on else servo.forget_home)()
                    return
        raise ValueError(f"{joint} needs no homing. Use lift, arm or wrist_yaw")

    def set_contact(self, joint: str, on: bool) -> None:
        """Put an obstacle right above the lift, or in front of the arm. Raise ``ValueError`` for another joint."""
        if joint not in (LIFT, ARM):
            raise ValueError(f"{joint} cannot meet an obstacle here. Use lift or arm")
        self.pass_time()
        self.steppers[joint].wall = self.steppers[joint].position if on else None

    def sync(self) -> None:
        self.syncs += 1
        for motor in self.steppers.values():
            motor.sync()

    def trigger_pimu(self, bits: int) -> None:
        """Carry out the triggers of the power board."""
        if bits & p.RUNSTOP_RESET:
            self.set_runstop(False)
        if bits & p.RUNSTOP_ON:
            self.set_runstop(True)
        if bits & p.CLIFF_RESET:
            self.set_alert(p.State.CLIFF, False)
        if bits & BOARD_RESET:
            self.reset_pimu()
        if bits & BEEP:
            self.beeps += 1
        for on, off, flag in ((FAN_ON, FAN_OFF, p.State.FAN), (BUZZER_ON, BUZZER_OFF, p.State.BUZZER)):
            if bits & (on | off):
                self.switched = self.switched | flag if bits & on else self.switched & ~flag

    def reset_pimu(self) -> None:
        """Restart the power board. Its clock begins again at zero. Its configuration stays in flash memory
        [assumed]."""
        self._pimu_began_s = self.time_s
        self.switched = p.State(0)

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        self.pass_time()
        self.faults.set(fault, unit)
        if self.faults.of(PIMU_NUMBER) is Fault.OFF:
            self.reset_pimu()
        for motor in self.steppers.values():
            present_fault = self.faults.of(motor.number)
            motor.stuck = present_fault is Fault.STUCK
            if present_fault is Fault.OFF:
                motor.power_cycle()
        for bus in self.chains:
            bus.set_fault(fault, unit)

    def power_cycle(self) -> None:
        self.pass_time()
        self.runstop, self.alerts = False, p.State(0)
        self.reset_pimu()
        for motor in self.steppers.values():
            motor.is_stopped = False
            motor.power_cycle()
        for bus in self.chains:
            bus.power_cycle()
        self.dirty_servos.clear()

    def reset(self) -> None:
        """Put the robot back into its first state, with all joints homed."""
        self.power_cycle()
        for name, motor in self.steppers.items():
            motor.position = self._home.get(name, 0.0) * self.config.motors[name].rad_per_m
            motor.release()
            motor.home()
            motor.wall = None
        for bus in self.chains:
            bus.plant.go_home()
            _home(bus)
        self.pose = START

    @property
    def safe_state(self) -> str:
        """Return the present safe state of the whole robot; empty if it is in no safe state."""
        if self.dirty_servos or any(motor.is_dirty for motor in self.steppers.values()):
            return ""
        return "stop" if self.runstop else "hold"

    # -- time

    def _step(self, step_s: float) -> None:
        before = {name: self.steppers[name].position for name in (LEFT, RIGHT)}
        for motor in self.steppers.values():
            motor.step(step_s)
        left, right = (
            (self.steppers[name].position - before[name]) / self.config.motors[name].rad_per_m
            for name in (LEFT, RIGHT)
        )
        self.pose = moved(self.pose, left, right, self.parameters.separation_m)

    # -- reports of the power board

    def pimu_status(self) -> p.PimuStatus:
        wheels = [self.metres_per_s(name) for name in (LEFT, RIGHT)]
        half_rad = self.pose.yaw_rad / 2
        state = self.alerts | self.switched | (p.State.RUNSTOP if self.runstop else p.State(0))
        return p.PimuStatus(
            acceleration=(0.0, 0.0, 9.81),
            gyro=(0.0, 0.0, self.config.twist(*wheels)[1]),
            magnetic=(20.0, 0.0, 40.0),
            roll_pitch_heading=(0.0, 0.0, math.degrees(self.pose.yaw_rad) % 360.0),
            orientation=(math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)),
            bump=0.0,
            voltage=BATTERY_RAW,
            current=CURRENT_RAW,
            temperature=300.0,
            cliffs=(0.0, 0.0, 0.0, 0.0),
            state=int(state),
            timestamp_us=round((self.time_s - self._pimu_began_s) * 1e6),
        )

    def metres(self, name: str) -> float:
        return self.steppers[name].position / self.config.motors[name].rad_per_m

    def metres_per_s(self, name: str) -> float:
        return self.steppers[name].velocity / self.config.motors[name].rad_per_m

    def numbers(self) -> dict[str, int]:
        """Return the unit number of each board, by which a fault selects it."""
        return {**{name: number_of(name) for name in (*STEPPERS, PIMU)}, WACC: WACC_NUMBER}


class _Gripper(NamedTuple):
    """The gripper's servo. Zero: its fingertips just touch. Counts are those after homing."""

    id: int
    zero_count: float
    open_count: float


def _stops(name: str, motor: Motor) -> tuple[float, float]:
    """Return the mechanical ends of a joint's travel, in motor radians. A wheel has none."""
    if name == LIFT:
        return (motor.low_m - FAR_STOP_M) * motor.rad_per_m, motor.high_m * motor.rad_per_m
    if name == ARM:
        return motor.low_m * motor.rad_per_m, (motor.high_m + FAR_STOP_M) * motor.rad_per_m
    return ANYWHERE


def _bus(
    chain: Chain,
    home: Mapping[str, float],
    root: str,
    rows: str,
    gripper: _Gripper | None,
    now_s: Callable[[], float],
) -> DynamixelBus:
    """Return one chain of servos with its own body, mounted where it is on the whole robot."""
    table = body_table()
    spec = build({**table, "model_rows": f"{root} base - - 0,0,1 0 - - - .1 - s.01\n{table[rows]}"})
    # A servo that needs homing has its first stop where its count is 0 after homing.
    turning = [each for each in chain.joints if each.needs_homing]
    ends = {each.key: (each.zero, each.scale, float(each.high_t)) for each in turning}
    keys = [joint.key for joint in chain.joints]
    if gripper is not None:
        keys.append(GRIPPER)
        ends[GRIPPER] = gripper.zero_count, COUNTS_PER_RAD, gripper.open_count
    for joint in spec.joints:
        if joint.name in ends:
            zero, scale, highest = ends[joint.name]
            joint.range = sorted((count - zero) / scale for count in (0.0, highest + PAD_COUNTS))
    plant = GearedPlant(spec, keys, float(table["bandwidth"]), [home.get(key, 0.0) for key in keys])
    servos = [_servo(plant, index, joint) for index, joint in enumerate(chain.joints)]
    if gripper is not None:
        servos.append(_set_up(TurningServo(plant, len(servos), gripper.id, gripper.zero_count, COUNTS_PER_RAD)))
    bus = DynamixelBus(plant, servos, now_s)
    _home(bus)
    return bus


def _servo(plant: Plant, index: int, joint: Joint) -> Servo:
    if joint.needs_homing:
        return _set_up(TurningServo(plant, index, joint.id, joint.zero, joint.scale))
    servo = Servo(plant, index, joint.id, SERVO_MODEL, t.POSITION_MODE, SERVO_V)
    if joint.key in BY_CURRENT:
        servo = Servo(plant, index, joint.id, BY_CURRENT_MODEL, t.CURRENT_POSITION_MODE, SERVO_V)
    servo.zero_count, servo.counts_per_rad = joint.zero, joint.scale
    return _set_up(servo)


def _set_up(servo: Servo) -> Servo:
    servo.write(t.BAUD.address, t.BAUD.encode(t.BAUD_RATES.index(115_200)))
    servo.write(t.RETURN_DELAY.address, b"\0")
    servo.power_cycle()
    return servo


def _home(bus: DynamixelBus) -> None:
    for servo in bus.servos:
        if isinstance(servo, TurningServo):
            servo.home()
