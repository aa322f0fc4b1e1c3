"""A session proves that its owner has read the robot's clock. Each lease belongs to one session."""

from __future__ import annotations

import pytest

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.sessions import CLOCK_TTL_S, Sessions

SECOND = 10**9
ONE = "caller.one"


def code(answer: Refused | None) -> str:
    return "" if answer is None else answer.code


@pytest.mark.parametrize(
    ("deadline_s", "now_s", "expected"),
    [
        (1.0, 0.5, ""),
        (1.0, 1.0, "expired"),
        (1.0, 5.0, "expired"),
        (100.0, 0.5, "too_distant"),
        (31.0, 30.5, "clock"),
    ],
)
def test_saf_001_a_command_is_dated_by_a_reading_and_comes_in_time(
    deadline_s: float, now_s: float, expected: str
) -> None:
    sessions = Sessions()
    name = sessions.sync("", ONE, 0)
    assert code(sessions.refuse(name, ONE, round(deadline_s * SECOND), round(now_s * SECOND))) == expected


@pytest.mark.parametrize("name", ["", "0" * 32, "operator"])
def test_a_sender_that_has_not_read_the_clock_is_refused(name: str) -> None:
    sessions = Sessions()
    sessions.sync("", ONE, 0)
    assert code(sessions.refuse(name, ONE, SECOND, 0)) == "clock"


def test_a_session_goes_on_as_long_as_its_owner_reads() -> None:
    sessions, name = Sessions(), ""
    for at_s in (0, 20, 40):
        again = sessions.sync(name, ONE, at_s * SECOND)
        assert name in ("", again)
        name = again
    late_ns = round((40 + CLOCK_TTL_S) * SECOND)
    assert sessions.sync(name, ONE, late_ns) != name


def test_an_unissued_session_name_is_refused() -> None:
    """Otherwise a sender could choose a session name that it guessed."""
    sessions = Sessions()
    assert sessions.sync("mine", ONE, 0) != "mine"


def test_saf_017_a_session_is_of_the_name_that_opened_it() -> None:
    sessions = Sessions()
    name = sessions.sync("", ONE, 0)
    assert code(sessions.refuse(name, "caller.two", SECOND, 0)) == "clock"
    assert sessions.sync(name, "caller.two", 1) != name
    assert code(sessions.refuse(name, ONE, SECOND, 0)) == "", "its owner keeps it"


def test_saf_017_a_lease_is_of_the_session_that_was_given_it() -> None:
    sessions = Sessions()
    one, two = sessions.sync("", ONE, 0), sessions.sync("", ONE, 0)
    sessions.grant(one, 7)
    assert code(sessions.refuse_lease(one, 7)) == ""
    assert code(sessions.refuse_lease(two, 7)) == code(sessions.refuse_lease("", 7)) == "lease"
    sessions.sync(one, ONE, 1)
    assert code(sessions.refuse_lease(one, 7)) == "", "its owner keeps it"
    for lease in range(8, 40):
        sessions.grant(one, lease)
    assert code(sessions.refuse_lease(one, 39)) == ""
    assert code(sessions.refuse_lease(one, 7)) == "lease"


def test_sessions_are_bounded_and_the_longest_silent_one_is_dropped() -> None:
    sessions = Sessions()
    first, *others = [sessions.sync("", ONE, 0) for _ in range(200)]
    assert code(sessions.refuse(first, ONE, SECOND, 0)) == "clock"
    assert code(sessions.refuse(others[-1], ONE, SECOND, 0)) == ""
