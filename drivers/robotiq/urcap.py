"""Simulate the text port that Robotiq's URCap opens on a UR controller (TCP port 63352).

A client sends lines such as ``GET POS`` and ``SET POS 255 SPE 100 GTO 1``. Each name is a field of the gripper's
registers, such as POS for the position. Answers have no line end. An unknown line is answered with ``?`` [assumed].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from strands_actors.drivers.common.twin import Exchange, Fault, Reply
from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p
from .protocol import Command, Status
from .unit import RobotiqTwin
from .urcap_client import PORT

LONGEST = 1024
"""Most bytes of a line. The rest of a longer line is dropped."""

_WRITTEN: Mapping[str, tuple[str, int]] = {
    "ACT": ("activate", 1),
    "GTO": ("go_to", 1),
    "ATR": ("release", 1),
    "POS": ("position", p.TOP),
    "SPE": ("speed", p.TOP),
    "FOR": ("force", p.TOP),
}
"""The field of ``Command`` for each name, and its highest value."""

_READ: Mapping[str, Callable[[Status, Command], int]] = {
    "ACT": lambda status, command: status.activated,
    "GTO": lambda status, command: status.going,
    "ATR": lambda status, command: command.release,
    "SPE": lambda status, command: command.speed,
    "FOR": lambda status, command: command.force,
    "STA": lambda status, command: status.activation,
    "OBJ": lambda status, command: status.contact,
    "FLT": lambda status, command: status.fault,
    "PRE": lambda status, command: status.request,
    "POS": lambda status, command: status.position,
    "COU": lambda status, command: status.current,
}


LINES: Modelled[str] = Modelled(
    "lines of the text port",
    {
        **{f"GET {name}": "returns the field" for name in (*_READ, "SID")},
        **{f"SET {name}": "writes the field of the command" for name in _WRITTEN},
    },
    "?",
)


class UrcapSession:
    """One client's connection to the text port: decodes its lines and answers them."""

    def __init__(self, twin: RobotiqTwin, safe_state: str = "hold") -> None:
        """Answer one client.

        Args:
            twin: The gripper.
            safe_state: The safe state that a stop of the gripper brings the robot to; empty if the gripper is only
                a part of the robot.
        """
        self._twin = twin
        self._safe_state = safe_state
        self._pending = b""

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        *lines, self._pending = (self._pending + data).split(b"\n")
        self._pending = self._pending[:LONGEST]
        for line in lines:
            words = line.decode("ascii", "replace").split()
            self._twin.gripper.note_request()
            changed = _changed(words, Command.from_registers(self._twin.output()))
            kind = "read" if changed is None else self._twin.kind_of(0, changed.registers())
            answer = self._answer(words, changed)
            yield Exchange(
                kind, line + b"\n", self._replies(answer, kind), self._safe_state if kind == "safe" else None
            )

    def _answer(self, words: list[str], changed: Command | None) -> str:
        twin = self._twin
        if changed is not None:
            twin.write(0, changed.registers())
            return "ack"
        match words:
            case ["GET", name] if name in _READ:
                command = Command.from_registers(twin.output())
                return f"{name} {int(_READ[name](twin.status(), command))}"
            case ["GET", "SID"]:
                return f"SID [{twin.unit}]"
        return "?"

    def _replies(self, answer: str, kind: str) -> list[Reply]:
        if self._twin.fault is Fault.OFF:
            return []
        reply = self._twin.faults.apply(Reply(0.0, answer.encode(), None, kind))
        return [] if reply is None else [reply]


def _changed(words: list[str], command: Command) -> Command | None:
    """Return ``command`` with the changes of a line ``SET NAME VALUE ...``.

    Return None for any other line, or if a name or value is invalid.
    """
    if len(words) < 3 or words[0] != "SET" or len(words) % 2 == 0:
        return None
    fields: dict[str, int | bool] = {}
    for name, value in zip(words[1::2], words[2::2], strict=True):
        field, top = _WRITTEN.get(name, ("", 0))
        if not field or not value.isdecimal() or not 0 <= int(value) <= top:
            return None
        fields[field] = bool(int(value)) if top == 1 else int(value)
    return Command(**{**{name: getattr(command, name) for name in command.__struct_fields__}, **fields})


__all__ = ["LINES", "PORT", "UrcapSession"]
