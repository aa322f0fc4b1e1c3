"""Any invalid input from a model or a program is refused by name in bounded time. Its text is shown without
control characters for the terminal."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from strands_actors.contract.shown import closest, harmless, shown
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.actions import MAX_KEYS, plain, refuse_shape
from strands_actors.supervisors.mesh.schemas import Response
from strands_actors.surfaces.agents.approval import Request
from strands_actors.surfaces.agents.calls import MAX_INPUTS
from strands_actors.surfaces.mesh.outcome import outcome_of, result_of

from .test_calls import ARM, refused

ESCAPES = "arm\x1b]0;owned\x07\x1b[2J\r\u202egnp\x9b1m"


def nested(depth: int) -> Any:
    inner: Any = 1.0
    for _ in range(depth):
        inner = {"a": inner}
    return inner


BAD: dict[str, Any] = {
    "deep": nested(100_000),
    "a deep list": [[[[[[[[1]]]]]]]],
    "long": "x" * 10_000_000,
    "a number without end": 10**100_000,
    "a surrogate": "\ud800",
    "escapes": ESCAPES,
    "bytes": b"\xff" * 10_000_000,
}


@pytest.mark.parametrize("value", BAD.values(), ids=BAD.keys())
def test_any_value_is_shown_briefly_and_without_control_characters(value: Any) -> None:
    text = shown(value)
    assert len(text) <= 40 and text.isprintable()
    text.encode()


@pytest.mark.parametrize("value", BAD.values(), ids=BAD.keys())
def test_saf_014_a_tool_that_is_given_it_refuses(value: Any) -> None:
    key = value if isinstance(value, str) else "x"
    for given in (
        value,
        {"action": value},
        {"action": "move_to", key: 1},
        {"action": "move_to", "targets": [value]},
    ):
        refusal = refused(ARM, given)
        assert len(refusal.text) < 1000 and refusal.text.isprintable()
        refusal.text.encode()


def test_saf_014_a_tool_that_is_given_too_much_refuses() -> None:
    refusal = refused(ARM, {"action": "move_to"} | {f"x{number}": 1 for number in range(200_000)})
    assert str(MAX_INPUTS) in refusal.text


@pytest.mark.parametrize("value", BAD.values(), ids=BAD.keys())
def test_saf_014_an_action_with_it_can_be_sent_and_is_refused_by_name(value: Any) -> None:
    key = value if isinstance(value, str) else "a"
    sent = plain({key: value, "b": {key: value}})
    assert len(msgspec.msgpack.encode(sent)) < 10_000
    assert all(name.isprintable() for name in sent)


def test_saf_014_an_action_of_too_many_keys_is_refused() -> None:
    refusal = refuse_shape({f"x{number}": 1.0 for number in range(200_000)})
    assert isinstance(refusal, Refused) and str(MAX_KEYS) in refusal.text
    assert refuse_shape({f"x{number}": 1.0 for number in range(MAX_KEYS)}) is None


def test_a_too_long_name_is_unknown() -> None:
    assert closest("shoulder_pam", ["shoulder_pan"]) == ["shoulder_pan"]
    assert closest("x" * 10_000_000, ["shoulder_pan"]) == []


def test_readable_text_is_not_changed() -> None:
    for text in ("", "shoulder_pan", "Ellbogen über 3 °", "関節"):
        assert harmless(text) == text
    assert harmless("a\x1b[2Jb") == "a\\x1b[2Jb"
    assert harmless("\ud800") == "\\ud800"


def test_a_prompt_for_the_operator_moves_no_cursor() -> None:
    request = str(Request("so101", "move_to", {"targets": {ESCAPES: ESCAPES}, "name": ESCAPES}, ESCAPES))
    assert request.isprintable() and "owned" in request


def test_a_message_of_a_robot_moves_no_cursor() -> None:
    result = {"outcome": "no", "detail": ESCAPES, "safe_state": ESCAPES, "path": ESCAPES, "note": ESCAPES}
    outcome = outcome_of(ESCAPES, result)
    for text in (outcome.robot, outcome.detail, outcome.safe_state, outcome.path, outcome.note):
        assert text.isprintable() and "owned" in text
    refusal = result_of(Response("error", "so101", "1", 0.0, error=ESCAPES))
    assert isinstance(refusal, Refused) and refusal.text.isprintable()
