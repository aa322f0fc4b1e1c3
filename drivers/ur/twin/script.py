"""Programs on the controller. URScript is not interpreted: the control script of ur-rtde is
recognised and its handshake played; ``stopj`` is done; anything else runs, and moves nothing."""

from __future__ import annotations

import re
from collections.abc import Callable

from strands_actors.drivers.ur import protocol as p

from . import commands as c
from .controller import Controller, Program
from .motion import MoveTo, Servo, Speed

_OFFSET = re.compile(rb"reg_offset_int = # int register offset\s*(\d+)")
_CONTROL = b"def rtde_control()"


def program_of(text: bytes, controller: Controller) -> Callable[[], Program]:
    """What a text sent to a script port makes the controller do."""
    if c.classify_script(text) == "safe":
        return lambda: Halting(controller)
    if _CONTROL in text:
        found = _OFFSET.search(text)
        offset = int(found.group(1)) if found else 0
        return lambda: ControlScript(controller, offset)
    return lambda: Foreign()


class Foreign:
    """A program this twin does not understand."""

    def heard(self) -> None:
        pass

    def step(self) -> None:
        pass


class Halting:
    """``stopj``: ends when the arm stands."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        controller.halt()

    def heard(self) -> None:
        pass

    def step(self) -> None:
        if self._controller.is_steady():
            self._controller.stop_program()


class ControlScript:
    """Reads its command in the first integer register of its range, answers in the first output
    register: READY, then for a command that takes its time DONE until the command is taken away."""

    def __init__(self, controller: Controller, offset: int) -> None:
        self._controller = controller
        self._offset = offset
        self._busy_with = c.Command.NONE.value
        self._move: MoveTo | None = None
        self._stands_s: float | None = None  # when a stop is over
        controller.int_in[offset] = c.Command.NONE
        self._answer(c.READY)

    def step(self) -> None:
        if self._move is not None and self._move.arrived(self._controller.plant):
            self._move = None
            self._answer(c.DONE)
        if self._stands_s is not None and self._controller.now_s() >= self._stands_s:
            self._stands_s = None
            self._answer(c.DONE)

    def heard(self) -> None:
        number = self._controller.int_in[self._offset]
        if number in c.AT_ONCE:
            self._do(number)
            self._answer(c.READY)
        elif number in (c.Command.NONE, c.Command.KICK_WATCHDOG):
            self._busy_with = c.Command.NONE
            if not self._executing:
                self._answer(c.READY)
        elif number != self._busy_with:
            self._busy_with = number
            self._do(number)
            if not self._executing:
                self._answer(c.DONE)

    @property
    def _executing(self) -> bool:
        return self._move is not None or self._stands_s is not None

    def _do(self, number: int) -> None:
        controller, value = self._controller, self._double
        match number:
            case c.Command.SERVO_J:
                controller.move(Servo(self._six()))
            case c.Command.SPEED_J:
                controller.move(Speed(self._six()))
            case c.Command.MOVE_J:
                move = MoveTo(self._six(), value(6))
                controller.move(move)
                self._move = None if self._int(1) else move  # asynchronous: done at once
            case c.Command.SERVO_STOP | c.Command.SPEED_STOP | c.Command.STOP_J | c.Command.STOP_L:
                self._move = None
                self._stands_s = controller.now_s() + controller.halt()
            case c.Command.SET_PAYLOAD:
                controller.payload_kg = value(0)
            case c.Command.GET_STEP_TIME:
                self._out(0, 0.002)
            case c.Command.SET_WATCHDOG:
                controller.watch(self._offset, value(0))
            case c.Command.IS_POSE_WITHIN_LIMITS | c.Command.ARE_JOINTS_WITHIN_LIMITS:
                controller.int_out[self._offset + 1] = 1
            case c.Command.GET_JOINT_TORQUES:
                for joint, nm in enumerate(controller.plant.effort_nm):
                    self._out(joint, nm)
            case c.Command.IS_STEADY:
                controller.int_out[self._offset + 1] = int(controller.is_steady())
            case c.Command.PROTECTIVE_STOP:
                controller.set_safety(p.SafetyMode.PROTECTIVE_STOP)
            case c.Command.STOP_SCRIPT:
                controller.stop_program()

    def _answer(self, word: int) -> None:
        self._controller.int_out[self._offset] = word

    def _out(self, at: int, value: float) -> None:
        self._controller.double_out[self._offset + at] = value

    def _int(self, at: int) -> int:
        return self._controller.int_in[self._offset + at]

    def _double(self, at: int) -> float:
        return self._controller.double_in[self._offset + at]

    def _six(self) -> list[float]:
        return self._controller.double_in[self._offset : self._offset + 6]
