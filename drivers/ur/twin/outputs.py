"""The RTDE outputs of a simulated controller: the type of each output, and a function that computes it.

A ``Sample`` has the outputs of one tick. An output is computed only if a client reads it, and only once for all
clients.
"""

from __future__ import annotations

from collections.abc import Callable

from strands_actors.drivers.ur import protocol as p

from . import commands as c
from .controller import Controller

Getter = Callable[[Controller], p.Value]

ROOM_C, AMPERE_PER_NM = 30.0, 0.1
"""Room temperature, and current per torque of a motor, for the simulated measurements [assumed]."""

ROBOT_V, MAIN_V, TOOL_MODE_IDLE = 48.0, 48.0, 255

JOINT_RUNNING, JOINT_IDLE = 253, 239

_ZERO6, _ZERO3 = (0.0,) * 6, (0.0,) * 3


class Sample(dict[str, p.Value]):
    """The outputs of one tick, by name. An output is computed when it is first accessed."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller

    def __missing__(self, name: str) -> p.Value:
        value = self[name] = OUTPUTS[name][1](self._controller)
        return value


def _current(controller: Controller) -> p.Value:
    return tuple(nm * AMPERE_PER_NM for nm in controller.plant.effort_nm)


def _status(controller: Controller) -> p.Value:
    powered = c.STATUS_POWER_ON * (controller.mode >= p.RobotMode.POWER_ON)
    running = c.STATUS_PROGRAM_RUNNING * (controller.program is not None)
    return powered | running | c.STATUS_TEACH * controller.motion.limp


def _joint_mode(controller: Controller) -> p.Value:
    return (JOINT_RUNNING if controller.mode is p.RobotMode.RUNNING else JOINT_IDLE,) * 6


def _velocity(controller: Controller) -> p.Value:
    return tuple(controller.plant.velocity_rad_s)


OUTPUTS: dict[str, tuple[str, Getter]] = {
    "timestamp": ("DOUBLE", lambda robot: robot.uptime_s),
    "actual_q": ("VECTOR6D", lambda robot: tuple(robot.plant.position_rad)),
    "actual_qd": ("VECTOR6D", _velocity),
    "target_q": ("VECTOR6D", lambda robot: tuple(robot.motion.target(robot.plant))),
    "target_qd": ("VECTOR6D", _velocity),
    "actual_current": ("VECTOR6D", _current),
    "target_current": ("VECTOR6D", _current),
    "joint_control_output": ("VECTOR6D", _current),
    "target_moment": ("VECTOR6D", lambda robot: tuple(robot.plant.effort_nm)),
    "actual_current_as_torque": ("VECTOR6D", lambda robot: tuple(robot.plant.effort_nm)),
    "actual_TCP_pose": ("VECTOR6D", lambda robot: robot.tool().pose()),
    "target_TCP_pose": ("VECTOR6D", lambda robot: robot.target_tool().pose()),
    "actual_TCP_speed": ("VECTOR6D", lambda robot: robot.tool_speed()),
    "target_TCP_speed": ("VECTOR6D", lambda robot: robot.tool_speed()),
    "elbow_position": ("VECTOR3D", lambda robot: robot.kinematics.elbow(robot.plant.position_rad)),
    "joint_temperatures": ("VECTOR6D", lambda robot: (ROOM_C,) * 6),
    "actual_joint_voltage": ("VECTOR6D", lambda robot: (ROBOT_V,) * 6),
    "joint_mode": ("VECTOR6INT32", _joint_mode),
    "robot_mode": ("INT32", lambda robot: int(robot.mode)),
    "safety_mode": ("INT32", lambda robot: int(robot.safety)),
    "safety_status": ("INT32", lambda robot: int(robot.safety)),
    "safety_status_bits": ("UINT32", lambda robot: c.SAFETY_BITS[robot.safety]),
    "robot_status_bits": ("UINT32", _status),
    "runtime_state": ("UINT32", lambda robot: int(robot.runtime_state)),
    "speed_scaling": ("DOUBLE", lambda robot: 0.0 if robot.paused else 1.0),
    "target_speed_fraction": ("DOUBLE", lambda robot: robot.speed_slider),
    "actual_execution_time": ("DOUBLE", lambda robot: 0.0005),
    "actual_main_voltage": ("DOUBLE", lambda robot: MAIN_V),
    "actual_robot_voltage": ("DOUBLE", lambda robot: ROBOT_V),
    "actual_digital_output_bits": ("UINT64", lambda robot: robot.digital_out),
    "standard_analog_output0": ("DOUBLE", lambda robot: robot.analog_out[0]),
    "standard_analog_output1": ("DOUBLE", lambda robot: robot.analog_out[1]),
    "analog_io_types": ("UINT32", lambda robot: robot.analog_types << 2),
    "tool_mode": ("UINT32", lambda robot: TOOL_MODE_IDLE),
    "tool_output_voltage": ("INT32", lambda robot: robot.tool_voltage),
    "tool_temperature": ("DOUBLE", lambda robot: ROOM_C),
    "payload": ("DOUBLE", lambda robot: robot.payload_kg),
    "payload_cog": ("VECTOR3D", lambda robot: robot.payload_cog_m),
    "payload_inertia": ("VECTOR6D", lambda robot: robot.payload_inertia),
    "script_control_line": ("UINT32", lambda robot: robot.program_line),
    "output_bit_registers0_to_31": ("UINT32", lambda robot: robot.bits_out & 0xFFFFFFFF),
    "output_bit_registers32_to_63": ("UINT32", lambda robot: robot.bits_out >> 32 & 0xFFFFFFFF),
    "input_bit_registers0_to_31": ("UINT32", lambda robot: robot.bits_in & 0xFFFFFFFF),
    "input_bit_registers32_to_63": ("UINT32", lambda robot: robot.bits_in >> 32 & 0xFFFFFFFF),
}
"""All outputs: name -> RTDE type, and the function that computes the value."""


def _add(rtde_type: str, zero: p.Value, names: str) -> None:
    for name in names.split():
        OUTPUTS[name] = rtde_type, lambda robot: zero


def _element(attribute: str, index: int) -> Getter:
    def get(robot: Controller) -> p.Value:
        values: list[float] = getattr(robot, attribute)
        return values[index]

    return get


def _bit(attribute: str, index: int) -> Getter:
    def get(robot: Controller) -> p.Value:
        bits: int = getattr(robot, attribute)
        return bits >> index & 1

    return get


def _add_registers() -> None:
    """Add all integer, double and bit registers to ``OUTPUTS``, because clients may also read them."""
    for direction in ("in", "out"):
        for number in range(c.REGISTERS):
            OUTPUTS[f"{direction}put_int_register_{number}"] = "INT32", _element(f"int_{direction}", number)
            OUTPUTS[f"{direction}put_double_register_{number}"] = "DOUBLE", _element(f"double_{direction}", number)
        for number in c.SINGLE_BITS:
            OUTPUTS[f"{direction}put_bit_register_{number}"] = "BOOL", _bit(f"bits_{direction}", number)


_add_registers()
# The following outputs are always zero: the simulated controller has no connected inputs, and no force acts on the
# arm.
_add("VECTOR6D", _ZERO6, "target_qdd actual_TCP_force ft_raw_wrench actual_current_window")
_add("VECTOR3D", _ZERO3, "actual_tool_accelerometer elbow_velocity")
_add("UINT64", 0, "actual_digital_input_bits")
_add("UINT32", 0, "euromap67_input_bits euromap67_output_bits tool_analog_input_types")
_add("UINT8", 0, "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode")
_add(
    "DOUBLE",
    0.0,
    "actual_momentum actual_robot_current standard_analog_input0 standard_analog_input1 io_current "
    "euromap67_24V_voltage euromap67_24V_current tool_analog_input0 tool_analog_input1 tool_output_current "
    "tcp_force_scalar joint_position_deviation_ratio collision_detection_ratio",
)
_add("INT32", 0, "time_scale_source")

INPUT_TYPES: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    **{
        f"{bank}_digital_output{ending}": "UINT8"
        for bank in ("standard", "configurable", "tool")
        for ending in ("", "_mask")
    },
    **{f"input_bit_register_{number}": "BOOL" for number in c.SINGLE_BITS},
    **{f"input_int_register_{number}": "INT32" for number in range(c.REGISTERS)},
    **{f"input_double_register_{number}": "DOUBLE" for number in range(c.REGISTERS)},
}
