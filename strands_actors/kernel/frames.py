"""Frames between nodes: one format for links and meshes.

A frame is a msgpack array ``[to, kind, cid, sender, reply_to, body]``. The body stays raw until the decoder of
the receiving actor reads it. So a frame to an unknown address, or with a body of the wrong type, costs only a
refusal.
"""

from __future__ import annotations

import functools
import operator
import types
import typing
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from . import refusals
from .messages import Message, Refused

TELL, ASK, REPLY, WATCH, DOWN, HOSTS = range(6)


class Frame(msgspec.Struct, frozen=True, array_like=True, gc=False):
    to: str
    kind: int
    # Correlation id of a request (ask) and its reply; 0 for a message that needs no answer (tell).
    cid: int
    sender: str
    reply_to: str
    body: msgspec.Raw


class Down(Message, frozen=True):
    """A watched actor has ended. This message comes after all earlier messages of that actor."""

    address: str
    reason: str


encode = msgspec.msgpack.Encoder().encode
decode_frame = msgspec.msgpack.Decoder(Frame).decode


def frame(to: str, kind: int, cid: int, sender: str, reply_to: str, body: object) -> bytes:
    return encode((to, kind, cid, sender, reply_to, body))


def outline(data: bytes) -> bytes | None:
    """Return the frame with its body reduced to the name of its type, or None if ``data`` is no frame."""
    try:
        head = decode_frame(data)
        body = _decode_any(head.body)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError, ValueError):
        return None
    name = body[:1] if isinstance(body, list) and body and isinstance(body[0], str) else None
    return encode(msgspec.structs.replace(head, body=msgspec.Raw(encode(name))))


_decode_any = msgspec.msgpack.Decoder().decode


class Protocol:
    """The messages that an actor class accepts and answers, from the annotation of its ``receive``."""

    __slots__ = ("accepts", "carriers", "decode", "decode_reply", "is_async", "name", "stamped")

    def __init__(self, receive: Callable[..., Any], name: str) -> None:
        try:
            hints = typing.get_type_hints(receive)
        except NameError as error:
            raise TypeError(
                f"{name}.receive: {error}. Import or define what it names at module level, "
                "outside of 'if TYPE_CHECKING'"
            ) from error
        if "message" not in hints:
            raise TypeError(f"{name}.receive: annotate its argument 'message' with the types it accepts")
        accepts = _members(hints["message"])
        for message_type in accepts:
            if not (isinstance(message_type, type) and issubclass(message_type, Message)):
                raise TypeError(
                    f"{name}.receive: {message_type!r} is not a Message. Annotate 'message' with subclasses of it"
                )
        replies = [
            message_type
            for message_type in _members(hints.get("return", type(None)))
            if isinstance(message_type, type) and issubclass(message_type, Message) and message_type is not Refused
        ]
        self.name = name
        self.accepts = frozenset(accepts)
        self.carriers = frozenset(
            message_type for message_type in accepts if "descriptors" in message_type.__struct_fields__
        )
        self.stamped = frozenset(
            message_type for message_type in accepts if "channel" in message_type.__struct_fields__
        )
        """Messages with a field for the channel over which they came. The router sets it, whatever the sender
        wrote there."""
        self.decode: Callable[[Any], Message] = msgspec.msgpack.Decoder(_union(accepts)).decode
        self.decode_reply: Callable[[Any], Message | None] = msgspec.msgpack.Decoder(
            _union((*replies, Refused, None))
        ).decode
        self.is_async = bool(getattr(receive, "__code__", None) and receive.__code__.co_flags & 0x80)

    def wrong_type(self, message: object) -> Refused:
        accepted = ", ".join(sorted(message_type.__name__ for message_type in self.accepts))
        return refusals.wrong_type(self.name, type(message).__name__, accepted)


def read_reply(decode: Callable[[Any], Message | None], body: Any) -> Message | None:
    """Decode a reply with ``decode``. Return a refusal if the body cannot be read."""
    try:
        return decode(body)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        return refusals.malformed_reply(error)


_protocols: dict[Any, Protocol] = {}


def protocol_of(actor_class: Any) -> Protocol:
    """Return the protocol of an actor class. It is built once."""
    protocol = _protocols.get(actor_class)
    if protocol is None:
        protocol = _protocols[actor_class] = Protocol(actor_class.receive, actor_class.__name__)
    return protocol


def _union(members: Iterable[Any]) -> Any:
    return functools.reduce(operator.or_, members)


def _members(annotation: Any) -> tuple[Any, ...]:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return typing.get_args(annotation)
    return (annotation,)
