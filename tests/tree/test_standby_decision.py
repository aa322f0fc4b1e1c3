"""SAF-016: the standby's actions for each state of root and wire. The tables are pure: no process, no
clock, no I/O.
"""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Timing
from strands_actors.supervisors.standby.decision import ACTIONS, Action, ProcessState, decide
from strands_actors.supervisors.standby.watch import START_S, Watched, look_s, silent_s

ARM = Timing(control_hz=30.0, keepalive_s=0.05)
LEGS = Timing(control_hz=500.0, keepalive_s=0.002, tick_s=0.002, heartbeat_ttl_s=0.02)
S = 1_000_000_000
BEGAN_NS = 50 * S


def test_every_combination_of_states_has_an_action() -> None:
    assert ACTIONS.keys() == set(product(ProcessState, ProcessState, (False, True)))


@pytest.mark.parametrize("energised", [False, True])
@pytest.mark.parametrize("other", ProcessState)
def test_saf_016_the_standby_waits_while_root_or_wire_runs(other: ProcessState, energised: bool) -> None:
    assert decide(ProcessState.RUNS, other, energised) is decide(other, ProcessState.RUNS, energised) is Action.WAIT


def test_saf_016_the_standby_writes_only_after_both_have_ended() -> None:
    writes = {sight for sight, action in ACTIONS.items() if action is Action.MAKE_SAFE}
    assert writes == {(ProcessState.ENDED, ProcessState.ENDED, True)}


def test_saf_016_a_robot_that_may_be_energised_is_made_safe_when_root_and_wire_do_not_run() -> None:
    for (root, wire, energised), action in ACTIONS.items():
        if energised and ProcessState.RUNS not in (root, wire):
            assert action in (Action.FENCE, Action.MAKE_SAFE)


def test_saf_016_a_fence_ends_silent_processes_and_is_followed_by_another_action() -> None:
    """After a fence both processes have ended, so no state is fenced for ever."""
    for (root, wire, energised), action in ACTIONS.items():
        if action is Action.FENCE:
            assert ProcessState.SILENT in (root, wire)
            assert decide(ProcessState.ENDED, ProcessState.ENDED, energised) is (
                Action.MAKE_SAFE if energised else Action.LEAVE
            )


class Rig:
    """One watched process, with a simulated clock."""

    def __init__(self, timing: Timing) -> None:
        self.now_ns = BEGAN_NS
        self._look_ns = round(look_s(timing) * S)
        self._watched = Watched(timing, began_ns=BEGAN_NS)

    def look(self, last_received_ns: int, ended: bool = False, may_be_silent_until_ns: int = 0) -> ProcessState:
        self.now_ns += self._look_ns
        return self._watched.see(self.now_ns, last_received_ns, ended, may_be_silent_until_ns)

    def silent_after_s(self, last_received_ns: int, within_s: float = 10.0) -> float:
        while self.look(last_received_ns) is not ProcessState.SILENT:
            assert self.now_ns < last_received_ns + within_s * S
        return (self.now_ns - last_received_ns) / S


@pytest.mark.parametrize("timing", [ARM, LEGS], ids=["arm", "legs"])
def test_a_process_counts_as_silent_within_the_published_time_and_not_before(timing: Timing) -> None:
    rig = Rig(timing)
    for _ in range(50):
        assert rig.look(rig.now_ns) is ProcessState.RUNS
    after_s = rig.silent_after_s(rig.now_ns)
    assert silent_s(timing) < after_s <= silent_s(timing) + 2 * look_s(timing)


def test_a_process_with_new_heartbeats_is_no_longer_silent() -> None:
    rig = Rig(ARM)
    rig.look(rig.now_ns)
    rig.silent_after_s(rig.now_ns)
    assert rig.look(rig.now_ns) is ProcessState.RUNS


def test_a_process_that_starts_gets_time_for_its_first_heartbeat() -> None:
    rig = Rig(ARM)
    while rig.now_ns < BEGAN_NS + (START_S - 0.1) * S:
        assert rig.look(0) is ProcessState.RUNS
    while rig.now_ns < BEGAN_NS + START_S * S:
        rig.look(0)
    assert rig.look(0) is ProcessState.SILENT


def test_an_announced_silence_of_a_wire_is_accepted_for_its_time() -> None:
    rig = Rig(ARM)
    last_received_ns = rig.now_ns
    until_ns = last_received_ns + 2 * S
    while rig.now_ns < until_ns - S // 10:
        assert rig.look(last_received_ns, may_be_silent_until_ns=until_ns) is ProcessState.RUNS
    assert rig.silent_after_s(last_received_ns) < 2.0 + silent_s(ARM)


def test_a_pause_of_the_whole_machine_is_not_a_silence() -> None:
    """The first look after the pause sees an old heartbeat, but the watched process is not frozen."""
    rig = Rig(ARM)
    last_received_ns = rig.now_ns
    rig.look(last_received_ns)
    rig.now_ns += 10 * S
    assert rig.look(last_received_ns) is ProcessState.RUNS
    assert rig.look(rig.now_ns) is ProcessState.RUNS


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=200))
def test_an_end_is_final_and_a_heartbeat_ends_a_silence(story: list[tuple[bool, bool]]) -> None:
    rig = Rig(ARM)
    for beats, ends in story:
        seen = rig.look(rig.now_ns if beats else 0, ended=ends)
        if ends:
            assert seen is ProcessState.ENDED
        elif beats:
            assert seen is ProcessState.RUNS
