"""Walks of what runs on a UR controller: URScript functions, and ur-rtde's commands.

A program takes time. So each question builds two twins, one with the call and one without it, and compares what is
seen of them after the same time.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.functions import Functions
from strands_actors.drivers.ur.twin.model import HOME_RAD
from strands_actors.drivers.ur.twin.pose import frame_of
from strands_actors.drivers.ur.twin.requests import COMMANDS, FUNCTIONS
from strands_actors.drivers.ur.twin.script import program_of
from tests.drivers.ur.world import COMMAND, SCRIPT, World

from .walk import Answer, Walk, fingerprint

_OTHER = """
acos add_blend asin atan atan2 binary_list_to_integer ceil clear_conveyor conveyor_pulse_decode direct_torque
enable_external_ft_sensor encoder_enable_pulse_decode encoder_enable_set_tick_count encoder_get_tick_count
encoder_set_tick_count encoder_unwind_delta_tick_count end_force_mode end_screw_driving floor force force_mode
force_mode_set_damping force_mode_set_gain_scaling ft_rtde_input_enable get_actual_joint_positions_history
get_actual_tool_flange_pose get_actual_tcp_speed get_analog_in get_analog_out get_configurable_digital_in
get_configurable_digital_out get_controller_temp get_conveyor_tick_count get_coriolis_and_centrifugal_torques
get_digital_in get_freedrive_status get_jacobian get_joint_temp get_joint_torques get_mass_matrix
get_standard_analog_in get_standard_analog_out get_target_joint_accelerations get_target_joint_speeds
get_target_payload get_target_payload_cog get_target_payload_inertia get_target_tcp_speed get_target_waypoint
get_tcp_force get_tool_accelerometer_reading get_tool_analog_in get_tool_current get_tool_digital_in
get_tool_digital_out integer_to_binary_list interpolate_pose inv length log modbus_add_signal modbus_delete_signal
modbus_get_signal_status modbus_send_custom_command modbus_set_output_signal movec optimoveJ optimoveL
path_offset_disable path_offset_enable path_offset_get path_offset_set point_dist pose_dist
pose_sub position_deviation_warning pow powerdown random read_port_bit read_port_register
request_boolean_from_primary_client reset_revolution_counter
rotvec2rpy rpc_factory rpy2rotvec rtde_set_watchdog_action screw_driving set_analog_inputrange
set_analog_outputdomain set_conveyor_tick_count set_flag get_flag set_input_actions_to_default set_runstate_outputs
set_tool_analog_input_domain set_tool_communication set_tool_output_mode
set_baselight set_safety_mode_transition_hardness size
socket_close socket_get_var socket_open socket_read_ascii_float socket_read_string socket_send_string
socket_set_var start_force_mode stop_conveyor_tracking tan to_str tool_contact tool_contact_examples
track_conveyor_circular track_conveyor_linear transpose wrench_trans write_port_bit write_port_register
zero_ftsensor
"""
OTHER_FUNCTIONS = tuple(_OTHER.split())
"""Functions of URScript that the twin does not have, by the vendor's manual, and some that nobody has."""


class Anew:
    """Stands for the two twins that each question builds anew: no question changes it."""


@cache
def spare() -> World:
    """Return a twin for all calls that it refuses, since they change nothing."""
    return World()


# -- URScript


class Call(NamedTuple):
    """How a function is called, and what is seen of its effect."""

    text: str | Callable[[World], None]
    seen: Callable[[World], object] = lambda world: fingerprint(world.controller)
    without: str = "x = 0"
    """The same program without the call."""
    prepare: Callable[[World], None] = lambda world: None
    seconds: float = 0.3


def block(*lines: str) -> str:
    return "\n".join(("def walk():", *lines, "end"))


def joints(pan_rad: float) -> str:
    return str([HOME_RAD[0] + pan_rad, *HOME_RAD[1:]])


def pose(lower_m: float) -> str:
    x, y, z, *turn = World().tool
    return f"p{[x, y, z - lower_m, *turn]}"


def matches(world: World, expected: Any) -> bool:
    """Return whether the last line of the log is this value."""
    try:
        found = ast.literal_eval(world.controller.log[-1])
    except (IndexError, SyntaxError, ValueError):
        return False
    if isinstance(expected, bool):
        return found is expected
    pairs = zip(_flat(found), _flat(expected), strict=True)
    return all(math.isclose(a, b, abs_tol=1e-4) for a, b in pairs)


