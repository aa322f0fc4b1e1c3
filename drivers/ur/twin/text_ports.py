"""The text ports of a simulated controller: the dashboard, and the script ports, which accept programs."""

from __future__ import annotations

import re
from collections.abc import Callable

import trio

from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.ur import protocol as p

from . import commands as c
from .controller import TICK_HZ, Controller
from .outputs import Sample
from .requests import DASHBOARD
from .script import Standing, run_text

VERSION = "5.13.1.1253"
PROGRAMS = frozenset({"rtde_control.urp", "hold.urp"})
"""Names of programs that are stored on the simulated controller. Such a program runs, but moves nothing."""
INSTALLATIONS = frozenset({"default.installation"})
MODES = ("manual", "automatic")

BANNER = "Connected: Universal Robots Dashboard Server"
POLYSCOPE = "URSoftware 5.13.1.0 (Nov 21 2023)"

LONGEST_PROGRAM = 1_000_000

Message = Callable[[Controller, Sample], bytes]

_END_OF_PROGRAM = re.compile(rb"^end[ \t\r]*\n", re.MULTILINE)


LAST_LINES = ("quit", "shutdown")
"""Lines after which the dashboard closes the connection."""


class Dashboard:
    def __init__(self, controller: Controller, robot: str) -> None:
        self._controller = controller
        # The dashboard reports the model without the letter of the series, such as UR5 for a UR5e [assumed].
        self._model = robot.upper().removesuffix("E")
        self._program = ""
        self._mode = ""

    async def handle(self, connection: Connection) -> None:
        connection.send_logged("read", _line(BANNER))
        pending = b""
        while True:
            t_ns, data = await connection.receive()
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                text = line.decode("utf-8", "replace").strip()
                connection.log_received(t_ns, c.classify_dashboard(text), line + b"\n")
                connection.send_logged("read", _line(self.answer(text)))
                if text.lower() in LAST_LINES:
                    connection.hang_up()
                    return

    def answer(self, line: str) -> str:
        """Carry out a line of a dashboard client, and return the answer."""
        controller = self._controller
        if _line_key(line) not in DASHBOARD:
            return f"could not understand: '{line}'"
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
                return f"{controller.runtime_state.name} {self._program or '<unnamed>'}"
            case "stop":
                controller.stop_program()
                return p.DASHBOARD_STOPPED
            case "pause":
                if not controller.busy:
                    return "Failed to execute: pause"
                controller.paused = True
                return "Pausing program"
            case "play":
                return self._play()
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
                controller.log.append(line)
                return line.replace("close", "closing")
            case "quit":
                return "Disconnected"
            case "shutdown":
                controller.set_mode(p.RobotMode.POWER_OFF)
                return "Shutting down"
            case "version":
                return VERSION
            case "get loaded program":
                return f"Loaded program: /programs/{self._program}" if self._program else "No program loaded"
            case "isprogramsaved":
                return f"true {self._program or '<unnamed>'}"
            case "restart safety":
                return self._restart_safety()
            case "get operational mode":
                return self._mode.upper() or "NONE"
            case "clear operational mode":
                self._mode = ""
                return "No longer controlling the operational mode. Current operational mode: 'NONE'."
        word, _, rest = line.partition(" ")
        return self._with_words(word.lower(), rest.strip(), line)

    def _with_words(self, word: str, rest: str, line: str) -> str:
        """Carry out a dashboard line that has an argument, such as a file name. Return the answer."""
        controller = self._controller
        match word, *rest.split(maxsplit=2):
            case "load", "installation", name:
                return f"{'Loading installation' if name in INSTALLATIONS else 'File not found'}: {name}"
            case "load", name:
                if name.removeprefix("/programs/") not in PROGRAMS:
                    return f"File not found: {name}"
                self._program = name.removeprefix("/programs/")
                return f"Loading program: {name}"
            case "popup", *_:
                controller.log.append(f"popup: {rest}")
                return "showing popup"
            case "addtolog", *_:
                if rest:
                    controller.log.append(rest)
                return "Added log message" if rest else "No log message to add"
            case "set", "operational", "mode", mode:
                if mode.lower() not in MODES:
                    return f"Failed setting operational mode '{mode}'"
                self._mode = mode.lower()
                return f"Operational mode '{self._mode}' is set"
        return f"could not understand: '{line}'"

    def _play(self) -> str:
        controller = self._controller
        if controller.busy:
            controller.paused = False
            return "Starting program"
        if not self._program:
            return "Failed to execute: play"
        controller.start_program(Standing)
        return "Starting program" if controller.busy else "Failed to execute: play"

    def _restart_safety(self) -> str:
        """Clear a safety fault or violation. Afterwards the arm's power is off. Return the answer."""
        if self._controller.safety in (p.SafetyMode.FAULT, p.SafetyMode.VIOLATION):
            self._controller.set_safety(p.SafetyMode.NORMAL)
        self._controller.set_mode(p.RobotMode.POWER_OFF)
        return "Restarting safety"


