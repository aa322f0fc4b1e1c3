"""Simulate a UR controller: modes, registers, the running program, and the arm. No sockets.

Time advances only in ``tick``. Between two ticks only requests of clients change the controller's state.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS, Arm

from . import commands as c
from . import motion
from .kinematics import Kinematics
from .model import plant_of
from .motion import Motion, Unreachable
from .pose import ORIGIN, Frame, between, scaled

TICK_HZ = 500.0
"""Control rate of the simulated controllers, in Hz."""

MOMENT_S = 1e-4
"""Time step from which the speed of the tool is computed, in seconds."""

LEAST_LOOKAHEAD_S, LOOKAHEAD_S = 0.03, 0.1
"""Shortest look-ahead time of servoj, and the time that it takes if a program gives a shorter one."""

SUDDEN = 1.05
"""A target of servoj may be this much further away than a joint turns in the look-ahead time [assumed]. The error
(C204A1) and its text are the vendor's."""

DEVIATES_S = 0.35
"""A joint may be as far behind the target of servoj as it turns in this time [assumed]. The error (C153) and its
text are the vendor's."""

LOG_LINES = 200
"""Most lines in the controller's own log. A newer line replaces the oldest."""

SIX = range(len(JOINTS))


class Program(Protocol):
    """A program that runs on the simulated controller."""

    def react_to_inputs(self) -> None:
        """React to input registers that a client has just written."""
        ...

    def step(self) -> None:
        """Run the program for one tick."""
        ...


