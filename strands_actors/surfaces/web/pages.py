"""The files of the pages, and how a browser is let in. The console and the page of an operator share them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from .access import Access, Denied
from .answers import text
from .guard import visit_of

MAX_DEVICE = 80
TYPES = {".css": "text/css", ".js": "text/javascript"}
"""The types of the pages' files. No other file is ever served."""

_FOLDER = resources.files(__package__).joinpath("page")
_FILES = frozenset(file.name for file in _FOLDER.iterdir() if Path(file.name).suffix in TYPES)


async def serve_file(request: Request) -> Response:
    """Return a file of the pages: a style or a script."""
    file = request.path_params["file"]
    if file not in _FILES:
        return text(404, "There is no such file.")
    content = _FOLDER.joinpath(file).read_bytes()
    # The vendor's file is large, and changes only with a new version of this package.
    cached = {"Cache-Control": "private, max-age=3600"} if file == "vendor.js" else None
    return Response(content, media_type=TYPES[Path(file).suffix], headers=cached)


def page_of(file: str, **values: str) -> HTMLResponse:
    """Return a page, with values in place of their names in double braces."""
    page = _FOLDER.joinpath(file).read_text("utf-8")
    for name, value in values.items():
        page = page.replace(f"{{{{{name}}}}}", value)
    return HTMLResponse(page)


def as_attribute(facts: dict[str, Any]) -> str:
    """Return facts as JSON for an attribute in double quotes."""
    encoded = msgspec.json.encode(facts).decode()
    return encoded.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")


def let_in(access: Access, request: Request, secret: str, path: str = "/") -> Response:
    """Return the answer that gives a browser its session, and leads it to a path.

    A browser sends no strict cookie after a link of another site and a redirect. So a page leads on.
    """
    response = HTMLResponse(
        f'<!doctype html><meta http-equiv="refresh" content="0;url={path}"><p><a href="{path}">go on</a>'
    )
    secure = visit_of(request.scope).scheme == "https"
    response.set_cookie(access.cookie, secret, httponly=True, samesite="strict", secure=secure)
    return response


def device_of(request: Request) -> str:
    """Return a browser's own description, for people."""
    return request.headers.get("user-agent", "a browser")[:MAX_DEVICE]


def as_denied(denied: Denied) -> Response:
    """Return a refusal as an answer."""
    return text(denied.status, denied.text)
