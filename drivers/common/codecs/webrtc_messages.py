"""Encode and decode the JSON messages of the signalling server of GStreamer's ``webrtcsink``, which arrive over a
WebSocket (its ``net/webrtc/protocol``). Pure.

A viewer requests the list of video senders ("producers"), then a session with one of them. The producer offers its
streams and the viewer answers. Then each of the two sends the other its network addresses.
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
    """A WebRTC session description: an offer or an answer, in SDP."""

    type: str
    sdp: str


class Candidate(msgspec.Struct, frozen=True, rename="camel"):
    """A network address at which the sender of this message can be reached (ICE candidate), for one of the
    session's streams. An empty ``candidate`` ends the list of addresses."""

    candidate: str
    sdp_m_line_index: int | None = None


class ServerMessage(msgspec.Struct, frozen=True, rename="camel"):
    """A received message of the signalling server. A field that this type of message does not have is empty."""

    type: str
    session_id: str = ""
    producers: tuple[Producer, ...] = ()
    sdp: Description | None = None
    ice: Candidate | None = None
    details: str = ""


_decode = msgspec.json.Decoder(ServerMessage).decode


def decode_incoming(text: str | bytes) -> ServerMessage:
    """Decode a text of the signalling server. Raise ``MalformedFrame`` if it is not one of its messages."""
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
