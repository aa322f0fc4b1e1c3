"""Ask a program in place of a person at a terminal: questions and answers are lines of JSON (``--dialogue``).

A line of output with a ``type`` is one of the structs below. The line without one is the command's result, as with
``--json``. A line of input is an ``Answer``. The end of the input counts as Ctrl-C, so a command ends safely when
the program that started it ends.
"""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
from collections.abc import Mapping
from typing import Any

import msgspec
import trio

from strands_actors.contract.loading import load
from strands_actors.surfaces.drill.certificate import StepResult

from .person import DEGREES_PER_COUNT, TEXT_OF, TURN_S, YES

MOVED_S = 0.1
"""Shortest time between two reports of a movement, in seconds."""


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    """The answer to a question.

    Attributes:
        number: The number of the question. An answer with the number of another question is dropped.
        text: ``yes`` to confirm, the robot's name to consent; otherwise without meaning.
    """

    number: int
    text: str = ""


class Text(msgspec.Struct, tag="said"):
    """A text for the person that needs no answer."""

    text: str


class Ready(msgspec.Struct, tag="ready"):
    """The person is asked to do something, and to answer when it is done."""

    number: int
    text: str


class Moved(msgspec.Struct, tag="moved"):
    """How far the joints have moved, in degrees.

    Attributes:
        joint: The joint that is asked for.
        expected: The range of this joint in the robot's table; None if it turns without an end.
        degrees: The movement of every joint.
    """

    joint: str
    expected: float | None
    degrees: Mapping[str, float]


class ProposedJoint(msgspec.Struct):
    """The new values of one joint. ``swept`` is in degrees, the other values are in encoder counts."""

    joint: str
    swept: float | None
    offset_before: int
    offset: int
    range_min: int
    range_max: int


class Confirm(msgspec.Struct, tag="confirm"):
    """The person is asked if these values may be written. ``findings`` are sentences."""

    number: int
    joints: list[ProposedJoint]
    findings: list[str]


class Consent(msgspec.Struct, tag="consent"):
    """The person is asked to consent to the text, by answering with ``word``."""

    number: int
    text: str
    word: str


class Step(msgspec.Struct, tag="step"):
    """The result of one step of a drill."""

    result: StepResult


class Dialogue:
    """Asks a program. Make it in the main thread. The end of the input interrupts this thread."""

    def __init__(self) -> None:
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._question = 0
        self._next_moved_s = 0.0
        # A program that was started in the background ignores SIGINT, and so would its children.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Thread(target=self._read, name="answers", daemon=True).start()

    def say(self, text: str) -> None:
        _send(Text(text))

    instruct = say

    def step(self, result: StepResult) -> None:
        _send(Step(result))

    async def ready(self, text: str) -> None:
        await self._ask(Ready(self._number(), text))

    async def confirm(self, proposal: Any) -> bool:
        joints = [
            ProposedJoint(
                key,
                _degrees(proposal.counts[key]) if key in proposal.counts else None,
                proposal.before[key]["homing_offset"],
                motor.homing_offset,
                motor.range_min,
                motor.range_max,
            )
            for key, motor in proposal.motors.items()
        ]
        findings = [f"{load(TEXT_OF)(finding)}." for finding in proposal.findings]
        return await self._ask(Confirm(self._number(), joints, findings)) == YES

    def consents(self, text: str, word: str) -> bool:
        return trio.run(self._ask, Consent(self._number(), text, word)) == word

    def show(self, sweep: Any, joint: str, expected: int | None) -> None:
        now_s = trio.current_time()
        if now_s >= self._next_moved_s:
            self._next_moved_s = now_s + MOVED_S
            degrees = {key: _degrees(sweep.moved(key)) for key in sweep.now}
            _send(Moved(joint, None if expected is None else _degrees(expected), degrees))

    def _number(self) -> int:
        self._question += 1
        return self._question

    async def _ask(self, question: Ready | Confirm | Consent) -> str:
        _send(question)
        while True:
            try:
                answer = self._answers.get_nowait()
            except queue.Empty:
                await trio.sleep(TURN_S)
                continue
            if answer.number == question.number:
                return answer.text

    def _read(self) -> None:
        # Not by sys.stdin: its lock, held by a waiting thread, would abort the interpreter at its end.
        rest = b""
        while data := os.read(0, 4096):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                try:
                    self._answers.put(msgspec.json.decode(line, type=Answer))
                except msgspec.DecodeError as error:
                    print(f"strands-actors: this line is no answer: {error}", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGINT)


def _send(message: msgspec.Struct) -> None:
    print(msgspec.json.encode(message).decode(), flush=True)


def _degrees(counts: int) -> float:
    return round(counts * DEGREES_PER_COUNT, 1)
