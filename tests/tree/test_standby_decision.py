"""SAF-016: what the standby does, by what it sees. Tables and pure machines: no process, no clock,
no I/O."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Timing
from strands_actors.supervisors.standby.decision import ACTIONS, Action, Seen, decide
from strands_actors.supervisors.standby.watch import START_S, Watched, look_s, silent_s

ARM = Timing(control_hz=30.0, keepalive_s=0.05)
LEGS = Timing(control_hz=500.0, keepalive_s=0.002, tick_s=0.002, heartbeat_ttl_s=0.02)
S = 1_000_000_000
BEGAN_NS = 50 * S


def test_every_sight_has_an_action() -> None:
    assert ACTIONS.keys() == set(product(Seen, Seen, (False, True)))


@pytest.mark.parametrize("owed", [False, True])
@pytest.mark.parametrize("other", Seen)
def test_saf_016_whoever_of_the_two_runs_is_left_alone(other: Seen, owed: bool) -> None:
    assert decide(Seen.RUNS, other, owed) is decide(other, Seen.RUNS, owed) is Action.WAIT


def test_saf_016_it_writes_when_both_have_ended_and_never_before() -> None:
    writes = {sight for sight, action in ACTIONS.items() if action is Action.MAKE_SAFE}
    assert writes == {(Seen.ENDED, Seen.ENDED, True)}


def test_saf_016_what_may_be_energised_is_never_left_to_nobody() -> None:
    for (root, wire, owed), action in ACTIONS.items():
        if owed and Seen.RUNS not in (root, wire):
            assert action in (Action.FENCE, Action.MAKE_SAFE)


def test_saf_016_a_fence_ends_what_is_silent_and_leads_to_an_end() -> None:
    """After it both have ended: there is no sight that is fenced for ever."""
    for (root, wire, owed), action in ACTIONS.items():
        if action is Action.FENCE:
            assert Seen.SILENT in (root, wire)
            assert decide(Seen.ENDED, Seen.ENDED, owed) is (Action.MAKE_SAFE if owed else Action.LEAVE)


class Rig:
    """One watched process, and a clock that is told to it."""

    def __init__(self, timing: Timing) -> None:
        self.now_ns = BEGAN_NS
        self._look_ns = round(look_s(timing) * S)
        self._watched = Watched(timing, began_ns=BEGAN_NS)

    def look(self, heard_ns: int, ended: bool = False, may_be_silent_until_ns: int = 0) -> Seen:
        self.now_ns += self._look_ns
        return self._watched.see(self.now_ns, heard_ns, ended, may_be_silent_until_ns)

    def silent_after_s(self, heard_ns: int, within_s: float = 10.0) -> float:
        while self.look(heard_ns) is not Seen.SILENT:
            assert self.now_ns < heard_ns + within_s * S
        return (self.now_ns - heard_ns) / S


@pytest.mark.parametrize("timing", [ARM, LEGS], ids=["arm", "legs"])
def test_a_process_counts_as_silent_within_the_published_time_and_not_before(timing: Timing) -> None:
    rig = Rig(timing)
    for _ in range(50):
        assert rig.look(rig.now_ns) is Seen.RUNS
    after_s = rig.silent_after_s(rig.now_ns)
    assert silent_s(timing) < after_s <= silent_s(timing) + 2 * look_s(timing)


def test_one_that_goes_on_is_no_longer_silent() -> None:
    rig = Rig(ARM)
    rig.look(rig.now_ns)
    rig.silent_after_s(rig.now_ns)
    assert rig.look(rig.now_ns) is Seen.RUNS


def test_one_that_begins_has_time_to() -> None:
    rig = Rig(ARM)
    while rig.now_ns < BEGAN_NS + (START_S - 0.1) * S:
        assert rig.look(0) is Seen.RUNS
    while rig.now_ns < BEGAN_NS + START_S * S:
        rig.look(0)
    assert rig.look(0) is Seen.SILENT


def test_an_sdk_may_keep_a_wire_silent_for_as_long_as_it_said() -> None:
    rig = Rig(ARM)
    heard_ns = rig.now_ns
    until_ns = heard_ns + 2 * S
    while rig.now_ns < until_ns - S // 10:
        assert rig.look(heard_ns, may_be_silent_until_ns=until_ns) is Seen.RUNS
    assert rig.silent_after_s(heard_ns) < 2.0 + silent_s(ARM)


def test_a_pause_of_the_whole_machine_is_no_silence() -> None:
    """Nobody looked: the first look after it sees an old heartbeat, and that is no freeze."""
    rig = Rig(ARM)
    heard_ns = rig.now_ns
    rig.look(heard_ns)
    rig.now_ns += 10 * S
    assert rig.look(heard_ns) is Seen.RUNS
    assert rig.look(rig.now_ns) is Seen.RUNS


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=200))
def test_an_end_is_for_ever_and_a_heartbeat_revives(story: list[tuple[bool, bool]]) -> None:
    rig = Rig(ARM)
    for beats, ends in story:
        seen = rig.look(rig.now_ns if beats else 0, ended=ends)
        if ends:
            assert seen is Seen.ENDED
        elif beats:
            assert seen is Seen.RUNS