class ScriptPort:
    """A port that accepts programs, and sends the controller's state without a request.

    A program with ``def`` or ``sec`` ends with an unindented ``end``. Any other line is a program by itself.

    Args:
        controller: The controller that runs the programs.
        hz: Rate of the state.
        message: Encodes the state.
        greeting: The first message to each client.
        load_s: Seconds from the receipt of a program until the controller has loaded it. The dashboard's stop does
            not end a program that is being loaded [assumed: the worst case].
    """

    def __init__(
        self, controller: Controller, hz: float, message: Message, greeting: bytes = b"", load_s: float = 0.0
    ) -> None:
        self._controller = controller
        self._every = round(TICK_HZ / hz)
        self._message, self._greeting = message, greeting
        self._load_s = load_s
        self._clients: set[Connection] = set()

    async def handle(self, connection: Connection) -> None:
        connection.offer(self._greeting)
        self._clients.add(connection)
        try:
            await self._serve(connection)
        finally:
            self._clients.discard(connection)

    def push(self, tick: int, sample: Callable[[], Sample]) -> None:
        """Send the state of a tick to all clients, at the rate of this port. Send nothing if no client reads."""
        if tick % self._every or not self._clients:
            return
        reading = [client for client in self._clients if client.takes]
        if reading:
            self.tell(self._message(self._controller, sample()))

    def tell(self, message: bytes) -> None:
        for client in self._clients:
            client.offer(message)

    async def _serve(self, connection: Connection) -> None:
        pending = b""
        while True:
            t_ns, data = await connection.receive()
            pending += data
            if len(pending) > LONGEST_PROGRAM:
                self._controller.note(f"compile error: a program longer than {LONGEST_PROGRAM} bytes")
                return
            while (size := _complete(pending)) > 0:
                text, pending = pending[:size], pending[size:]
                if text.strip():
                    kind = c.classify_script(text)
                    connection.log_received(t_ns, kind, text)
                    if self._load_s and kind == "enable":
                        await trio.sleep(self._load_s)
                    run_text(text, self._controller)


def _line_key(line: str) -> str:
    """Return the name of a dashboard line in the table of modelled ones: the line without its argument."""
    words = line.lower().split()
    if words[:1] in (["load"], ["popup"], ["addtolog"]):
        return words[0]
    return " ".join(words[:3] if words[:3] == ["set", "operational", "mode"] else words)


def _complete(text: bytes) -> int:
    """Return the size in bytes of the first program in ``text``, or 0 if its end has not arrived yet."""
    if text.lstrip().startswith((b"def ", b"sec ")):
        match = _END_OF_PROGRAM.search(text)
        return match.end() if match else 0
    return text.find(b"\n") + 1


def _line(text: str) -> bytes:
    return text.encode() + b"\n"
