"""Imitate the control script that ur-rtde uploads. Its text is not run: commands are carried out in Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from . import commands as c
from .controller import Controller
from .force import MOST_DAMPING, MOST_GAIN, SCRIPT_DAMPING, SCRIPT_GAIN, UNTURNED, ForceMode
from .functions import ScriptError
from .motion import Free, Hold, Speed, ToolSpeed, Unreachable
from .pose import Frame, frame_of
from .requests import COMMANDS
from .urscript import Script, Statement

RUNNING_BIT, COUNT_BITS, OPERATION_BITS = 1 << 15, 16, 24
"""Bits of the register that reports the progress of an asynchronous move. The lowest 15 bits are the progress."""

PROTECTIVE_STOP_S = 0.01
"""Time from a client's request for a protective stop until the stop. In this time the script still answers that the
request is done [assumed]."""


class ControlScript:
    """The imitated control script.

    It reads a command from the first integer register of its range, and answers READY in the first output register.
    For a command that takes time it later answers DONE, until the client removes the command. As on a real
    controller, a command that it cannot carry out ends it, with an error in the controller's log.
    """

    def __init__(self, controller: Controller, offset: int, path: Sequence[Statement] = ()) -> None:
        """Start the script. ``offset`` is its first register. ``path`` has the moves from the uploaded text."""
        self._controller = controller
        self._offset = offset
        self._path = path
        self._busy_with = c.Command.NONE.value
        self._over: Callable[[], bool] | None = None  # Returns True once the present command is done.
        self._aside: Callable[[], bool] | None = None  # Returns True once the present asynchronous move is done.
        self._operation = self._written = 0
        self._stops_s: float | None = None  # Time at which a requested protective stop takes effect.
        self._force: ForceMode | None = None
        self._damping, self._gain = SCRIPT_DAMPING, SCRIPT_GAIN
        controller.int_in[offset] = c.Command.NONE
        self._answer(c.READY)

    def step(self) -> None:
        if self._stops_s is not None and self._controller.now_s() >= self._stops_s:
            self._controller.protect("the program asked for it")
            return
        try:
            if self._over is not None and self._over():
                self._over = None
                self._answer(c.DONE)
            if self._aside is not None and self._aside():
                self._aside = None
                self._tell_progress(-1)
            # A stop ends a motion, but not force mode: its thread goes on.
            if self._force is not None and self._over is None and isinstance(self._controller.motion, Hold):
                self._comply(self._force)
        except Unreachable as unreachable:
            self._controller.protect(str(unreachable))
        except ScriptError as error:
            self._controller.fail(str(error))

    def react_to_inputs(self) -> None:
        number = self._controller.int_in[self._offset]
        if number in c.AT_ONCE:
            self._do(number)
            if self._controller.program is self:
                self._answer(c.READY)
        elif number in (c.Command.NONE, c.Command.KICK_WATCHDOG):
            self._busy_with = c.Command.NONE
            if self._over is None:
                self._answer(c.READY)
        elif number != self._busy_with:
            self._busy_with = number
            self._do(number)
            if self._over is None and self._controller.program is self:
                self._answer(c.DONE)

    def _do(self, number: int) -> None:
        if number not in COMMANDS:
            function = c.REFUSED.get(number, f"the command {number}")
            self._controller.fail(f"{function} is not available on this controller")
            return
        act = _ACTS.get(number)
        try:
            if self._force is not None and number in c.MOTION - c.FORCED:
                raise ScriptError("a motion on top of force_mode is not available on this controller")
            if act is not None:
                act(self)
        except ScriptError as error:
            self._controller.fail(str(error))
        except Unreachable as unreachable:
            if number in c.MOTION:
                self._controller.protect(str(unreachable))
            else:
                self._controller.fail(str(unreachable))

    # -- commands that move or stop the arm

    def _move_j(self) -> None:
        goal = self._six()
        self._begin(lambda: self._controller.move_joints(goal, self._double(6), self._double(7)).arrived)

    def _move_j_ik(self) -> None:
        goal = self._controller.solved(self._frame(), self._controller.plant.position_rad)
        self._begin(lambda: self._controller.move_joints(goal, self._double(6), self._double(7)).arrived)

    def _move_l(self) -> None:
        goal = self._frame()
        self._begin(lambda: self._controller.move_tool(goal, self._double(6), self._double(7)).arrived)

    def _servo_c(self) -> None:
        # It has no flag for a move aside.
        motion = self._controller.move_tool(self._frame(), self._double(6), self._double(7))
        plant = self._controller.plant
        self._over, self._aside = (lambda: motion.arrived(plant)), None

    def _move_l_fk(self) -> None:
        joints = self._six()
        self._controller.check_joints(joints)
        goal = self._controller.kinematics.flange(joints).then(self._controller.tcp)
        self._begin(lambda: self._controller.move_tool(goal, self._double(6), self._double(7)).arrived)

    def _move_path(self) -> None:
        script = Script(self._controller, self._path, self._tell_progress)
        self._begin(lambda: lambda plant: script.advance())

    def _begin(self, move: Callable[[], Callable[..., bool]]) -> None:
        arrived, plant = move(), self._controller.plant
        if not self._int(1):
            self._over, self._aside = (lambda: arrived(plant)), None
            return
        self._over, self._aside = None, (lambda: arrived(plant))
        self._tell_progress(0)

    def _speed_j(self) -> None:
        controller = self._controller
        controller.move(Speed(self._six(), self._double(6), controller.motion))

    def _speed_l(self) -> None:
        controller = self._controller
        controller.move(ToolSpeed(controller.target_tool(), controller.follow, self._six()))

    def _servo_j(self) -> None:
        goal = self._six()
        self._controller.check_joints(goal)
        self._controller.servo(goal, self._double(9))

    def _servo_l(self) -> None:
        controller = self._controller
        goal = controller.solved(self._frame(), controller.motion.target(controller.plant))
        controller.servo(goal, self._double(9))

    def _jog(self) -> None:
        controller, feature = self._controller, round(self._double(6))
        velocity: Sequence[float] = self._six()
        if feature == 2:  # The velocity is in a frame that the client has given.
            axes = self._frame(8)
            vx, vy, vz, wx, wy, wz = velocity
            velocity = (*axes.turned((vx, vy, vz)), *axes.turned((wx, wy, wz)))
        controller.move(ToolSpeed(controller.target_tool(), controller.follow, velocity, own_axes=feature == 1))

    def _halt(self) -> None:
        controller = self._controller
        stands_s = controller.now_s() + controller.halt()
        if self._aside is not None:
            self._aside = None
            self._tell_progress(-1)
        self._over = lambda: controller.now_s() >= stands_s

    def _protect(self) -> None:
        self._stops_s = self._controller.now_s() + PROTECTIVE_STOP_S

    def _free(self) -> None:
        self._controller.move(Free())

    def _freedrive(self) -> None:
        if not all(self._int(index) for index in range(1, 7)):
            raise ScriptError("freedrive_mode along some axes only is not available on this controller")
        self._free()

    def _end_free(self) -> None:
        if self._controller.motion.limp:
            self._controller.halt()

    # -- force mode and contact

    def _force_mode(self) -> None:
        if self._int(1) != UNTURNED:
            raise ScriptError(f"force_mode of type {self._int(1)} is not available on this controller")
        compliant = [self._int(index) for index in range(2, 8)]
        force = ForceMode(self._frame(), compliant, self._six(6), self._six(12))
        if force != self._force:  # A client repeats the command in each cycle.
            self._force = force
            self._comply(force)

    def _comply(self, force: ForceMode) -> None:
        controller, velocity = self._controller, force.velocity(self._damping, self._gain)
        controller.move(ToolSpeed(controller.target_tool(), controller.follow, velocity))

    def _end_force_mode(self) -> None:
        self._force = None
        self._halt()

    def _set_damping(self) -> None:
        self._damping = min(max(0.0, self._double(0)), MOST_DAMPING)

    def _set_gain(self) -> None:
        self._gain = min(max(0.0, self._double(0)), MOST_GAIN)

    def _no_contact(self) -> None:
        """Answer that the tool touches nothing: no time steps since a contact."""
        self._controller.int_out[self._offset + 1] = 0

    def _move_until_contact(self) -> None:
        """Move the tool until it touches something. Nothing touches it, so the motion ends at the end of the arm's
        reach, with a protective stop."""
        self._speed_l()
        self._over = lambda: False

    # -- commands that compute kinematics

    def _has_solution(self, near: Sequence[float]) -> None:
        self._say(self._controller.joints_for(self._frame(), near) is not None)

    def _forward(self) -> None:
        self._out(self._controller.target_tool().pose())

    def _forward_of(self) -> None:
        self._out(self._controller.kinematics.flange(self._six()).then(self._frame(6)).pose())

    def _inverse(self) -> None:
        self._out(self._controller.solved(self._frame(), self._controller.plant.position_rad))

    def _inverse_near(self) -> None:
        self._out(self._controller.solved(self._frame(), self._six(6)))

    # -- commands that set tool, payload and gravity

    def _payload(self) -> None:
        self._controller.payload_kg = self._double(0)
        if any(self._six(1)[:3]):  # If the given centre of gravity is zero, the script keeps the present one.
            self._controller.payload_cog_m = tuple(self._six(1)[:3])

    def _target_payload(self) -> None:
        self._payload()
        self._controller.payload_inertia = tuple(self._six(4))

    def _set_tcp(self) -> None:
        self._controller.tcp = self._frame()

    def _set_gravity(self) -> None:
        self._controller.gravity_m_s2 = tuple(self._six()[:3])

    # -- reading and writing of registers

    def _answer(self, word: int) -> None:
        self._controller.int_out[self._offset] = word

    def _say(self, yes: bool) -> None:
        self._controller.int_out[self._offset + 1] = int(yes)

    def _tell_progress(self, value: int) -> None:
        """Report the progress of an asynchronous move: 0 at its beginning, -1 at its end."""
        self._written = (self._written + 1) % 128
        self._operation = (self._operation + (value == 0)) % 128
        register = self._written << COUNT_BITS | self._operation << OPERATION_BITS
        self._controller.int_out[self._offset + 2] = register | (value | RUNNING_BIT if value >= 0 else 0)

    def _out(self, values: Sequence[float]) -> None:
        self._controller.double_out[self._offset : self._offset + len(values)] = values

    def _int(self, index: int) -> int:
        return self._controller.int_in[self._offset + index]

    def _double(self, index: int) -> float:
        return self._controller.double_in[self._offset + index]

    def _six(self, index: int = 0) -> list[float]:
        return self._controller.double_in[self._offset + index : self._offset + index + 6]

    def _frame(self, index: int = 0) -> Frame:
        return frame_of(self._six(index))


_ACTS: dict[int, Callable[[ControlScript], None]] = {
    c.Command.MOVE_J: ControlScript._move_j,
    c.Command.MOVE_J_IK: ControlScript._move_j_ik,
    c.Command.MOVE_L: ControlScript._move_l,
    c.Command.MOVE_L_FK: ControlScript._move_l_fk,
    c.Command.MOVE_PATH: ControlScript._move_path,
    c.Command.SPEED_J: ControlScript._speed_j,
    c.Command.SPEED_L: ControlScript._speed_l,
    c.Command.FORCE_MODE: ControlScript._force_mode,
    c.Command.END_FORCE_MODE: ControlScript._end_force_mode,
    c.Command.FORCE_MODE_DAMPING: ControlScript._set_damping,
    c.Command.FORCE_MODE_GAIN: ControlScript._set_gain,
    c.Command.TOOL_CONTACT: ControlScript._no_contact,
    c.Command.STOP_CONTACT_DETECTION: ControlScript._no_contact,
    c.Command.READ_CONTACT_DETECTION: ControlScript._no_contact,
    c.Command.MOVE_UNTIL_CONTACT: ControlScript._move_until_contact,
    c.Command.SERVO_J: ControlScript._servo_j,
    c.Command.SERVO_C: ControlScript._servo_c,
    c.Command.SERVO_L: ControlScript._servo_l,
    c.Command.JOG_START: ControlScript._jog,
    c.Command.TEACH_MODE: ControlScript._free,
    c.Command.FREEDRIVE: ControlScript._freedrive,
    c.Command.END_TEACH_MODE: ControlScript._end_free,
    c.Command.END_FREEDRIVE: ControlScript._end_free,
    c.Command.GET_FREEDRIVE_STATUS: lambda script: script._say(False),  # 0 means that no singularity is near.
    **dict.fromkeys(
        (c.Command.SERVO_STOP, c.Command.SPEED_STOP, c.Command.STOP_J, c.Command.STOP_L, c.Command.JOG_STOP),
        ControlScript._halt,
    ),
    c.Command.SET_PAYLOAD: ControlScript._payload,
    c.Command.SET_TARGET_PAYLOAD: ControlScript._target_payload,
    c.Command.SET_TCP: ControlScript._set_tcp,
    c.Command.SET_GRAVITY: ControlScript._set_gravity,
    c.Command.GET_TCP_OFFSET: lambda script: script._out(script._controller.tcp.pose()),
    c.Command.GET_FLANGE_POSE: lambda script: script._out(
        script._controller.kinematics.flange(script._controller.plant.position_rad).pose()
    ),
    c.Command.POSE_TRANS: lambda script: script._out(script._frame().then(script._frame(6)).pose()),
    c.Command.GET_FORWARD_KINEMATICS: ControlScript._forward,
    c.Command.GET_FORWARD_KINEMATICS_OF: ControlScript._forward_of,
    c.Command.GET_INVERSE_KINEMATICS: ControlScript._inverse,
    c.Command.GET_INVERSE_KINEMATICS_NEAR: ControlScript._inverse_near,
    c.Command.HAS_INVERSE_KINEMATICS: lambda script: script._has_solution(script._controller.plant.position_rad),
    c.Command.HAS_INVERSE_KINEMATICS_NEAR: lambda script: script._has_solution(script._six(6)),
    c.Command.IS_POSE_WITHIN_LIMITS: lambda script: script._has_solution(script._controller.plant.position_rad),
    c.Command.ARE_JOINTS_WITHIN_LIMITS: lambda script: script._say(
        script._controller.kinematics.within(script._six())
    ),
    c.Command.GET_STEP_TIME: lambda script: script._out((0.002,)),
    c.Command.GET_JOINT_TORQUES: lambda script: script._out(script._controller.plant.effort_nm),
    c.Command.IS_STEADY: lambda script: script._say(script._controller.is_steady()),
    c.Command.SET_WATCHDOG: lambda script: script._controller.watch(script._offset, script._double(0)),
    c.Command.PROTECTIVE_STOP: ControlScript._protect,
    c.Command.STOP_SCRIPT: lambda script: script._controller.stop_program(),
}
