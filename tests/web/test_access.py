"""Which requests of a browser are allowed."""

from __future__ import annotations

import itertools

import pytest

from strands_actors.surfaces.web.access import (
    CODE_S,
    MOST_SESSIONS,
    MOST_WRONG_CODES,
    Access,
    Denied,
    Role,
    Session,
    Visit,
)

HOST = "127.0.0.1:8390"
ORIGIN = f"http://{HOST}"


@pytest.fixture
def access() -> Access:
    secrets, codes = (f"secret{number}" for number in itertools.count()), map(str, itertools.count(1000))
    access = Access("console", lambda: next(secrets), lambda: next(codes))
    access.serve_at([HOST])
    return access


def let_in(access: Access) -> str:
    secret = access.admit(access.token, "a browser", 0.0)
    assert isinstance(secret, str)
    return f"console={secret}"


def visit(
    cookie: str = "", method: str = "GET", origin: str = "", host: str = HOST, is_websocket: bool = False
) -> Visit:
    return Visit(method, "http", host, origin, cookie, is_websocket)


def status(found: Session | Denied) -> int:
    return found.status if isinstance(found, Denied) else 200


@pytest.mark.parametrize(
    ("method", "origin", "host", "is_websocket", "expected"),
    [
        ("GET", "", HOST, False, 200),
        ("GET", "http://evil.example", HOST, False, 200),  # a link of another page; it can read nothing
        ("GET", "", "evil.example:8390", False, 421),
        ("GET", "", "", False, 421),
        ("POST", ORIGIN, HOST, False, 200),
        ("POST", "", HOST, False, 403),
        ("POST", "null", HOST, False, 403),
        ("POST", "http://evil.example", HOST, False, 403),
        ("POST", "http://127.0.0.1:8391", HOST, False, 403),
        ("POST", f"https://{HOST}", HOST, False, 403),
        ("GET", ORIGIN, HOST, True, 200),
        ("GET", "http://evil.example", HOST, True, 403),
        ("GET", "", HOST, True, 403),
    ],
)
def test_a_request_of_another_page_or_for_another_host_is_refused(
    access: Access, method: str, origin: str, host: str, is_websocket: bool, expected: int
) -> None:
    cookie = let_in(access)
    assert status(access.session_of(visit(cookie, method, origin, host, is_websocket))) == expected


@pytest.mark.parametrize(
    "cookie", ["", "console=", "console=secret9", "other=secret1", "console=secret1x", "=;;\0"]
)
def test_a_browser_without_the_secret_is_refused(access: Access, cookie: str) -> None:
    let_in(access)
    assert status(access.session_of(visit(cookie))) == 403


def test_a_wrong_token_lets_nobody_in(access: Access) -> None:
    for token in ("", access.token + "x", access.token[:-1], "ä"):
        assert isinstance(access.admit(token, "a browser", 0.0), Denied)
    assert access.sessions() == []


def test_a_code_works_once_and_gives_its_role(access: Access) -> None:
    code = access.offer(Role.VIEWER, 0.0)
    secret = access.redeem(f" {code[:2]} {code[2:]} ", "a phone", CODE_S - 1)
    found = access.session_of(visit(f"console={secret}"))
    assert isinstance(found, Session) and found.role is Role.VIEWER and found.device == "a phone"
    assert isinstance(access.redeem(code, "a thief", CODE_S - 1), Denied)


def test_a_code_ends_with_its_time(access: Access) -> None:
    code = access.offer(Role.OPERATOR, 0.0)
    assert isinstance(access.redeem(code, "late", CODE_S + 1), Denied)


def test_codes_cannot_be_tried_out(access: Access) -> None:
    code = access.offer(Role.OPERATOR, 0.0)
    for guess in range(MOST_WRONG_CODES):
        access.redeem(f"guess {guess}", "a thief", 1.0)
    assert isinstance(access.redeem(code, "a phone", 1.0), Denied)
    assert isinstance(access.redeem(access.offer(Role.OPERATOR, 2.0), "a phone", 2.0), str), "a new one works"


def test_a_device_that_was_sent_away_is_out(access: Access) -> None:
    cookie = let_in(access)
    (session,) = access.sessions()
    assert access.holds(session) and access.revoke(session.id) and not access.revoke(session.id)
    assert status(access.session_of(visit(cookie))) == 403 and not access.holds(session)


def test_the_oldest_session_ends_when_there_are_too_many(access: Access) -> None:
    first, second, *_ = [let_in(access) for _ in range(MOST_SESSIONS + 1)]
    assert status(access.session_of(visit(first))) == 403
    assert status(access.session_of(visit(second))) == 200
