"""What all orders of the console share: reading a request, checking the visitor's role, and the answer as JSON."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import Response

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import is_name
from strands_actors.surfaces.mesh.outcome import SAFE, Outcome

from .access import Role, Session

MAX_BODY = 16 * 1024


class Bad(Exception):
    """A request cannot be carried out. The text has the reason for the person."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


def order(
    carry_out: Callable[[Request, Session], Awaitable[Any]], role: Role
) -> Callable[[Request], Awaitable[Response]]:
    """Return a handler of requests that checks the visitor's role, and answers with JSON.

    Args:
        carry_out: Carries the order out, and returns the answer. It raises ``Bad`` if it cannot.
        role: The role that a visitor needs.
    """

    async def handle(request: Request) -> Response:
        session: Session = request.state.session
        if role is Role.OPERATOR and session.role is not Role.OPERATOR:
            return text(403, "This device may look and stop. Only an operator may do this.")
        try:
            return json(await carry_out(request, session))
        except Bad as bad:
            return text(bad.status, str(bad))

    return handle


def robot_of(request: Request) -> str:
    """Return the robot in a request's path. Raise ``Bad`` if it is no name of a robot."""
    robot: str = request.path_params["robot"]
    if not is_name(robot):
        raise Bad(404, "This is not the name of a robot.")
    return robot


def sender(session: Session) -> str:
    """Return the name under which a session's orders reach a robot."""
    return f"console {session.id}"


async def read(request: Request) -> bytes:
    """Return the body of a request. Raise ``Bad`` if it is too long."""
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > MAX_BODY:
            raise Bad(413, f"A request may have {MAX_BODY} bytes.")
    return data


async def body(request: Request, kind: type[Any]) -> Any:
    """Return the body of a request. Raise ``Bad`` if it is not of this kind."""
    data = await read(request)
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise Bad(400, f"The request cannot be read: {error}.") from None


def of_outcome(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome of a stop as an answer."""
    return {"ok": outcome.outcome == SAFE, "outcome": outcome}


def of_answer(answer: dict[str, Any] | Refused) -> dict[str, Any]:
    """Return a robot's answer as the answer to the page."""
    if isinstance(answer, Refused):
        return {"ok": False, "refused": {"code": answer.code, "text": answer.text}}
    return {"ok": True, "result": answer}


def json(value: Any) -> Response:
    """Return a value as JSON."""
    return Response(msgspec.json.encode(value), media_type="application/json")


def text(status: int, words: str) -> Response:
    """Return a text for the person, with the status of a failure."""
    return Response(words, status, media_type="text/plain")
