"""Ask for an approval on the pages of the consoles (``strands-actors web``) that run on this computer.

A console listens on a unix socket in the run directory, which only this user can use. The program that has opened
the robot sends one ``Question`` to each console, as a line of JSON, and the first ``Answer`` counts. Closing the
connection withdraws the question. Nothing travels over the network, so no other host can approve anything.
"""

from __future__ import annotations

import contextlib
import enum
import selectors
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from strands_actors.caller.processes.run_directory import run_dir

from .approval import Request, plainly

ANSWER_SHARE = 0.95
"""Share of the time for the answer after which a card ends. So no person approves what was refused already."""
LONGEST_LINE = 64 * 1024
"""Longest question in bytes."""
CONNECT_S = 1.0
LATE_S = 5.0
"""How much later than the end of its card a console's answer may arrive."""


class CardState(enum.StrEnum):
    """The state of a question to the operators."""

    WAITING = "waiting"
    APPROVED = "approved"
    REFUSED = "refused"
    TIMED_OUT = "timed out"
    WITHDRAWN = "withdrawn"


class Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A question to the operators of a console.

    Attributes:
        robot: The name of the robot.
        verb: The verb of the robot's tool.
        inputs: The inputs of the verb as texts, by name.
        by: The program that asks.
        within_s: Seconds for the answer.
    """

    robot: str
    verb: str
    inputs: dict[str, str]
    by: str
    within_s: float


class Answer(msgspec.Struct, frozen=True):
    """The end of a question: its final state."""

    state: CardState


def consoles_dir() -> Path:
    """Return the directory of the consoles' sockets. It exists only after a console has run."""
    return run_dir() / "consoles"


def ask_on_console(request: Request) -> bool:
    """Ask for an approval on each page of an operator, for ``Robot(approve=ask_on_console)``.

    Returns:
        True if an operator has approved, and False if one has refused.

    Raises:
        ConnectionError: No console runs on this computer, or all of them have ended.
        TimeoutError: No operator has answered in time.
    """
    within_s = request.within_s * ANSWER_SHARE
    inputs = {name: plainly(value) for name, value in request.inputs.items()}
    question = Question(request.robot, request.verb, inputs, request.by, within_s)
    with contextlib.ExitStack() as stack:
        waiting = stack.enter_context(selectors.DefaultSelector())
        for link in _links(question):
            waiting.register(stack.enter_context(link), selectors.EVENT_READ)
        until_s = time.monotonic() + within_s + LATE_S
        while waiting.get_map():
            for key, _ in waiting.select(max(0.0, until_s - time.monotonic())):
                assert isinstance(key.fileobj, socket.socket)
                answer = _receive(key.fileobj)
                if answer is None:
                    waiting.unregister(key.fileobj)
                elif answer.state is CardState.TIMED_OUT:
                    raise TimeoutError(f"no operator has answered on the console within {within_s:.0f} s")
                else:
                    return answer.state is CardState.APPROVED
            if time.monotonic() >= until_s:
                raise TimeoutError("the console has not answered")
    raise ConnectionError("no console runs on this computer. Start one: strands-actors web")


def _links(question: Question) -> Iterator[socket.socket]:
    """Send a question to each console, and yield the connections."""
    line = msgspec.json.encode(question) + b"\n"
    for path in sorted(consoles_dir().glob("*.sock")):
        link = socket.socket(socket.AF_UNIX)
        link.settimeout(CONNECT_S)
        try:
            link.connect(str(path))
            link.sendall(line)
        except OSError:
            # The console has ended without removing its socket, or it is frozen. The others are asked.
            link.close()
        else:
            yield link


def _receive(link: socket.socket) -> Answer | None:
    """Return the answer of a console; None if it has ended."""
    try:
        return msgspec.json.decode(link.recv(LONGEST_LINE), type=Answer)
    except (OSError, msgspec.MsgspecError):
        return None