def _flat(value: Any) -> Sequence[float]:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def returns(
    expression: str, expected: Callable[[World], Any], prepare: Callable[[World], None] = lambda world: None
) -> Call:
    """Call a function that returns a value, and compare the value."""
    return Call(
        f"textmsg({expression})", lambda world: matches(world, expected(world)), 'textmsg("nothing")', prepare
    )


def written(**values: p.Value) -> Callable[[World], None]:
    return lambda world: world.controller.write(values)


def with_tool(world: World) -> None:
    world.controller.tcp = frame_of((0.0, 0.0, 0.1, 0.0, 0.0, 0.0))


def with_output(world: World) -> None:
    world.controller.digital_out = 1 << 3


def limp(world: World) -> bool:
    return world.controller.motion.limp


def stands(world: World) -> bool:
    return max(abs(rad_s) for rad_s in world.controller.plant.velocity_rad_s) < 0.01


def program_runs(world: World) -> bool:
    return world.controller.program is not None


def on_a_path(world: World) -> None:
    """Run ur-rtde's script with a path that tells its progress."""
    lines = b"# inject move path\n  signal_async_progress(5)\n  sleep(5)\n  end\nend\n"
    world.controller.start_program(program_of(SCRIPT.removesuffix(b"end\n") + lines, world.controller))
    world.run(0.1)
    world.controller.write({f"input_int_register_{COMMAND + 1}": 1})
    world.command(c.Command.MOVE_PATH)
    world.run(0.1)


MOVING = "speedj([0.3, 0, 0, 0, 0, 0], 1, 0.1)"
TURN = "speedj([0.2, 0, 0, 0, 0, 0], 1, 0.2)"
RISE = "speedl([0, 0, 0.05, 0, 0, 0], 1, 0.2)"


