"""The controller of the twin: modes, registers, the running program, the arm. It knows no sockets.

Time passes in ticks, on the clock it is given; between them it only changes what it is told to.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from strands_actors.drivers.common.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS, Arm

from . import commands as c
from . import motion
from .model import model_table
from .motion import Motion

TICK_HZ = 500.0
"""Of these controllers."""

ROOM_C, AMPERE_PER_NM = 30.0, 0.1
"""[assumed]"""

SIX = range(len(JOINTS))


class Program(Protocol):
    """What runs on the controller."""

    def heard(self) -> None:
        """An input was written."""
        ...

    def step(self) -> None:
        """A tick has passed."""
        ...


class Controller:
    def __init__(
        self,
        arm: Arm,
        *,
        program_start_s: float = 0.05,  # from a program's text to its first line [assumed]
        now_s: Callable[[], float] = time.monotonic,
        on_event: Callable[[str], None] = lambda kind: None,
    ) -> None:
        """``on_event`` hears what the controller does by itself: ``watchdog``."""
        self.plant = Plant.from_table(model_table(arm))
        self.speed_rad_s = tuple(axis.speed for axis in arm.axes)
        self.program_start_s = program_start_s
        self.now_s = now_s
        self._on_event = on_event
        self.serial = "20265300001"
        self.wake_up()

    def wake_up(self) -> None:
        """Powered on, where its arm is."""
        self.reset()
        self.set_mode(p.RobotMode.RUNNING)
        self.plant.catch_up(self.now_s())

    def reset(self) -> None:
        """As after a boot, but the arm stays where it is."""
        self.mode = p.RobotMode.POWER_OFF
        self.safety = p.SafetyMode.NORMAL
        self.remote = True
        self.paused = False
        self.speed_slider = 1.0
        self.payload_kg = 0.0
        self.digital_out = 0
        self.int_in, self.int_out = [0] * c.REGISTERS, [0] * c.REGISTERS
        self.double_in, self.double_out = [0.0] * c.REGISTERS, [0.0] * c.REGISTERS
        self.program: Program | None = None
        self.motion: Motion = motion.Hold()
        self.led = False  # whether a simulation moves the arm: until a program is started
        self.fault = Fault.OK
        self._starting: tuple[float, Callable[[], Program]] | None = None
        self._watched: dict[int, tuple[float, float]] = {}  # integer register -> period, when it was written
        self._booted_s = self.now_s()
        self._ticked_s = self._booted_s
        self._brake(True)

    # -- modes

    @property
    def movable(self) -> bool:
        return self.mode is p.RobotMode.RUNNING and self.safety in p.MOVABLE_SAFETY

    def set_mode(self, mode: p.RobotMode) -> None:
        self.mode = mode
        if mode is not p.RobotMode.RUNNING:
            self.stop_program()
        self._brake(mode is not p.RobotMode.RUNNING)

    def set_safety(self, mode: p.SafetyMode) -> None:
        """A stop ends the program; an emergency stop or a fault takes the power off the arm,
        too."""
        self.safety = mode
        if mode in p.MOVABLE_SAFETY:
            return
        self.stop_program()
        if mode not in (p.SafetyMode.PROTECTIVE_STOP, p.SafetyMode.SAFEGUARD_STOP, p.SafetyMode.RECOVERY):
            self.set_mode(p.RobotMode.POWER_OFF)

    def _brake(self, on: bool) -> None:
        for joint in SIX:
            self.plant.set_stuck(joint, on)
            self.plant.set_torque(joint, not on)
            self.plant.set_target(joint, self.plant.position_rad[joint])

    # -- programs

    @property
    def busy(self) -> bool:
        """Whether a program runs, or is about to: then the arm is its."""
        return self.program is not None or self._starting is not None

    def start_program(self, make: Callable[[], Program]) -> None:
        """Replaces whatever runs. Where nothing may move, or in local control, it is not
        started."""
        self.stop_program()
        self.led = False
        self.halt()
        if self.movable and self.remote:
            self._starting = self.now_s() + self.program_start_s, make

    def stop_program(self) -> None:
        self._starting = None
        if self.program is not None:
            self.program = None
            self._watched.clear()
            self.halt()

    @property
    def runtime_state(self) -> p.RuntimeState:
        if self.program is None:
            return p.RuntimeState.STOPPED
        return p.RuntimeState.PAUSED if self.paused else p.RuntimeState.PLAYING

    def halt(self) -> float:
        """Come to a stand from whatever motion. Seconds that this takes."""
        self.motion = motion.Hold()
        self.motion.begin(self.plant)
        return max(abs(rad_s) for rad_s in self.plant.velocity_rad_s) / motion.BRAKING_RAD_S2

    def move(self, new: Motion) -> None:
        self.motion = new
        new.begin(self.plant)

    def watch(self, register: int, min_hz: float) -> None:
        """``rtde_set_watchdog``: stop the program when the register is not written at least so
        often."""
        if min_hz > 0:
            self._watched[register] = 1.0 / min_hz, self.now_s()
        else:
            self._watched.pop(register, None)

    # -- inputs

    def write(self, values: Mapping[str, p.Value]) -> None:
        """What an RTDE client wrote."""
        for name, value in values.items():
            stem, _, number = name.rpartition("_")
            if stem == "input_int_register":
                self.int_in[int(number)] = int(_scalar(value))
                if int(number) in self._watched:
                    self._watched[int(number)] = self._watched[int(number)][0], self.now_s()
            elif stem == "input_double_register":
                self.double_in[int(number)] = _scalar(value)
        if values.get("speed_slider_mask"):
            self.speed_slider = _scalar(values["speed_slider_fraction"])
        for bank, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = int(_scalar(values.get(f"{bank}_digital_output_mask", 0))) << shift
            bits = int(_scalar(values.get(f"{bank}_digital_output", 0))) << shift
            self.digital_out = self.digital_out & ~mask | bits & mask
        if self.program is not None and not self.paused:
            self.program.heard()

    # -- time

    def tick(self) -> None:
        # As of the tick before: what had come by then has been read, also by a twin that had no
        # processor.
        seen_s, now_s = self._ticked_s, self.now_s()
        elapsed_s, self._ticked_s = min(now_s - seen_s, 0.1), now_s
        if self._starting is not None and now_s >= self._starting[0]:
            make = self._starting[1]
            self._starting = None
            self.program = make()
        for period_s, written_s in list(self._watched.values()):
            if seen_s - written_s > period_s:
                self.stop_program()
                self._on_event("watchdog")
                break
        if not self.paused:
            if self.program is not None:
                self.program.step()
            self.motion.advance(self.plant, elapsed_s)
        self.plant.catch_up(now_s)

    # -- outputs

    def outputs(self) -> dict[str, p.Value]:
        """Every output with what it says now; what a twin has no use for is zero."""
        plant = self.plant
        position, velocity = tuple(plant.position_rad), tuple(plant.velocity_rad_s)
        effort = tuple(plant.effort_nm)
        current = tuple(nm * AMPERE_PER_NM for nm in effort)
        target = tuple(self.motion.target(plant))
        pose = self._pose()
        running = self.program is not None
        values: dict[str, p.Value] = {
            **_ZERO,
            "timestamp": self._ticked_s - self._booted_s,
            "actual_execution_time": 0.0005,
            "actual_q": position,
            "actual_qd": velocity,
            "target_q": target,
            "target_qd": velocity,
            "actual_current": current,
            "target_current": current,
            "target_moment": effort,
            "joint_control_output": current,
            "actual_current_as_torque": effort,
            "actual_TCP_pose": pose,
            "target_TCP_pose": pose,
            "joint_temperatures": (ROOM_C,) * 6,
            "joint_mode": (253 if self.mode is p.RobotMode.RUNNING else 239,) * 6,
            "robot_mode": int(self.mode),
            "safety_mode": int(self.safety),
            "safety_status": int(self.safety),
            "safety_status_bits": c.SAFETY_BITS[self.safety],
            "robot_status_bits": (
                c.STATUS_POWER_ON * (self.mode >= p.RobotMode.POWER_ON) | c.STATUS_PROGRAM_RUNNING * running
            ),
            "runtime_state": int(self.runtime_state),
            "speed_scaling": 0.0 if self.paused else self.speed_slider,
            "target_speed_fraction": self.speed_slider,
            "payload": self.payload_kg,
            "actual_digital_output_bits": self.digital_out,
            "actual_main_voltage": 48.0,
            "actual_robot_voltage": 48.0,
        }
        for number in range(c.REGISTERS):
            values[f"output_int_register_{number}"] = self.int_out[number]
            values[f"output_double_register_{number}"] = self.double_out[number]
        return values

    def _pose(self) -> tuple[float, ...]:
        """Of the flange in the base: metres, then a rotation vector."""
        flange = self.plant.data.body("wrist_3")
        matrix = np.asarray(flange.xmat).reshape(3, 3)
        angle = math.acos(max(-1.0, min(1.0, (float(np.trace(matrix)) - 1) / 2)))
        skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
        norm = float(np.linalg.norm(skew))
        rotation = skew * (angle / norm) if norm > 1e-9 else skew
        return (*flange.xpos.tolist(), *rotation.tolist())

    def is_steady(self) -> bool:
        return max(abs(rad_s) for rad_s in self.plant.velocity_rad_s) < motion.STANDING_RAD_S


def _scalar(value: p.Value) -> float:
    return float(value if isinstance(value, int | float) else value[0])


OUTPUT_TYPES: dict[str, str] = {
    name: kind
    for kind, names in {
        "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
        "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 "
        "standard_analog_input1 standard_analog_output0 standard_analog_output1 payload",
        "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
        "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
        "joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia actual_current_as_torque",
        "VECTOR3D": "actual_tool_accelerometer payload_cog",
        "UINT64": "actual_digital_input_bits actual_digital_output_bits",
        "UINT32": "runtime_state robot_status_bits safety_status_bits",
        "INT32": "robot_mode safety_mode safety_status "
        + " ".join(f"output_int_register_{number}" for number in range(c.REGISTERS)),
        "VECTOR6INT32": "joint_mode",
    }.items()
    for name in names.split()
} | {f"output_double_register_{number}": "DOUBLE" for number in range(c.REGISTERS)}

INPUT_TYPES: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    **{
        f"{bank}_digital_output{ending}": "UINT8"
        for bank in ("standard", "configurable", "tool")
        for ending in ("", "_mask")
    },
    **{f"input_int_register_{number}": "INT32" for number in range(c.REGISTERS)},
    **{f"input_double_register_{number}": "DOUBLE" for number in range(c.REGISTERS)},
}

_SIZES = {"VECTOR6D": 6, "VECTOR3D": 3, "VECTOR6INT32": 6}
_ZERO: dict[str, p.Value] = {
    name: (0.0,) * _SIZES[kind] if kind in _SIZES else 0 for name, kind in OUTPUT_TYPES.items()
}
