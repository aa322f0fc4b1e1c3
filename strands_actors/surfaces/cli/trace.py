"""``trace``: print the messages that a robot's processes exchange."""

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


class TracedMessage(msgspec.Struct, frozen=True):
    """One message in the form in which it is printed."""

    sender: str
    receiver: str
    kind: str
    type: str
    age_ms: float | None  # Time from sending to receiving in this process, in milliseconds. None if not known.


class Reader:
    """Decodes the messages of one robot. An answer has only the number of its request, so its sender and
    receiver are taken from the request."""

    def __init__(self, robot: str) -> None:
        self._actors = f"{PREFIX}/{robot}/actor/"
        self._asks: OrderedDict[tuple[str, int], tuple[str, str]] = OrderedDict()

    def read(self, data: bytes, age_ms: float | None) -> TracedMessage | None:
        """Decode a message. Return None if the data is not a message, or is a message of another robot."""
        try:
            head = decode_frame(data)
            message_kind = _KINDS[head.kind]
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError, KeyError):
            return None
        if message_kind == "answer":
            request = self._asks.pop((head.to, head.cid), None)
            if request is None:
                return None
            sender, receiver = request
            return TracedMessage(self._name(receiver), self._name(sender), message_kind, _type_of(head), age_ms)
        if not (head.to.startswith(self._actors) or head.sender.startswith(self._actors)):
            return None
        if message_kind == "ask":
            self._asks[head.reply_to, head.cid] = head.sender, head.to
            while len(self._asks) > _ASKS:
                self._asks.popitem(last=False)
        return TracedMessage(self._name(head.sender), self._name(head.to), message_kind, _type_of(head), age_ms)

    def _name(self, address: str) -> str:
        return address.removeprefix(self._actors).removeprefix(f"{PREFIX}/node/")


def _type_of(head: Frame) -> str:
    """Return the name of a message's type, with which its body begins."""
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
    notes_by_robot = {note.robot: note for note in notes()}
    if robot not in notes_by_robot:
        raise Problem(f"no robot {robot!r} of this user runs. There are {', '.join(notes_by_robot) or 'none'}")
    return notes_by_robot[robot]


async def _trace(note: Note, as_json: bool, count: int | None, seconds: float | None) -> None:
    reader, done, remaining, has_received = Reader(note.robot), trio.Event(), count, False

    def on_sample(received: Received) -> None:
        nonlocal remaining, has_received
        age_ms = round(1e3 * (time.time() - received.sent_s), 2) if received.sent_s else None
        message = None if done.is_set() else reader.read(received.payload, age_ms)
        if message is None:
            return
        has_received = True
        print(json.dumps(msgspec.to_builtins(message)) if as_json else line(message), flush=True)
        if remaining is not None:
            remaining -= 1
            if remaining <= 0:
                done.set()

    async def say_that_it_waits() -> None:
        await trio.sleep(SILENT_S)
        if not has_received:
            line = f"the processes of {note.robot} have exchanged no message yet. Still waiting, Ctrl-C ends this"
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


def line(message: TracedMessage) -> str:
    age = "" if message.age_ms is None else f"{message.age_ms:8.2f} ms"
    return f"{age:>11}  {message.sender:<36} {_ARROWS[message.kind]} {message.receiver:<36} {message.type}"
