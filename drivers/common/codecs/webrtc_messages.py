"""Messages to and from the signalling server of GStreamer's ``webrtcsink``: JSON texts of a WebSocket (its
``net/webrtc/protocol``). Pure.

A viewer asks for the producers, then for a session with one of them. The producer offers its streams and
the viewer answers. Then each sends the other the addresses at which it can be reached.
"""

from __future__ import annotations

from typing import Any

import msgspec

from .malformed import MalformedFrame

LIST = '{"type":"list"}'


class Producer(msgspec.Struct, frozen=True):
    id: str
    meta: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        return str((self.meta or {}).get("name", ""))


class Description(msgspec.Struct, frozen=True):
    """An offer or an answer."""

    type: str
    sdp: str


class Candidate(msgspec.Struct, frozen=True, rename="camel"):
    """An address of the other end, for one of its streams. An empty one ends the list."""

    candidate: str
    sdp_m_line_index: int | None = None


class Told(msgspec.Struct, frozen=True, rename="camel"):
    """Any message of the server. A field that its type does not have is empty."""

    type: str
    session_id: str = ""
    producers: tuple[Producer, ...] = ()
    sdp: Description | None = None
    ice: Candidate | None = None
    details: str = ""


_decode = msgspec.json.Decoder(Told).decode


def decode_incoming(text: str | bytes) -> Told:
    """Return the message in a text of the server. Raise ``MalformedFrame`` if it is no message."""
    try:
        return _decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedFrame(f"no message of a signalling server: {error}") from None


def start_session(producer: str) -> str:
    return _encode({"type": "startSession", "peerId": producer})


def answer(session: str, sdp: str) -> str:
    return _encode({"type": "peer", "sessionId": session, "sdp": {"type": "answer", "sdp": sdp}})


def end_session(session: str) -> str:
    return _encode({"type": "endSession", "sessionId": session})


def _encode(message: dict[str, Any]) -> str:
    return msgspec.json.encode(message).decode()
