"""``trace``: print the messages between a robot's actors, as they cross the mesh."""

from __future__ import annotations

import json
import sys
import time
from collections import OrderedDict

import msgspec
import trio

from strands_actors.caller.processes.run_directory import Note, notes
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.frames import ASK, DOWN, REPLY, TELL, WATCH, Frame, decode_frame
from strands_actors.kernel.node import PREFIX
from strands_actors.supervisors.permissions import shown

from .errors import Problem

SILENT_S = 3.0
"""After so long without a message, in seconds, a notice is printed. A robot at rest sends its script nothing."""
_ASKS = 1024
"""So many requests are remembered until they are answered."""
_ARROWS = {"tell": "->", "ask": "->", "answer": "=>", "watch": "->", "down": "->"}
_KINDS = {TELL: "tell", ASK: "ask", REPLY: "answer", WATCH: "watch", DOWN: "down"}

_decode_body = msgspec.msgpack.Decoder().decode


class Told(msgspec.Struct, frozen=True):
    """One message, as printed."""

    sender: str
    receiver: str
    kind: str
    type: str
    age_ms: float | None  # from sending to receiving here; None if not known


class Reader:
    """Decodes the frames of one robot. An answer has only a number, so its sender and receiver are taken
    from the request."""

    def __init__(self, robot: str) -> None:
        self._actors = f"{PREFIX}/{robot}/actor/"
        self._asks: OrderedDict[tuple[str, int], tuple[str, str]] = OrderedDict()

    def read(self, data: bytes, age_ms: float | None) -> Told | None:
        """Return the message in a frame; None if it is no frame, or of another robot."""
        try:
            head = decode_frame(data)
            kind = _KINDS[head.kind]
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError, KeyError):
            return None
        if kind == "answer":
            asked = self._asks.pop((head.to, head.cid), None)
            if asked is None:
                return None
            sender, receiver = asked
            return Told(self._name(receiver), self._name(sender), kind, _type_of(head), age_ms)
        if not (head.to.startswith(self._actors) or head.sender.startswith(self._actors)):
            return None
        if kind == "ask":
            self._asks[head.reply_to, head.cid] = head.sender, head.to
            while len(self._asks) > _ASKS:
                self._asks.popitem(last=False)
        return Told(self._name(head.sender), self._name(head.to), kind, _type_of(head), age_ms)

    def _name(self, address: str) -> str:
        return address.removeprefix(self._actors).removeprefix(f"{PREFIX}/node/")


def _type_of(head: Frame) -> str:
    """Return the type of a message. Its body is an array that begins with the name of the type."""
    try:
        body = _decode_body(head.body)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError, ValueError):
        return "?"
    if isinstance(body, list) and body and isinstance(body[0], str):
        return body[0]
    return "nothing" if body is None else "?"


def trace(robot: str, as_json: bool, count: int | None, seconds: float | None) -> None:
    """Print the messages between a robot's actors, until ``count`` messages or ``seconds``, if given."""
    trio.run(_trace, _note_of(robot), as_json, count, seconds)


def _note_of(robot: str) -> Note:
    found = {note.robot: note for note in notes()}
    if robot not in found:
        raise Problem(f"no robot {robot!r} of this user runs. there are {', '.join(found) or 'none'}")
    return found[robot]


async def _trace(note: Note, as_json: bool, count: int | None, seconds: float | None) -> None:
    reader, done, left, has_received = Reader(note.robot), trio.Event(), count, False

    def on_sample(received: Received) -> None:
        nonlocal left, has_received
        age_ms = round(1e3 * (time.time() - received.sent_s), 2) if received.sent_s else None
        message = None if done.is_set() else reader.read(received.payload, age_ms)
        if message is None:
            return
        has_received = True
        print(json.dumps(msgspec.to_builtins(message)) if as_json else line(message), flush=True)
        if left is not None:
            left -= 1
            if left <= 0:
                done.set()

    async def say_that_it_waits() -> None:
        await trio.sleep(SILENT_S)
        if not has_received:
            line = f"the actors of {note.robot} tell each other nothing so far; waiting, Ctrl-C ends it"
            print(line, file=sys.stderr, flush=True)

    session = await PubSub.open(connect=note.endpoints)
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(session.run)
            session.subscribe(shown(note.robot), on_sample, keep=4096)
            nursery.start_soon(say_that_it_waits)
            with trio.move_on_after(float("inf") if seconds is None else seconds):
                await done.wait()
            nursery.cancel_scope.cancel()
    finally:
        session.close()


def line(told: Told) -> str:
    age = "" if told.age_ms is None else f"{told.age_ms:8.2f} ms"
    return f"{age:>11}  {told.sender:<36} {_ARROWS[told.kind]} {told.receiver:<36} {told.type}"
