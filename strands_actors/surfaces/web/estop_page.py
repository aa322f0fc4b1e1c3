"""The e-stop on an origin, a connection and a thread of its own, and without script.

A browser runs the pages of two origins in two processes. So a console page that is busy, or broken, does not block
this one. It works alone, too: a phone can keep its address as a bookmark.
"""

from __future__ import annotations

import html
from collections.abc import Callable
from importlib import resources

import trio
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from strands_actors.surfaces.mesh.outcome import SAFE, Outcome

Press = Callable[[], list[Outcome]]


def estop_app(press: Press) -> Starlette:
    """Return the application, without its ``Guard``.

    Args:
        press: Stops all robots, and returns the outcome of each. It is called in a thread.
    """

    async def form(request: Request) -> Response:
        return _page("")

    async def stop(request: Request) -> Response:
        # A browser that has closed the page does not cancel the stop.
        with trio.CancelScope(shield=True):
            outcomes = await trio.to_thread.run_sync(press)
        return _page(_result(outcomes))

    async def style(request: Request) -> Response:
        content = resources.files(__package__).joinpath("page", "estop.css").read_bytes()
        return Response(content, media_type="text/css")

    return Starlette(
        routes=[
            Route("/estop", form, methods=["GET"]),
            Route("/estop", stop, methods=["POST"]),
            Route("/estop.css", style, methods=["GET"]),
        ]
    )


def _page(result: str) -> Response:
    page = resources.files(__package__).joinpath("page", "estop.html").read_text("utf-8")
    return HTMLResponse(page.replace("{{result}}", result))


def _result(outcomes: list[Outcome]) -> str:
    """Return the outcomes as HTML. A robot that is not safe comes first."""
    if not outcomes:
        return '<p class="bad">NO ROBOT was reached. Cut the power if one moves.</p>'
    rows = []
    for outcome in sorted(outcomes, key=lambda each: (each.outcome == SAFE, each.robot)):
        is_safe = outcome.outcome == SAFE
        text = f"{outcome.safe_state}, {outcome.took_ms:.0f} ms" if is_safe else outcome.detail
        rows.append(
            f'<li class="{"good" if is_safe else "bad"}"><b>{html.escape(outcome.robot)}</b> '
            f"{html.escape(outcome.outcome)} <span>{html.escape(text)}</span></li>"
        )
    return f"<ul>{''.join(rows)}</ul>"
