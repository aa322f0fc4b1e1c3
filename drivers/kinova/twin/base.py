"""Simulate the base of a Gen3: answer the requests of its clients."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import Call, Frame, SubError

from .calls import READS, SETPOINTS, STOPS, Request, functions_of
from .controller import Controller
from .errors import CallFailed, ProtocolFailed
from .functions import CALLS, SERVICES
from .sessions import BaseSession


class Base(Controller):
    """The controller, as its clients see it."""

    def __init__(self, table: Mapping[str, Any], **options: Any) -> None:
        """Build the base. ``options`` are the keyword arguments of ``Controller``."""
        super().__init__(table, **options)
        self._functions = functions_of(self)

    def answer(self, connection: object, request: Frame) -> Frame:
        """Return the response to a request that arrived on ``connection``."""
        self.advance()
        session = request.session
        try:
            if request.call == Call.CREATE_SESSION:
                session, payload = self.sessions.create(connection, p.Login.decode(request.payload)), b""
            else:
                payload = self._call(self.sessions.of(connection, request), request)
        except MalformedFrame as malformed:
            return _failed(request, ProtocolFailed(SubError.PAYLOAD_DECODING_ERR, str(malformed)))
        except CallFailed as failed:
            return _failed(request, failed)
        return Frame(p.Kind.RESPONSE, request.call, request.message, session, payload, device=request.device)

    def kind(self, request: Frame) -> str:
        """Return the kind of a request as the log of received messages (wire log) names it: ``setpoint``,
        ``safe``, ``read``, and so on."""
        if request.call in STOPS:
            return "safe"
        if request.call == Call.SEND_JOINT_SPEEDS:
            return "setpoint" if self.driven or any(_speeds_of(request).values()) else "enable"
        if request.call == Call.KEEP_ALIVE:
            return "keepalive"
        if request.call in SETPOINTS:
            return "setpoint"
        return "read" if request.call in READS else "config"

    def _call(self, session: BaseSession, request: Frame) -> bytes:
        if request.call not in CALLS:
            has_service = request.call >> 16 in SERVICES
            raise ProtocolFailed(SubError.UNSUPPORTED_METHOD if has_service else SubError.UNSUPPORTED_SERVICE)
        harmless = self.kind(request) in ("read", "keepalive") or request.call == Call.CLOSE_SESSION
        if not harmless and not self.sessions.may_command(session):
            raise CallFailed(SubError.SESSION_NOT_IN_CONTROL)
        return self._functions[request.call](Request(request.payload, request.device, session))


def _failed(request: Frame, failed: CallFailed) -> Frame:
    error = (
        pb.varint_field(1, failed.code)
        + pb.varint_field(2, failed.sub_error)
        + pb.bytes_field(3, str(failed).encode())
    )
    return Frame(
        p.Kind.RESPONSE,
        request.call,
        request.message,
        request.session,
        error,
        failed.code,
        int(failed.sub_error),
        request.device,
    )


def _speeds_of(request: Frame) -> Mapping[int, float]:
    """Return the joint speeds in a request, by joint. Empty if the request cannot be decoded."""
    try:
        return p.decode_speeds(request.payload)
    except MalformedFrame:
        return {}