def calls() -> dict[str, Call]:
    """Return a call of each function that the twin has."""
    moves = {
        "movej": f"movej({joints(0.2)}, a=3, v=2)",
        "movel": f"movel({pose(0.1)}, a=1, v=0.5)",
        "movep": f"movep({pose(0.1)}, a=1, v=0.5)",
        "servoc": f"servoc({pose(0.1)}, a=1, v=0.5)",
        "servoj": f"servoj({joints(0.02)}, t=0.2)",
        "speedj": TURN,
        "speedl": RISE,
    }
    stops = {name: block(MOVING, f"{name}(2)", "sleep(5)") for name in ("stopj", "stopl")}
    frees = {name: block(f"{name}()", "sleep(5)") for name in ("freedrive_mode", "teach_mode")}
    holds = {
        f"end_{name}": Call(block(f"{name}()", f"end_{name}()", "sleep(5)"), limp, frees[name]) for name in frees
    }
    settings = {
        "set_tcp": "p[0, 0, 0.1, 0, 0, 0]",
        "set_payload": "1.5, [0, 0, 0.1]",
        "set_payload_mass": "1.5",
        "set_payload_cog": "[0, 0, 0.1]",
        "set_target_payload": "1.5, [0, 0, 0.1], [1, 1, 1, 0, 0, 0]",
        "set_gravity": "[0, 9.82, 0]",
        "set_standard_digital_out": "2, True",
        "set_configurable_digital_out": "2, True",
        "set_tool_digital_out": "1, True",
        "set_digital_out": "2, True",
        "set_standard_analog_out": "1, 0.5",
        "set_analog_out": "1, 0.5",
        "set_tool_voltage": "24",
        "write_output_integer_register": "3, 7",
        "write_output_float_register": "3, 0.5",
        "write_output_boolean_register": "70, True",
        "textmsg": '"hello"',
        "popup": '"hello"',
    }
    values: dict[str, Call] = {
        "get_standard_digital_out": returns("get_standard_digital_out(3)", lambda world: True, with_output),
        "get_digital_out": returns("get_digital_out(3)", lambda world: True, with_output),
        "get_standard_digital_in": returns("get_standard_digital_in(3)", lambda world: False),
        "read_input_integer_register": returns(
            "read_input_integer_register(5)", lambda world: 7, written(input_int_register_5=7)
        ),
        "read_input_float_register": returns(
            "read_input_float_register(5)", lambda world: 0.5, written(input_double_register_5=0.5)
        ),
        "read_input_boolean_register": returns(
            "read_input_boolean_register(70)", lambda world: True, written(input_bit_register_70=1)
        ),
        "get_actual_joint_positions": returns("get_actual_joint_positions()", lambda world: world.joints),
        "get_target_joint_positions": returns("get_target_joint_positions()", lambda world: HOME_RAD),
        "get_actual_joint_speeds": returns("get_actual_joint_speeds()", lambda world: (0.0,) * 6),
        "get_actual_tcp_pose": returns("get_actual_tcp_pose()", lambda world: world.tool, with_tool),
        "get_target_tcp_pose": returns(
            "get_target_tcp_pose()", lambda world: world.controller.target_tool().pose(), with_tool
        ),
        "get_tcp_offset": returns("get_tcp_offset()", lambda world: (0, 0, 0.1, 0, 0, 0), with_tool),
        "is_steady": returns("is_steady()", lambda world: True),
        "is_within_safety_limits": returns("is_within_safety_limits([9, 0, 0, 0, 0, 0])", lambda world: False),
        "get_steptime": returns("get_steptime()", lambda world: 0.002),
        "get_forward_kin": returns("get_forward_kin()", lambda world: world.tool),
        "get_inverse_kin": returns(f"get_inverse_kin({pose(0.0)})", lambda world: world.joints),
        "pose_trans": returns("pose_trans(p[1,0,0,0,0,0], p[0,2,0,0,0,0])", lambda world: (1, 2, 0, 0, 0, 0)),
        "pose_inv": returns("pose_inv(p[1,2,3,0,0,0])", lambda world: (-1, -2, -3, 0, 0, 0)),
        "pose_add": returns("pose_add(p[1,2,3,0,0,0], p[1,0,0,0,0,0.5])", lambda world: (2, 2, 3, 0, 0, 0.5)),
        "d2r": returns("d2r(90)", lambda world: math.pi / 2),
        "r2d": returns("r2d(1)", lambda world: 180 / math.pi),
        "sin": returns("sin(0.5)", lambda world: math.sin(0.5)),
        "cos": returns("cos(0.5)", lambda world: math.cos(0.5)),
        "sqrt": returns("sqrt(2)", lambda world: math.sqrt(2)),
        "norm": returns("norm([3, 4])", lambda world: 5.0),
    }
    count = block(
        "n = 0", "while True:", "n = n + 1", "write_output_integer_register(0, n)", "{}", "end", "sleep(5)"
    )
    watched = 'rtde_set_watchdog("input_int_register_0", 10, "stop")'
    return {
        **{name: Call(text, lambda world: [round(rad, 4) for rad in world.joints]) for name, text in moves.items()},
        **{name: Call(text, stands, block(MOVING, "sleep(5)"), seconds=0.8) for name, text in stops.items()},
        **{name: Call(text, limp, block("sleep(5)")) for name, text in frees.items()},
        **holds,
        **{name: Call(f"{name}({arguments})") for name, arguments in settings.items()},
        **values,
        "protective_stop": Call("protective_stop()", lambda world: world.controller.safety),
        "sleep": Call("sleep(5)", program_runs),
        "sync": Call(count.format("sync()"), lambda world: world.controller.int_out[0] < 200, count.format("pass")),
        "rtde_set_watchdog": Call(block(watched, "sleep(5)"), program_runs, block("sleep(5)")),
        "signal_async_progress": Call(on_a_path, lambda world: world.controller.int_out[COMMAND + 2] & 0x7FFF),
    }


def ask_function(anew: Anew, name: str, call: Call) -> Answer:
    world = _run(call.text or f"{name}()", call)
    log = list(world.controller.log)
    if any("not available" in line or "error" in line for line in log):
        return Answer(False, log)
    return Answer(True, "" if call.seen(world) == call.seen(_run(call.without, call)) else "an effect")


def _run(text: str | Callable[[World], None], call: Call) -> World:
    world = World() if call.text else spare()
    world.controller.log.clear()
    call.prepare(world)
    if callable(text):
        text(world)
    else:
        world.text(f"{text}\n", call.seconds)
    return world


def known_functions() -> set[str]:
    """Return the names of the functions that the twin carries out."""
    return {name for name, _ in inspect.getmembers(Functions, inspect.isfunction) if not name.startswith("_")}


# -- commands to ur-rtde's control script