class Controller:
    def __init__(
        self,
        arm: Arm,
        *,
        gripper: str = "",
        program_start_s: float = 0.05,  # Time from the receipt of a program until its first line runs [assumed].
        now_s: Callable[[], float] = time.monotonic,
        on_event: Callable[[str, str], None] = lambda kind, text: None,
    ) -> None:
        """Build a controller and its arm.

        Args:
            arm: The arm.
            gripper: Name of the gripper on its flange; empty for none.
            program_start_s: Seconds from the receipt of a program until its first line runs.
            now_s: Returns the present time in seconds.
            on_event: Called with the kind and the log line of each event. The kinds are ``watchdog``, ``error``,
                and ``stopj`` of a running program.
        """
        self.plant = plant_of(arm, gripper)
        self.arm = arm
        self.kinematics = Kinematics(arm.dh_m, [(axis.low, axis.high) for axis in arm.axes])
        self.speed_rad_s = tuple(axis.speed for axis in arm.axes)
        self.program_start_s = program_start_s
        self.now_s = now_s
        self._on_event = on_event
        self.serial = "20265300001"
        self.wake_up()

    def wake_up(self) -> None:
        """Restart the controller and power on the arm. The arm stays where it is."""
        self.reset()
        self.set_mode(p.RobotMode.RUNNING)
        self.plant.catch_up(self.now_s())

    def reset(self) -> None:
        """Reset to the state after a boot, with the arm's power off. The arm stays where it is."""
        self.mode = p.RobotMode.POWER_OFF
        self.safety = p.SafetyMode.NORMAL
        self.remote = True
        self.paused = False
        self.speed_slider = 1.0
        self.payload_kg = 0.0
        self.payload_cog_m: tuple[float, ...] = (0.0,) * 3
        self.payload_inertia: tuple[float, ...] = (0.0,) * 6
        self.gravity_m_s2: tuple[float, ...] = (0.0, 0.0, 9.82)
        self.tcp = ORIGIN
        self.digital_out = 0
        self.analog_out = [0.0, 0.0]
        self.analog_types = 0b11  # One bit for each analog output: 1 for voltage, 0 for current.
        self.tool_voltage = 0
        self.bits_in = self.bits_out = 0
        self.program_line = 0
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self.int_in, self.int_out = [0] * c.REGISTERS, [0] * c.REGISTERS
        self.double_in, self.double_out = [0.0] * c.REGISTERS, [0.0] * c.REGISTERS
        self.program: Program | None = None
        self.motion: Motion = motion.Hold()
        self.simulation_moves = False  # True while a simulation, not a program on the controller, moves the arm.
        self.fault = Fault.OK
        self._starting: tuple[float, Callable[[], Program]] | None = None
        # Integer registers with a watchdog -> longest time between two writes, and time of the last write.
        self._watched: dict[int, tuple[float, float]] = {}
        self._booted_s = self.now_s()
        self._ticked_s = self._booted_s
        self._brake(True)

    # -- robot mode and safety mode

    @property
    def movable(self) -> bool:
        return self.mode is p.RobotMode.RUNNING and self.safety in p.MOVABLE_SAFETY

    def set_mode(self, mode: p.RobotMode) -> None:
        self.mode = mode
        if mode is not p.RobotMode.RUNNING:
            self.stop_program()
        self._brake(mode is not p.RobotMode.RUNNING)

    def set_safety(self, mode: p.SafetyMode) -> None:
        """Set the safety mode.

        A mode that stops the arm also ends the program. An emergency stop or a fault also switches off the arm's
        power.
        """
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

    # -- programs and their motions

    @property
    def busy(self) -> bool:
        """True if a program runs or is starting, so that only this program may move the arm."""
        return self.program is not None or self._starting is not None

    def start_program(self, make: Callable[[], Program]) -> None:
        """Start a program, and end the running one.

        The program does not start if the arm may not move, or if the controller is in local control.
        """
        self.stop_program()
        self.simulation_moves = False
        self.halt()
        if not self.movable:
            self.note(f"a program is not started: {self.mode.name}, {self.safety.name}")
        elif not self.remote:
            self.note("a program is not started: the robot is in local control")
        else:
            self._starting = self.now_s() + self.program_start_s, make

    def run_secondary(self, make: Callable[[], Program]) -> None:
        """Run a secondary program to its end, without ending the running program. It may not wait or move the
        arm."""
        if self.mode is p.RobotMode.RUNNING and self.remote:
            make().step()
        else:
            self.note(f"a secondary program is not run: {self.mode.name}, remote control {self.remote}")

    def stop_program(self) -> None:
        """End the running program, even if it is paused or still starting."""
        self._starting = None
        self.paused = False
        if self.program is not None:
            self.program = None
            self._watched.clear()
            self.program_line = 0
            self.halt()

    def note(self, text: str) -> None:
        """Write a line into the controller's own log."""
        self.log.append(text)
        self._on_event("error", text)

    def fail(self, reason: str) -> None:
        """End the running program, with a runtime error in the controller's log."""
        self.stop_program()
        self.note(f"runtime error: {reason}")

    def protect(self, reason: str) -> None:
        """Make a protective stop. On a real robot a person must then unlock it."""
        self.note(f"protective stop: {reason}")
        self.set_safety(p.SafetyMode.PROTECTIVE_STOP)

    @property
    def runtime_state(self) -> p.RuntimeState:
        if self.program is None:
            return p.RuntimeState.STOPPED
        return p.RuntimeState.PAUSED if self.paused else p.RuntimeState.PLAYING

    def halt(self) -> float:
        """Stop any motion of the arm. Return the time in seconds until the arm stands still."""
        target, limp = self.motion.target(self.plant), self.motion.limp
        off_rad = max(abs(goal - rad) for goal, rad in zip(target, self.plant.position_rad, strict=True))
        is_at_target = self.is_steady() and not limp and off_rad < motion.ARRIVED_RAD
        self.move(motion.Hold(target if is_at_target else None))
        return max(abs(rad_s) for rad_s in self.plant.velocity_rad_s) / motion.BRAKING_RAD_S2

    def halt_by_program(self) -> None:
        """Stop any motion, as the running program has ordered, and report this as the event ``stopj``."""
        self._on_event("stopj", "")
        self.halt()

    def move(self, new: Motion) -> None:
        if new.limp != self.motion.limp:
            for joint in SIX:
                self.plant.set_torque(joint, not new.limp)
        self.motion = new
        new.begin(self.plant)

    def move_joints(
        self, goal: Sequence[float], speed: float, acceleration: float, time_s: float = 0.0
    ) -> motion.Trip:
        """Begin a motion to joint positions (rad). Raise ``Unreachable`` if one is beyond the joint's range."""
        self.check_joints(goal)
        trip = motion.MoveTo(self.plant.position_rad, goal, speed, acceleration, time_s)
        self.move(trip)
        return trip

    def move_tool(self, goal: Frame, speed: float, acceleration: float, time_s: float = 0.0) -> motion.Trip:
        """Begin a motion of the tool on a straight line. Raise ``Unreachable`` if the arm cannot reach the goal."""
        if self.joints_for(goal, self.plant.position_rad) is None:
            raise Unreachable("no joints bring the tool there")
        trip = motion.MoveLine(self.tool(), goal, self.follow, speed, acceleration, time_s)
        self.move(trip)
        return trip

    def servo(self, goal: Sequence[float], lookahead_s: float) -> None:
        """Follow a goal of servoj or servol. Raise ``Unreachable`` for a goal to which a joint would jump."""
        ahead_s = lookahead_s if lookahead_s >= LEAST_LOOKAHEAD_S else LOOKAHEAD_S
        before = self.motion.target(self.plant)
        for joint, rad, was, speed in zip(JOINTS, goal, before, self.speed_rad_s, strict=True):
            if abs(rad - was) > SUDDEN * speed * ahead_s:
                raise Unreachable(f"C204A1, path sanity check: sudden change in target position of {joint}")
        self.move(motion.Servo(goal))

    def _check_path(self) -> None:
        """Make a protective stop if a joint cannot follow servoj, for example because something blocks it."""
        if self.program is None or not isinstance(self.motion, motion.Servo):
            return
        target, position = self.motion.target(self.plant), self.plant.position_rad
        for joint, goal, rad, speed in zip(JOINTS, target, position, self.speed_rad_s, strict=True):
            if abs(goal - rad) > DEVIATES_S * speed:
                self.protect(f"C153, position of {joint} deviates from path")
                return

    def check_joints(self, joints: Sequence[float]) -> None:
        """Raise ``Unreachable`` if a joint position is beyond the joint's range."""
        if not self.kinematics.within(joints):
            raise Unreachable("a joint is to go beyond its range")

    def solved(self, goal: Frame, near: Sequence[float]) -> Sequence[float]:
        """Return the joint positions as ``joints_for`` does, but raise ``Unreachable`` if there is no solution."""
        joints = self.joints_for(goal, near)
        if joints is None:
            raise Unreachable("no joints bring the tool there")
        return joints

    def watch(self, register: int, min_hz: float) -> None:
        """Set the watchdog of an integer register (``rtde_set_watchdog``), or remove it if ``min_hz`` is 0.

        The program is stopped if clients write the register at a lower rate than ``min_hz``.
        """
        if min_hz > 0:
            self._watched[register] = 1.0 / min_hz, self.now_s()
        else:
            self._watched.pop(register, None)

    # -- RTDE inputs that clients write

    def write(self, values: Mapping[str, p.Value]) -> None:
        """Store the input values that an RTDE client has written, by name."""
        for name, value in values.items():
            sort, number = INPUTS.get(name, ("", 0))
            if sort == "int":
                self.int_in[number] = value if isinstance(value, int) else int(_scalar(value))
                if number in self._watched:
                    self._watched[number] = self._watched[number][0], self.now_s()
            elif sort == "double":
                self.double_in[number] = _scalar(value)
            elif sort == "bits":
                self.bits_in = self.bits_in & ~(0xFFFFFFFF << number) | int(_scalar(value)) << number
            elif sort == "bit":
                self.bits_in = self.bits_in & ~(1 << number) | bool(value) << number
        if not values.keys() <= INPUTS.keys():
            self._write_panel(values)
        if self.program is not None and not self.paused:
            self.program.react_to_inputs()

    def _write_panel(self, values: Mapping[str, p.Value]) -> None:
        """Set the speed slider and the digital and analog outputs that a client has written. The masks in
        ``values`` select which of them change."""
        if values.get("speed_slider_mask"):
            self.speed_slider = max(0.0, min(1.0, _scalar(values.get("speed_slider_fraction", 1.0))))
        for bank, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = int(_scalar(values.get(f"{bank}_digital_output_mask", 0))) << shift
            bits = int(_scalar(values.get(f"{bank}_digital_output", 0))) << shift
            self.digital_out = self.digital_out & ~mask | bits & mask
        mask = int(_scalar(values.get("standard_analog_output_mask", 0))) & 0b11
        types = int(_scalar(values.get("standard_analog_output_type", 0)))
        self.analog_types = self.analog_types & ~mask | types & mask
        for index in (0, 1):
            if mask >> index & 1:
                self.analog_out[index] = _scalar(values.get(f"standard_analog_output_{index}", 0.0))

    # -- the passing of time

    def tick(self) -> None:
        # Check the watchdogs for the time of the last tick, not for the present time. If this process did not run
        # since the last tick, newer data may have arrived that was not read yet.
        last_tick_s, now_s = self._ticked_s, self.now_s()
        elapsed_s, self._ticked_s = min(now_s - last_tick_s, 0.1), now_s
        if self._starting is not None and now_s >= self._starting[0]:
            make = self._starting[1]
            self._starting = None
            self.program = make()
        for period_s, written_s in list(self._watched.values()):
            if last_tick_s - written_s > period_s:
                self.stop_program()
                self.log.append("a program was stopped: its watchdog was not fed")
                self._on_event("watchdog", "")
                break
        if not self.paused:
            if self.program is not None:
                self.program.step()
            try:
                self.motion.advance(self.plant, elapsed_s * (self.speed_slider if self.motion.slowed else 1.0))
            except Unreachable as unreachable:
                self.protect(str(unreachable))
        self.plant.catch_up(now_s)
        self._check_path()

    # -- the present state of controller and arm

    @property
    def uptime_s(self) -> float:
        return self._ticked_s - self._booted_s

    def tool(self) -> Frame:
        """Return the present frame of the tool centre point, in the base's frame."""
        return self.kinematics.flange(self.plant.position_rad).then(self.tcp)

    def target_tool(self) -> Frame:
        return self.kinematics.flange(self.motion.target(self.plant)).then(self.tcp)

    def tool_speed(self) -> tuple[float, ...]:
        """Return the velocity of the tool: m/s along, and rad/s about, the axes of the base."""
        position, velocity = self.plant.position_rad, self.plant.velocity_rad_s
        later = [rad + rad_s * MOMENT_S for rad, rad_s in zip(position, velocity, strict=True)]
        shift, turn = between(self.tool(), self.kinematics.flange(later).then(self.tcp))
        return (*scaled(shift, 1 / MOMENT_S), *scaled(turn, 1 / MOMENT_S))

    def joints_for(self, tool: Frame, near: Sequence[float]) -> Sequence[float] | None:
        """Return joint positions (rad) for a frame of the tool, or None if the arm cannot reach it.

        If several solutions exist, the one nearest to ``near`` is returned.
        """
        return self.kinematics.joints(tool.then(self.tcp.inverse()), near)

    def follow(self, tool: Frame, near: Sequence[float]) -> Sequence[float] | None:
        """Return joint positions as ``joints_for`` does, but only in the same posture of the arm as ``near``."""
        return self.kinematics.joints(tool.then(self.tcp.inverse()), near, follow=True)

    def is_steady(self) -> bool:
        return max(abs(rad_s) for rad_s in self.plant.velocity_rad_s) < motion.STANDING_RAD_S


INPUTS = {
    **{f"input_int_register_{number}": ("int", number) for number in range(c.REGISTERS)},
    **{f"input_double_register_{number}": ("double", number) for number in range(c.REGISTERS)},
    **{f"input_bit_register_{number}": ("bit", number) for number in c.SINGLE_BITS},
    "input_bit_registers0_to_31": ("bits", 0),
    "input_bit_registers32_to_63": ("bits", 32),
}
"""Registers, by their names in RTDE."""


def _scalar(value: p.Value) -> float:
    return float(value if isinstance(value, int | float) else value[0])
