"""Test the client's writes before the first answer, and which answers it accepts."""

from __future__ import annotations

from typing import Any, cast

from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.client import Fci

DIALECT = p.DIALECTS[5]


class Ends:
    """A connection and a socket for states that keep their writes."""

    name = "the controller"

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.coming: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def read_waiting(self) -> bytes | None:
        return self.coming.pop(0) if self.coming else None

    def getsockname(self) -> tuple[str, int]:
        return "192.0.2.9", 4000


def client() -> tuple[Fci, Ends]:
    ends = Ends()
    return Fci(cast("Any", ends), cast("Any", ends), DIALECT), ends


def answer(command: str, number: int) -> bytes:
    return p.Message(DIALECT.commands.index(command), number, b"\0").raw


def test_saf_022_a_stop_leaves_with_the_greeting() -> None:
    fci, ends = client()
    stop = fci.greet_and_stop()
    assert ends.written == [DIALECT.connect(0, 4000) + DIALECT.request("stop", stop)]


def test_saf_022_an_answer_counts_for_the_question_that_it_names() -> None:
    """Both number and command must match: the end of a motion does not answer the stop after it."""
    fci, ends = client()
    fci.greet()
    motion, stop = fci.start_motion(), fci.send("stop")
    ends.coming = [answer("move", stop), answer("stop", motion), answer("stop", stop + 1), answer("stop", stop)]
    assert [(reply.code, reply.id) for reply in fci.replies()] == [(DIALECT.commands.index("stop"), stop)]
