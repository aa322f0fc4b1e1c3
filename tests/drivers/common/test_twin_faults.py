"""Test the faults of a twin, with PX4's names: the effect of each on a reply, on any wire."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.twin import Fault, Faults, Reply, parse_fault
from strands_actors.drivers.common.twin.faults import damaged
from strands_actors.drivers.feetech import protocol as p


def reply(unit: int | None = 1) -> Reply:
    return Reply(0.0005, b"\xff\xff\x01\x02\x00\xfc", unit)


@pytest.mark.parametrize("word", list(Fault))
def test_every_fault_can_be_set_for_all_motors_or_one(word: Fault) -> None:
    assert parse_fault(word) == (word, None)
    assert parse_fault(f"{word}:12") == (word, 12)


@pytest.mark.parametrize("text", ["", "broken", "off:", "off:one", ":3"])
def test_another_word_is_refused_with_the_words_there_are(text: str) -> None:
    with pytest.raises(ValueError, match="intermittent"):
        parse_fault(text)


def test_a_fault_is_of_one_unit_or_of_all() -> None:
    faults = Faults()
    faults.set(Fault.OFF, 2)
    assert [faults.of(unit) for unit in (1, 2, None)] == [Fault.OK, Fault.OFF, Fault.OK]
    faults.set(Fault.SLOW)
    assert [faults.of(unit) for unit in (1, 2, None)] == [Fault.SLOW] * 3
    faults.set(Fault.OK, 1)
    assert [faults.of(unit) for unit in (1, 2, None)] == [Fault.OK, Fault.SLOW, Fault.SLOW]


@pytest.mark.parametrize("word", [Fault.OK, Fault.STUCK, Fault.WRONG])
def test_faults_of_the_robot_do_not_change_the_reply(word: Fault) -> None:
    faults = Faults()
    faults.set(word)
    assert faults.apply(reply()) == reply()


@pytest.mark.parametrize("word", [Fault.OFF, Fault.HALF_OPEN])
def test_off_and_half_open_are_silent(word: Fault) -> None:
    faults = Faults()
    faults.set(word, 1)
    assert faults.apply(reply(1)) is None
    assert faults.apply(reply(2)) == reply(2)


def test_slow_holds_up_the_wire_and_delayed_does_not() -> None:
    faults = Faults()
    faults.set(Fault.SLOW)
    slow = faults.apply(reply())
    assert slow is not None
    assert 0.0025 <= slow.delay_s < 0.004
    assert slow.late_s == 0
    faults.set(Fault.DELAYED)
    delayed = faults.apply(reply())
    assert delayed == reply()._replace(late_s=0.06)


def test_intermittent_loses_every_third_of_each_unit() -> None:
    faults = Faults()
    faults.set(Fault.INTERMITTENT)
    received = [(faults.apply(reply(1)) is not None, faults.apply(reply(2)) is not None) for _ in range(6)]
    assert received == [(True, True), (True, True), (False, False)] * 2


def test_garbage_is_never_the_reply_and_never_a_frame() -> None:
    faults = Faults()
    faults.set(Fault.GARBAGE)
    for _ in range(9):
        bad = faults.apply(reply())
        assert bad is not None
        assert bad.data != reply().data
        assert list(p.Decoder().feed(bad.data)) == []


@given(st.binary(min_size=1, max_size=80), st.integers(0, 100))
def test_damage_always_changes_the_bytes(data: bytes, count: int) -> None:
    assert damaged(data, count) != data
