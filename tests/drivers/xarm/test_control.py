"""Test requests and answers of the control port: which answer is awaited, and for how long. No I/O."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.control import FORGET_S, Control
from strands_actors.drivers.xarm.protocol import Register
from strands_actors.kernel.clock import NS, VirtualClock
from tests.drivers.common.memory_port import MemoryPort, virtual


class Line:
    """The host's end, with its clock."""

    def __init__(self) -> None:
        self.now_s = 5.0
        self.arrived: list[bytes] = []

    def now_ns(self) -> int:
        return round(self.now_s * NS)

    def write(self, data: bytes) -> None:
        """Take the bytes without an answer."""

    def read_waiting(self) -> bytes | None:
        return self.arrived.pop(0) if self.arrived else None

    def answers(self, control: Control, number: int, register: int) -> None:
        self.arrived.append(p.frame(number, bytes((register, 0))))
        control.take_waiting()


def opened() -> tuple[Line, Control]:
    line = Line()
    return line, Control(cast(Any, line), "the arm", cast(Any, line))


def test_silence_counts_from_the_first_pending_request_or_the_last_answer() -> None:
    line, control = opened()
    assert control.silent_s(line.now_ns()) == 0.0, "no answer is pending"
    first = control.send(Register.GET_STATE)
    control.send(Register.GET_STATE)
    line.now_s += 0.3
    assert control.silent_s(line.now_ns()) == pytest.approx(0.3)
    line.answers(control, first, Register.GET_STATE)
    line.now_s += 0.1
    assert control.silent_s(line.now_ns()) == pytest.approx(0.1)


def test_answers_that_never_came_are_forgotten() -> None:
    line, control = opened()
    for _ in range(3):
        control.send(Register.GET_STATE)
    line.now_s += FORGET_S
    last = control.send(Register.GET_STATE)
    line.answers(control, last, Register.GET_STATE)
    assert not control.idle, "the answers may still arrive"
    line.now_s += 0.001
    last = control.send(Register.GET_STATE)
    line.answers(control, last, Register.GET_STATE)
    assert control.idle


def test_an_answer_to_another_question_is_not_understood() -> None:
    line, control = opened()
    number = control.send(Register.GET_STATE)
    with pytest.raises(WireDown, match="the controller sent invalid data"):
        line.answers(control, number, Register.ERRORS)


def test_numbers_restart_after_the_last() -> None:
    _, control = opened()
    for _ in range(p.LAST_NUMBER - 1):
        next(control._numbers)
    assert [control.send(Register.GET_STATE) for _ in range(2)] == [p.LAST_NUMBER, 1]


class SlowController:
    """Answers a request to enable the motors after two seconds, and all others at once."""

    def __init__(self) -> None:
        self.control = Control(cast(Any, MemoryPort(self._hear)), "the arm", VirtualClock())

    def _hear(self, data: bytes) -> Iterable[tuple[float, bytes]]:
        number, register = int.from_bytes(data[:2], "big"), data[6]
        yield 2.0 if register == Register.MOTION_ENABLE else 0.001, p.frame(number, bytes((register, 0)))


def test_an_awaited_answer_is_not_forgotten_while_others_come() -> None:
    async def main() -> None:
        control, replies = SlowController().control, list[p.Reply | None]()

        async def enable() -> None:
            replies.append(await control.ask(Register.MOTION_ENABLE, within_s=5.0))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(enable)
            await trio.sleep(1.5)
            assert await control.ask(Register.GET_STATE, within_s=0.1) is not None
            assert not control.idle
        assert [reply and reply.register for reply in replies] == [Register.MOTION_ENABLE]
        assert control.idle

    virtual(main)