class Sent(NamedTuple):
    """A command to the script."""

    doubles: tuple[float, ...] = ()
    prepare: Callable[[World], None] = lambda world: None
    seconds: float = 0.3


def moving(world: World) -> None:
    world.command(c.Command.SPEED_J, 0.3, 0, 0, 0, 0, 0)
    world.run(0.1)


def by_hand(world: World) -> None:
    world.command(c.Command.TEACH_MODE)
    world.run(0.05)
    world.command(c.Command.NONE)


def pressing(world: World) -> None:
    """Turn on force mode along the tool's z."""
    words: dict[str, p.Value] = {f"input_int_register_{COMMAND + 1 + at}": word for at, word in enumerate(Z_ONLY)}
    world.controller.write(words)
    world.command(c.Command.FORCE_MODE, *FORCE)
    world.run(0.1)


Z_ONLY = (2, 0, 0, 1, 0, 0, 0)
"""Type of the force frame, and which of its axes give way."""
FORCE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, *[0.1] * 6)
TOOL = World().tool
LOWER = (*TOOL[:2], TOOL[2] - 0.1, *TOOL[3:])
AHEAD = (HOME_RAD[0] + 0.2, *HOME_RAD[1:])
NEXT = (HOME_RAD[0] + 0.02, *HOME_RAD[1:])


def touched(world: World) -> None:
    """Leave an old answer in the registers, which the answer to the command replaces."""
    world.controller.int_out[COMMAND + 1] = 7


def answered(world: World) -> None:
    """Leave old numbers in the registers of an answer."""
    world.controller.double_out[COMMAND : COMMAND + 6] = [9.0] * 6


def z_only(world: World) -> None:
    words: dict[str, p.Value] = {f"input_int_register_{COMMAND + 1 + at}": word for at, word in enumerate(Z_ONLY)}
    world.controller.write(words)


def all_axes(world: World) -> None:
    world.controller.write({f"input_int_register_{COMMAND + 1 + at}": 1 for at in range(6)})


def path(world: World) -> None:
    """Start the script anew, with a path."""
    lines = f"# inject move path\n  movej({joints(0.2)}, a=3, v=2)\n  end\nend\n".encode()
    world.controller.start_program(program_of(SCRIPT.removesuffix(b"end\n") + lines, world.controller))
    world.run(0.1)


