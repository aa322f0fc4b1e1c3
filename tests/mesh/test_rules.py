"""The rules for commands, tested without a mesh: parsing, types, freshness and rate limits."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.gate.messages import Status as GateStatus
from strands_actors.supervisors.mesh.command_rules import (
    CLOCK_TTL_S,
    MISSING_ACTIONS,
    Clocks,
    Limit,
    read_command,
    read_envelope,
    refuse_stale,
)
from strands_actors.supervisors.mesh.lease_rules import refuse_by_mode
from strands_actors.supervisors.mesh.schemas import ACTIONS, MAX_COMMAND_BYTES, Command, Envelope, Move, Stop

MOVE = {
    "action": "move",
    "targets": {"a": 1},
    "lease": 1,
    "epoch": 2,
    "clock": "c",
    "deadline_ns": 5,
}


def enveloped(command: Any, **fields: Any) -> bytes:
    return json.dumps({"sender_id": "me", "turn_id": "1", "command": command, **fields}).encode()


def read(command: Any) -> Command | Refused:
    envelope = read_envelope(enveloped(command))
    assert isinstance(envelope, Envelope)
    return read_command(envelope)


def test_a_command_is_typed() -> None:
    move = read(MOVE)
    assert isinstance(move, Move)
    assert (move.targets, move.lease, move.epoch, move.latched) == ({"a": 1.0}, 1, 2, False)


def test_fields_of_other_meshes_around_a_command_are_ignored() -> None:
    envelope = read_envelope(enveloped({"action": "stop"}, timestamp=1.5, sig="abc", target_id="x"))
    assert isinstance(envelope, Envelope)
    assert read_command(envelope) == Stop()


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ({"action": "fly"}, "unknown_action"),
        ({"action": "MOVE"}, "unknown_action"),
        ({"action": ""}, "unknown_action"),
        ({"action": "call", "method": "stop"}, "not_here"),
        ({"action": "sim_call", "sim_action": "reset"}, "not_here"),
        ("stop", "malformed"),
        ({**MOVE, "targets": {}}, "malformed"),
        ({**MOVE, "targets": {"a": [1]}}, "malformed"),
        ({**MOVE, "targets": {str(n): 0 for n in range(65)}}, "malformed"),
        ({**MOVE, "deadline_ns": "soon"}, "malformed"),
        ({**MOVE, "latch": True}, "malformed"),  # a misspelt field is refused, not ignored
        ({**MOVE, "clock": "a/b"}, "malformed"),
        ({key: value for key, value in MOVE.items() if key != "deadline_ns"}, "malformed"),
    ],
)
def test_saf_014_an_invalid_command_is_refused_by_name(command: Any, code: str) -> None:
    refused = read(command)
    assert isinstance(refused, Refused)
    assert refused.code == code


@pytest.mark.parametrize("sender", ["", "a/b", "*", "**", "a*", "a b", "a\n", "é", "x" * 65])
def test_a_sender_with_an_invalid_name_gets_no_answer(sender: str) -> None:
    answer = read_envelope(
        json.dumps({"sender_id": sender, "turn_id": "1", "command": {"action": "stop"}}).encode()
    )
    assert isinstance(answer, tuple)
    assert answer[0] is None


def test_a_too_large_command_is_refused_to_its_sender() -> None:
    answer = read_envelope(enveloped({"action": "stop"}, padding="x" * MAX_COMMAND_BYTES))
    assert isinstance(answer, tuple)
    sender, refused = answer
    assert sender is not None and (sender.sender_id, refused.code) == ("me", "oversized")


@given(st.binary(max_size=200) | st.text().map(str.encode))
def test_saf_014_no_bytes_get_past_or_raise(payload: bytes) -> None:
    envelope = read_envelope(payload)
    if isinstance(envelope, Envelope):
        read_command(envelope)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from(sorted(ACTIONS)), st.dictionaries(st.sampled_from([*MOVE, "by", "x"]), json_values))
def test_saf_014_no_field_gets_past_or_raises(action: str, fields: dict[str, Any]) -> None:
    command = read({**fields, "action": action})
    assert isinstance(command, ACTIONS[action] | Refused)


# -- time


def refusal(clocks: Clocks, clock: str, deadline_ns: int, now_ns: int, sender: str = "me") -> str:
    refused = clocks.refuse(sender, clock, deadline_ns, now_ns)
    return "" if refused is None else refused.code


def test_saf_014_nothing_dated_is_obeyed_before_the_clock_was_read() -> None:
    clocks = Clocks()
    assert refusal(clocks, "", 20, 10) == "clock"
    assert refusal(clocks, "guess", 20, 10) == "clock"
    name = clocks.read("me", 10)
    assert refusal(clocks, name, 20, 11) == ""
    assert refusal(clocks, name, 20, 11, sender="other") == "clock"
    assert refusal(clocks, clocks.read("other", 10), 20, 11) == "clock"


def test_saf_001_a_command_past_its_deadline_or_too_far_ahead_is_refused() -> None:
    clocks = Clocks()
    name = clocks.read("me", 0)
    assert refusal(clocks, name, 100, 99) == ""
    assert refusal(clocks, name, 100, 100) == "expired"
    assert refusal(clocks, name, 11 * 10**9, 100) == "too_distant"


def test_a_reading_of_the_clock_ages() -> None:
    clocks = Clocks()
    name = clocks.read("me", 0)
    late_ns = round(CLOCK_TTL_S * 1e9)
    assert refusal(clocks, name, late_ns + 5, late_ns - 1) == ""
    assert refusal(clocks, name, late_ns + 5, late_ns) == "clock"


def test_many_senders_do_not_fill_the_memory() -> None:
    clocks = Clocks()
    names = [clocks.read(f"s{number}", 0) for number in range(1000)]
    assert refusal(clocks, names[0], 20, 10, "s0") == "clock"
    assert refusal(clocks, names[-1], 20, 10, "s999") == ""
    assert len(clocks._read) <= 64


def test_a_stop_needs_no_date() -> None:
    assert refuse_stale(Clocks(), "me", Stop(), 10) is None


@given(st.lists(st.integers(0, 10**8), max_size=300))
def test_a_rate_limit_holds_at_any_times(gaps_ns: list[int]) -> None:
    limit, now_ns, admitted = Limit(20.0, 5), 1, []
    for gap_ns in gaps_ns:
        now_ns += gap_ns
        if limit.admits(now_ns):
            admitted.append(now_ns)
    for start, first_ns in enumerate(admitted):
        within = [at_ns for at_ns in admitted[start:] if at_ns < first_ns + 10**9]
        assert len(within) <= 25


@pytest.mark.parametrize("action", sorted(MISSING_ACTIONS.keys() - ACTIONS.keys()))
def test_an_action_of_other_meshes_is_refused_with_an_alternative(action: str) -> None:
    refused = read({"action": action})
    assert isinstance(refused, Refused)
    assert refused.code == "not_here"
    assert "is not available: " in refused.reason and refused.remedy


@pytest.mark.parametrize(
    ("lapse", "holder", "code"),
    [
        (Lapse.LEASE_RELEASED, "", ""),
        (Lapse.ROLLOUT_ENDED, "", ""),
        (Lapse.ROLLOUT_ENDED, "so101 (7)", "holding"),
        (Lapse.NONE, "so101 (7)", "holding"),
        (Lapse.NONE, "", "holding"),
        (Lapse.EXPIRED, "", "holding"),
    ],
)
@pytest.mark.parametrize("cause", ["the writer gave its lease back", "so101 ended", "another sentence"])
def test_a_hold_needs_a_resume_unless_all_leases_were_given_back(
    lapse: Lapse, holder: str, code: str, cause: str
) -> None:
    """The decision does not depend on the text for people."""
    status = GateStatus("holding", 4, True, "", "", cause, holder, None, -1.0, (), 0, 0, 0, "", None, lapse=lapse)
    refused = refuse_by_mode(status, resumed_epoch=2)
    assert (refused.code if refused else "") == code
    assert refuse_by_mode(status, resumed_epoch=4) is None
