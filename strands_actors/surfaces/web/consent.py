"""Questions of programs on this computer to the operators: may this verb run? Each is a card on every page.

The first answer of an operator counts. A card that ends without an answer stays on the pages for a
while with its final state, so that each operator sees how it ended.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import trio
from starlette.requests import Request
from starlette.routing import Route

from strands_actors.contract.shown import harmless
from strands_actors.surfaces.agents.asking import LONGEST_LINE, Answer, CardState, Question, consoles_dir

from .access import Role, Session
from .answers import Bad, body, order, sender

MOST_WAITING = 16
"""Further questions are not taken, so their programs get a refusal."""
KEEP_S = 20.0
"""How long a card is shown after its end."""
READ_S = 2.0
"""Longest time until a program has sent its question."""
LONGEST_WAIT_S = 3600.0
LONGEST_TEXT = 2000
_PEER = struct.Struct("iII")


class Card(msgspec.Struct):
    """A question on the pages.

    Attributes:
        id: Its number.
        robot: The name of the robot.
        verb: The verb of the robot's tool.
        inputs: The values, by name.
        by: The program that asks.
        within_s: Seconds for the answer, from its start.
        until_s: When it ends, on trio's clock.
        state: Its state.
        answered_by: The session that has answered.
    """

    id: int
    robot: str
    verb: str
    inputs: dict[str, str]
    by: str
    within_s: float
    until_s: float
    state: CardState = CardState.WAITING
    answered_by: str = ""


class ConsentOrder(msgspec.Struct, forbid_unknown_fields=True):
    """The answer of an operator."""

    approve: bool


class Consents:
    """The cards of a console."""

    def __init__(self) -> None:
        self.count = 0
        self._cards: dict[int, Card] = {}
        self._ended: dict[int, trio.Event] = {}
        self._numbers = itertools.count(1)

    def routes(self) -> list[Route]:
        return [Route("/consent/{id:int}", order(self._answer, Role.OPERATOR), methods=["POST"])]

    def news(self, since: int, role: Role) -> dict[str, Any] | None:
        """Return all cards for a page. A viewer sees them, too."""
        now_s = trio.current_time()
        cards = [
            {**msgspec.structs.asdict(card), "left_s": round(max(0.0, card.until_s - now_s), 2)}
            for card in self._cards.values()
        ]
        return {"type": "consent", "cards": cards}

    async def _answer(self, request: Request, session: Session) -> dict[str, Any]:
        answered = await body(request, ConsentOrder)
        card = self._cards.get(request.path_params["id"])
        if card is None:
            raise Bad(404, "This question has ended. The program has to ask again.")
        if card.state is not CardState.WAITING:
            by = f" by {card.answered_by}" if card.answered_by else ""
            raise Bad(409, f"This question was {card.state}{by} already. Your answer changes nothing.")
        self._end(card, CardState.APPROVED if answered.approve else CardState.REFUSED, sender(session))
        return {"ok": True, "state": card.state}

    def _end(self, card: Card, state: CardState, by: str = "") -> None:
        if card.state is CardState.WAITING:
            card.state, card.answered_by = state, by
            self.count += 1
            self._ended[card.id].set()

    # -- the programs that ask

    async def listen(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Take questions until cancelled.

        Raises:
            OSError: The socket cannot be made.
        """
        with _bound(consoles_dir() / f"{os.getpid()}.sock") as bound:
            listener = trio.SocketListener(trio.socket.from_stdlib_socket(bound))
            async with listener, trio.open_nursery() as self._nursery:
                task_status.started()
                await trio.serve_listeners(self._serve, [listener], handler_nursery=self._nursery)

    async def _serve(self, link: trio.SocketStream) -> None:
        """Serve one program: one question, one answer."""
        with contextlib.suppress(trio.BrokenResourceError, trio.ClosedResourceError):
            async with link:
                question = await _read(link)
                if question is not None and len(self._ended) < MOST_WAITING:
                    state = await self._ask(question, link)
                    await link.send_all(msgspec.json.encode(Answer(state)))

    async def _ask(self, question: Question, link: trio.SocketStream) -> CardState:
        number, ended = next(self._numbers), trio.Event()
        within_s = min(question.within_s, LONGEST_WAIT_S)
        card = self._cards[number] = Card(
            number,
            _text(question.robot),
            _text(question.verb),
            {_text(name): _text(value) for name, value in question.inputs.items()},
            _text(question.by),
            within_s,
            trio.current_time() + within_s,
        )
        self._ended[number] = ended
        self.count += 1

        async def watch() -> None:
            with contextlib.suppress(trio.BrokenResourceError):
                await link.receive_some(1)
            self._end(card, CardState.WITHDRAWN)

        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(watch)
                with trio.move_on_after(within_s):
                    await ended.wait()
                self._end(card, CardState.TIMED_OUT)
                nursery.cancel_scope.cancel()
        finally:
            del self._ended[number]
            self._nursery.start_soon(self._forget, number)
        return card.state

    async def _forget(self, number: int) -> None:
        await trio.sleep(KEEP_S)
        del self._cards[number]
        self.count += 1


@contextlib.contextmanager
def _bound(path: Path) -> Iterator[socket.socket]:
    """Listen on a unix socket while the block runs."""
    path.parent.mkdir(mode=0o700, exist_ok=True)
    path.unlink(missing_ok=True)  # The number of an ended process is used again.
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        path.chmod(0o600)
        listening.listen()
        try:
            yield listening
        finally:
            path.unlink(missing_ok=True)


async def _read(link: trio.SocketStream) -> Question | None:
    """Return the question of a program; None if it sends something else, or belongs to another user."""
    peer = link.socket.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    if _PEER.unpack(peer)[1] != os.getuid():
        return None
    line = b""
    with trio.move_on_after(READ_S):
        while not line.endswith(b"\n"):
            part = await link.receive_some(LONGEST_LINE)
            line += part
            if not part or len(line) > LONGEST_LINE:
                return None
        with contextlib.suppress(msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            question = msgspec.json.decode(line, type=Question)
            return question if question.within_s > 0 else None
    return None


def _text(text: str) -> str:
    return harmless(text[:LONGEST_TEXT])
