"""The URScript functions that a program on the simulated controller may call, with their URScript names."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from . import commands as c
from .controller import TICK_HZ, Controller
from .motion import Free, Speed, ToolSpeed, Unreachable
from .pose import Frame, frame_of


class ScriptError(Exception):
    """Raised if a program cannot be compiled or run. The text is the reason."""


class Pose(tuple[float, ...]):
    """A pose in URScript, ``p[...]``: x, y, z in m, then a rotation vector in rad."""

    def __new__(cls, values: Any) -> Pose:
        pose = super().__new__(cls, (_number(value) for value in values))
        if len(pose) != 6:
            raise ScriptError("a pose has six numbers")
        return pose


class Waits:
    """The result of a function that takes time. It is called until it returns True, and then the program goes
    on."""

    def __init__(self, over: Callable[[], bool]) -> None:
        self._over = over

    def __call__(self) -> bool:
        return self._over()


class Functions:
    """The URScript functions. Each method without a leading underscore is one of them."""

    def __init__(self, controller: Controller, on_progress: Callable[[int], None] | None = None) -> None:
        """Bind the functions to a controller. ``on_progress`` gets the progress of a path of ur-rtde's script."""
        self._robot = controller
        self._on_progress = on_progress

    # -- functions that move or stop the arm

    def movej(self, q: Any, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Waits:
        return self._arrives(self._robot.move_joints(self._joints(q), v, a, t))

    def movel(self, pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Waits:
        return self._arrives(self._robot.move_tool(self._frame(pose), v, a, t))

    def movep(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Waits:
        return self.movel(pose, a, v)

    def servoc(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Waits:
        return self.movel(pose, a, v)

    def servoj(
        self, q: Any, a: float = 0, v: float = 0, t: float = 0.002, lookahead_time: float = 0.1, gain: float = 300
    ) -> Waits:
        joints = self._joints(q)
        self._robot.check_joints(joints)
        self._robot.servo(joints, lookahead_time)
        return self.sleep(t)

    def speedj(self, qd: Any, a: float = 1.4, t: float = 0.0) -> Waits:
        self._robot.move(Speed(_six(qd), _number(a), self._robot.motion))
        return self.sleep(t)

    def speedl(self, xd: Any, a: float = 1.2, t: float = 0.0, aRot: float = 0.0) -> Waits:
        robot = self._robot
        robot.move(ToolSpeed(robot.target_tool(), robot.follow, _six(xd)))
        return self.sleep(t)

    def stopj(self, a: float = 2.0) -> Waits:
        self._robot.halt_by_program()
        return Waits(self._robot.is_steady)

    def stopl(self, a: float = 2.0, aRot: float = 0.0) -> Waits:
        return self.stopj()

    def freedrive_mode(self, freeAxes: Any = (), feature: Any = "base") -> None:
        if freeAxes and not all(_six(freeAxes)):
            raise ScriptError("freedrive_mode along some axes only is not available on this controller")
        self._robot.move(Free())

    def end_freedrive_mode(self) -> None:
        if self._robot.motion.limp:
            self._robot.halt()

    teach_mode, end_teach_mode = freedrive_mode, end_freedrive_mode

    def protective_stop(self) -> None:
        raise Unreachable("the program asked for it")

    # -- functions that wait

    def sleep(self, t: float) -> Waits:
        # The controller waits for a whole number of ticks, so end half a tick early.
        until_s = self._robot.now_s() + _number(t) - 0.5 / TICK_HZ
        return Waits(lambda: self._robot.now_s() >= until_s)

    def sync(self) -> Waits:
        return Waits(lambda: True)

    # -- functions that set tool, payload and gravity

    def set_tcp(self, pose: Any, tcp_name: str = "") -> None:
        self._robot.tcp = frame_of(_six(pose))

    def set_payload(self, m: float, cog: Any = ()) -> None:
        self._robot.payload_kg = _number(m)
        if cog:
            self._robot.payload_cog_m = _vector(cog)

    def set_payload_mass(self, m: float) -> None:
        self._robot.payload_kg = _number(m)

    def set_payload_cog(self, cog: Any) -> None:
        self._robot.payload_cog_m = _vector(cog)

    def set_target_payload(self, m: float, cog: Any, inertia: Any = (0.0,) * 6, transition_time: float = 0) -> None:
        self._robot.payload_inertia = tuple(_six(inertia))
        self.set_payload(m, cog)

    def set_gravity(self, d: Any) -> None:
        self._robot.gravity_m_s2 = _vector(d)

    # -- digital and analog inputs and outputs, and registers

    def set_standard_digital_out(self, n: int, b: bool) -> None:
        self._set_bit(n, 8, 0, b)

    def set_configurable_digital_out(self, n: int, b: bool) -> None:
        self._set_bit(n, 8, 8, b)

    def set_tool_digital_out(self, n: int, b: bool) -> None:
        self._set_bit(n, 2, 16, b)

    def set_digital_out(self, n: int, b: bool) -> None:
        self._set_bit(n, 18, 0, b)

    def get_standard_digital_out(self, n: int) -> bool:
        return bool(self._robot.digital_out >> _index(n, 8) & 1)

    def get_digital_out(self, n: int) -> bool:
        return bool(self._robot.digital_out >> _index(n, 18) & 1)

    def get_standard_digital_in(self, n: int) -> bool:
        return _index(n, 8) < 0  # Always False, because nothing is connected to the inputs.

    def set_standard_analog_out(self, n: int, f: float) -> None:
        self._robot.analog_out[_index(n, 2)] = _number(f)

    set_analog_out = set_standard_analog_out

    def set_tool_voltage(self, voltage: int) -> None:
        if voltage not in (0, 12, 24):
            raise ScriptError("a tool gets 0, 12 or 24 V")
        self._robot.tool_voltage = int(voltage)

    def read_input_integer_register(self, address: int) -> int:
        return self._robot.int_in[_index(address, c.REGISTERS)]

    def read_input_float_register(self, address: int) -> float:
        return self._robot.double_in[_index(address, c.REGISTERS)]

    def read_input_boolean_register(self, address: int) -> bool:
        return bool(self._robot.bits_in >> _index(address, c.SINGLE_BITS.stop) & 1)

    def write_output_integer_register(self, address: int, value: int) -> None:
        self._robot.int_out[_index(address, c.REGISTERS)] = int(_number(value))

    def write_output_float_register(self, address: int, value: float) -> None:
        self._robot.double_out[_index(address, c.REGISTERS)] = _number(value)

    def write_output_boolean_register(self, address: int, value: bool) -> None:
        bit = 1 << _index(address, c.SINGLE_BITS.stop)
        self._robot.bits_out = self._robot.bits_out | bit if value else self._robot.bits_out & ~bit

    def rtde_set_watchdog(self, variable_name: str, min_frequency: float, action: str = "pause") -> None:
        stem, _, number = str(variable_name).rpartition("_")
        if stem != "input_int_register" or action.lower() != "stop":
            raise ScriptError("a watchdog is for an input_int_register and its action is stop, on this controller")
        self._robot.watch(_index(int(number), c.REGISTERS), _number(min_frequency))

    # -- functions that write messages

    def textmsg(self, s1: Any, s2: Any = "") -> None:
        self._robot.log.append(f"{s1}{s2}")

    def popup(
        self, s: Any, title: str = "", warning: bool = False, error: bool = False, blocking: bool = False
    ) -> None:
        if blocking:
            raise ScriptError("a blocking popup is not available on this controller: nobody closes it")
        self._robot.log.append(f"popup: {s}")

    def signal_async_progress(self, progress: int) -> None:
        """Report the progress of a path. Only ur-rtde's control script defines this function."""
        if self._on_progress is None:
            raise ScriptError("signal_async_progress is not available on this controller")
        self._on_progress(int(_number(progress)))

    # -- functions that return the state of the arm

    def get_actual_joint_positions(self) -> list[float]:
        return list(self._robot.plant.position_rad)

    def get_target_joint_positions(self) -> list[float]:
        return list(self._robot.motion.target(self._robot.plant))

    def get_actual_joint_speeds(self) -> list[float]:
        return list(self._robot.plant.velocity_rad_s)

    def get_actual_tcp_pose(self) -> Pose:
        return Pose(self._robot.tool().pose())

    def get_target_tcp_pose(self) -> Pose:
        return Pose(self._robot.target_tool().pose())

    def get_tcp_offset(self) -> Pose:
        return Pose(self._robot.tcp.pose())

    def get_forward_kin(self, q: Any = (), tcp: Any = ()) -> Pose:
        robot = self._robot
        joints = _six(q) if q else robot.motion.target(robot.plant)
        return Pose(robot.kinematics.flange(joints).then(frame_of(_six(tcp)) if tcp else robot.tcp).pose())

    def get_inverse_kin(self, x: Any, qnear: Any = ()) -> list[float]:
        near = _six(qnear) if qnear else self._robot.plant.position_rad
        try:
            return list(self._robot.solved(frame_of(_six(x)), near))
        except Unreachable as unreachable:
            raise ScriptError(f"get_inverse_kin: {unreachable}") from None

    def is_steady(self) -> bool:
        return self._robot.is_steady()

    def is_within_safety_limits(self, x: Any) -> bool:
        if isinstance(x, Pose):
            return self._robot.joints_for(frame_of(x), self._robot.plant.position_rad) is not None
        return self._robot.kinematics.within(_six(x))

    def get_steptime(self) -> float:
        return 0.002

    # -- functions that compute

    def pose_trans(self, p_from: Any, p_from_to: Any) -> Pose:
        return Pose(frame_of(_six(p_from)).then(frame_of(_six(p_from_to))).pose())

    def pose_inv(self, p_from: Any) -> Pose:
        return Pose(frame_of(_six(p_from)).inverse().pose())

    def pose_add(self, p_1: Any, p_2: Any) -> Pose:
        first, second = frame_of(_six(p_1)), frame_of(_six(p_2))
        turned = first.then(second)
        place = tuple(a + b for a, b in zip(first.place, second.place, strict=True))
        return Pose((*place, *turned.pose()[3:]))

    def d2r(self, d: float) -> float:
        return math.radians(_number(d))

    def r2d(self, r: float) -> float:
        return math.degrees(_number(r))

    def sin(self, f: float) -> float:
        return math.sin(_number(f))

    def cos(self, f: float) -> float:
        return math.cos(_number(f))

    def sqrt(self, f: float) -> float:
        return math.sqrt(_number(f))

    def norm(self, a: Any) -> float:
        return math.sqrt(sum(_number(part) ** 2 for part in a)) if isinstance(a, list | tuple) else abs(_number(a))

    # -- helper methods of the functions above

    def _arrives(self, trip: Any) -> Waits:
        return Waits(lambda: trip.arrived(self._robot.plant))

    def _joints(self, goal: Any) -> Sequence[float]:
        if not isinstance(goal, Pose):
            return _six(goal)
        return self._robot.solved(frame_of(goal), self._robot.plant.position_rad)

    def _frame(self, goal: Any) -> Frame:
        if isinstance(goal, Pose):
            return frame_of(goal)
        joints = _six(goal)
        self._robot.check_joints(joints)
        return self._robot.kinematics.flange(joints).then(self._robot.tcp)

    def _set_bit(self, n: int, of: int, shift: int, on: bool) -> None:
        bit = 1 << _index(n, of) + shift
        self._robot.digital_out = self._robot.digital_out | bit if on else self._robot.digital_out & ~bit


def _number(value: Any) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ScriptError(f"{value!r} is no number")
    return value


def _six(values: Any) -> list[float]:
    if not isinstance(values, list | tuple) or len(values) != 6:
        raise ScriptError("six numbers are needed")
    return [float(_number(value)) for value in values]


def _vector(values: Any) -> tuple[float, ...]:
    if not isinstance(values, list | tuple) or len(values) != 3:
        raise ScriptError("three numbers are needed")
    return tuple(float(_number(value)) for value in values)


def _index(number: Any, of: int) -> int:
    if not isinstance(number, int) or not 0 <= number < of:
        raise ScriptError(f"{number!r} is not one of 0 to {of - 1}")
    return number