C = c.Command
SENT: dict[int, Sent] = {
    C.MOVE_J: Sent((*AHEAD, 1.0, 2.0)),
    C.MOVE_J_IK: Sent((*LOWER, 1.0, 2.0)),
    C.MOVE_L: Sent((*LOWER, 0.5, 1.0)),
    C.MOVE_L_FK: Sent((*AHEAD, 0.5, 1.0)),
    C.MOVE_PATH: Sent((), path),
    C.SPEED_J: Sent((0.2, 0, 0, 0, 0, 0, 5.0)),
    C.SPEED_L: Sent((0, 0, 0.05, 0, 0, 0)),
    C.SERVO_J: Sent(NEXT),
    C.SERVO_C: Sent((*LOWER, 0.5, 1.0)),
    C.SERVO_L: Sent((*TOOL[:2], TOOL[2] - 0.005, *TOOL[3:])),
    C.JOG_START: Sent((0, 0, 0.05, 0, 0, 0, 0.0)),
    C.TEACH_MODE: Sent(),
    C.FREEDRIVE: Sent((), all_axes),
    C.END_TEACH_MODE: Sent((), by_hand),
    C.END_FREEDRIVE: Sent((), by_hand),
    **dict.fromkeys((C.SERVO_STOP, C.SPEED_STOP, C.STOP_J, C.STOP_L, C.JOG_STOP), Sent((2.0,), moving)),
    C.PROTECTIVE_STOP: Sent(),
    C.STOP_SCRIPT: Sent(),
    C.SET_WATCHDOG: Sent((10.0,)),
    C.FORCE_MODE: Sent(FORCE, z_only),
    C.END_FORCE_MODE: Sent((), pressing),
    C.FORCE_MODE_DAMPING: Sent((0.3,)),
    C.FORCE_MODE_GAIN: Sent((0.3,)),
    C.TOOL_CONTACT: Sent((0, 0, 1.0, 0, 0, 0), touched),
    C.READ_CONTACT_DETECTION: Sent((), touched),
    C.STOP_CONTACT_DETECTION: Sent((), touched),
    C.START_CONTACT_DETECTION: Sent((0, 0, 1.0, 0, 0, 0)),
    C.MOVE_UNTIL_CONTACT: Sent((0, 0, 0.1, 0, 0, 0)),
    C.ZERO_FT_SENSOR: Sent(),
    C.GET_FREEDRIVE_STATUS: Sent((), touched),
    C.SET_PAYLOAD: Sent((1.5, 0, 0, 0.1)),
    C.SET_TARGET_PAYLOAD: Sent((1.5, 0, 0, 0.1, 1, 1, 1, 0, 0, 0)),
    C.SET_TCP: Sent((0, 0, 0.1, 0, 0, 0)),
    C.SET_GRAVITY: Sent((0, 9.82, 0)),
    C.GET_TCP_OFFSET: Sent((), with_tool),
    C.GET_FLANGE_POSE: Sent(),
    C.GET_JOINT_TORQUES: Sent((), answered),
    C.IS_STEADY: Sent(),
    C.GET_STEP_TIME: Sent(),
    C.POSE_TRANS: Sent((1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0)),
    C.GET_FORWARD_KINEMATICS: Sent(),
    C.GET_FORWARD_KINEMATICS_OF: Sent((*HOME_RAD, 0, 0, 0.1, 0, 0, 0)),
    C.GET_INVERSE_KINEMATICS: Sent(LOWER),
    C.GET_INVERSE_KINEMATICS_NEAR: Sent((*LOWER, *HOME_RAD)),
    C.HAS_INVERSE_KINEMATICS: Sent(LOWER),
    C.HAS_INVERSE_KINEMATICS_NEAR: Sent((*LOWER, *HOME_RAD)),
    C.IS_POSE_WITHIN_LIMITS: Sent(LOWER),
    C.ARE_JOINTS_WITHIN_LIMITS: Sent(HOME_RAD),
    C.NONE: Sent(),
    C.KICK_WATCHDOG: Sent(),
}
WITHOUT_EFFECT = frozenset(
    (
        C.NONE,
        C.KICK_WATCHDOG,  # Both feed the watchdog: tests/drivers/ur/test_twin.py.
        C.ZERO_FT_SENSOR,  # The sensor shows zero already.
        C.START_CONTACT_DETECTION,  # Only READ_CONTACT_DETECTION has an answer.
    )
)


def ask_command(anew: Anew, number: int, sent: Sent) -> Answer:
    world = _commanded(sent, number)
    ended = world.controller.program is None and number not in (C.STOP_SCRIPT, C.PROTECTIVE_STOP, C.SET_WATCHDOG)
    log = list(world.controller.log)
    if ended or any("not available" in line or "error" in line for line in log):
        return Answer(False, log)
    other = _commanded(sent, c.Command.NONE)
    return Answer(True, "" if _shown(world) == _shown(other) else "an effect")


def _commanded(sent: Sent, number: int) -> World:
    world = World() if number in COMMANDS else spare()
    world.controller.log.clear()
    world.start()
    sent.prepare(world)
    world.command(number, *sent.doubles)
    world.run(sent.seconds)
    return world


def _shown(world: World) -> object:
    """Return what a client sees of a controller, and what decides its next motions, but not the inputs."""
    robot, program = world.controller, world.controller.program
    script = {name: getattr(program, name, None) for name in ("_force", "_damping", "_gain", "_stops_s")}
    outputs = robot.int_out[:COMMAND] + robot.int_out[COMMAND + 1 :], robot.double_out
    state = robot.safety, program is None, type(robot.motion).__name__, robot.payload_kg, robot.payload_cog_m
    more = robot.payload_inertia, robot.gravity_m_s2, robot.tcp, list(robot._watched), list(robot.log)
    return fingerprint((script, outputs, state, more, [round(rad, 4) for rad in world.joints]))


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    yield Walk(
        "urscript",
        FUNCTIONS,
        (*FUNCTIONS.effects, *OTHER_FUNCTIONS),
        Anew,
        ask_function,
        calls(),
        (Call("", seconds=0.1),),
    )
    yield Walk(
        "ur-rtde's commands",
        COMMANDS,
        range(256),
        Anew,
        ask_command,
        SENT,
        (Sent((0.1,) * 18, seconds=0.02),),
        without=WITHOUT_EFFECT,
    )
