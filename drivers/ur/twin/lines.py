"""The twin's ports of text: the dashboard, and those that take programs."""

from __future__ import annotations

import re

from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.ur import protocol as p

from . import commands as c
from .controller import Controller
from .script import program_of

BANNER = "Connected: Universal Robots Dashboard Server"
POLYSCOPE = "URSoftware 5.13.1.0 (Nov 21 2023)"

_END_OF_PROGRAM = re.compile(rb"^end[ \t\r]*\n", re.MULTILINE)


class Dashboard:
    def __init__(self, controller: Controller, robot: str) -> None:
        self._controller = controller
        # the arm's model as the dashboard has it: without the series' letter [assumed]
        self._model = robot.upper().removesuffix("E")

    async def handle(self, connection: Connection) -> None:
        connection.say("read", _line(BANNER))
        pending = b""
        while True:
            t_ns, data = await connection.receive()
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                text = line.decode("utf-8", "replace").strip()
                connection.heard(t_ns, c.classify_dashboard(text), line + b"\n")
                connection.say("read", _line(self.answer(text)))

    def answer(self, line: str) -> str:
        """Do what a line says."""
        controller = self._controller
        match line.lower():
            case "polyscopeversion":
                return POLYSCOPE
            case "get serial number":
                return controller.serial
            case "get robot model":
                return self._model
            case "is in remote control":
                return str(controller.remote).lower()
            case "robotmode":
                return f"Robotmode: {controller.mode.name}"
            case "safetymode":
                return f"Safetymode: {controller.safety.name}"
            case "safetystatus":
                return f"Safetystatus: {controller.safety.name}"
            case "running":
                return f"Program running: {str(controller.program is not None).lower()}"
            case "programstate":
                return f"{controller.runtime_state.name} rtde_control.urp"
            case "stop":
                controller.stop_program()
                return p.DASHBOARD_STOPPED
            case "pause":
                controller.paused = True
                return "Pausing program"
            case "play":
                controller.paused = False
                return "Starting program"
            case "power on":
                if controller.mode is p.RobotMode.POWER_OFF and controller.safety in p.MOVABLE_SAFETY:
                    controller.set_mode(p.RobotMode.IDLE)
                return "Powering on"
            case "brake release":
                if controller.mode is p.RobotMode.IDLE:
                    controller.set_mode(p.RobotMode.RUNNING)
                return "Brake releasing"
            case "power off":
                controller.set_mode(p.RobotMode.POWER_OFF)
                return "Powering off"
            case "unlock protective stop":
                if controller.safety is p.SafetyMode.PROTECTIVE_STOP:
                    controller.set_safety(p.SafetyMode.NORMAL)
                return "Protective stop releasing"
            case "close popup" | "close safety popup":
                return line.replace("close", "closing")
            case "quit":
                return "Disconnected"
        return f"could not understand: '{line}'"


class ScriptPort:
    """A program is complete at an unindented ``end``; a line outside one is a program of its
    own."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    async def handle(self, connection: Connection) -> None:
        pending = b""
        while True:
            t_ns, data = await connection.receive()
            pending += data
            while (size := _complete(pending)) > 0:
                text, pending = pending[:size], pending[size:]
                if text.strip():
                    connection.heard(t_ns, c.classify_script(text), text)
                    self._controller.start_program(program_of(text, self._controller))


def _complete(text: bytes) -> int:
    """How much of ``text`` is one program; 0: not all of it is there."""
    if text.lstrip().startswith((b"def ", b"sec ")):
        found = _END_OF_PROGRAM.search(text)
        return found.end() if found else 0
    return text.find(b"\n") + 1


def _line(text: str) -> bytes:
    return text.encode() + b"\n"
