"""The failsafe table alone: properties that hold for every sequence of events."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from strands_actors.supervisors.gate.failsafe import (
    TRANSITIONS,
    Action,
    Event,
    Mode,
    State,
    step,
)

# Repeated here on purpose: a test that used the product's own sets would accept any change of them.
WRITABLE = {Mode.ARMED, Mode.HOLDING}
OVER = {Mode.ENDING, Mode.ENDED}

events = st.lists(st.tuples(st.sampled_from(Event), st.booleans()), max_size=40)


def play(sequence: list[tuple[Event, bool]]) -> list[tuple[State, Event, State, Action]]:
    state, seen = State(), []
    for event, lock in sequence:
        after, action = step(state, event, "op" if lock and event is Event.STOP else "")
        seen.append((state, event, after, action))
        state = after
    return seen


@given(events)
def test_saf_002_every_safe_order_and_every_arming_raises_the_epoch(
    sequence: list[tuple[Event, bool]],
) -> None:
    for before, _, after, action in play(sequence):
        assert after.epoch >= before.epoch
        if action is not Action.NONE:
            assert after.epoch == before.epoch + 1


@given(events)
def test_saf_008_only_a_resume_leads_to_armed(sequence: list[tuple[Event, bool]]) -> None:
    resumed = False
    for _, event, after, action in play(sequence):
        if event is Event.RESUME and action is Action.ARM:
            resumed = True
        if action is Action.MAKE_SAFE and after.mode is not Mode.HOLDING:
            resumed = False
        if event is Event.LINK_LOST:
            resumed = False
        assert after.mode not in WRITABLE or resumed


@given(events)
def test_saf_007_only_a_resume_lifts_a_lock(sequence: list[tuple[Event, bool]]) -> None:
    for before, event, after, action in play(sequence):
        if before.locked_by and not after.locked_by:
            assert event is Event.RESUME and action is Action.ARM
        if after.locked_by:
            assert after.mode not in WRITABLE


@given(events)
def test_a_stop_is_carried_out_in_every_mode(sequence: list[tuple[Event, bool]]) -> None:
    for _, event, after, action in play(sequence):
        if event is Event.STOP:
            assert action is Action.MAKE_SAFE
            assert after.mode not in WRITABLE


@given(events)
def test_saf_018_after_its_end_a_tree_arms_nothing(sequence: list[tuple[Event, bool]]) -> None:
    ended = False
    for before, event, after, action in play(sequence):
        if ended:
            assert action is not Action.ARM
            assert after.mode in OVER | {Mode.FAILED}
        if event is Event.END:
            ended = True
            assert action is Action.MAKE_SAFE or before.mode is Mode.ENDED, (
                "in ENDED the safe state is already confirmed"
            )


def test_a_robot_that_was_lost_while_energised_is_made_safe_before_anything_else() -> None:
    assert TRANSITIONS[Mode.LOST, Event.LINK_UP].action is Action.MAKE_SAFE
    assert TRANSITIONS[Mode.ENDING, Event.LINK_UP].action is Action.MAKE_SAFE
    assert {row.mode for (mode, _), row in TRANSITIONS.items() if mode is Mode.FAILED} == {Mode.FAILED}


# For each event: the next mode, and the modes in which the event leads there. In other modes it has no
# effect. Repeated here on purpose, so that a missing or wrong row of the table is noticed.
LEADS = {
    Event.LINK_UP: {"disarmed": "down", "stopping": "lost", "ending": "ending", "ended": "ended"},
    Event.LINK_LOST: {"down": "disarmed", "lost": "arming armed holding stopping unconfirmed"},
    Event.RESUME: {"arming": "disarmed unconfirmed"},
    Event.ARM_DONE: {"armed": "arming"},
    Event.ARM_FAILED: {"stopping": "arming"},
    Event.SETPOINT: {"armed": "armed holding"},
    Event.HOLD: {"lost": "lost", "holding": "armed"},
    Event.STOP: {
        "down": "down",
        "lost": "lost",
        "stopping": "disarmed arming armed holding stopping unconfirmed",
        "failed": "failed",
        "ending": "ending ended",
    },
    Event.END: {
        "ended": "down",
        "ending": "lost disarmed arming armed holding stopping unconfirmed ending",
        "failed": "failed",
    },
    Event.SAFE_CONFIRMED: {"disarmed": "stopping", "ended": "ending"},
    Event.SAFE_UNCONFIRMED: {"unconfirmed": "stopping"},
}
ALWAYS_SAFE = {Event.ARM_FAILED, Event.HOLD, Event.STOP, Event.END}


def test_saf_008_every_event_leads_to_the_expected_mode_and_action() -> None:
    expected = {
        (Mode(before), event): Mode(after)
        for event, leads in LEADS.items()
        for after, modes in leads.items()
        for before in modes.split()
    }
    assert {place: row.mode for place, row in TRANSITIONS.items()} == expected
    for (mode, event), row in TRANSITIONS.items():
        back = event is Event.LINK_UP and mode is not Mode.DOWN  # the state of the robot meanwhile is unknown
        makes_safe = event in ALWAYS_SAFE or back
        assert row.action is (
            Action.ARM if event is Event.RESUME else Action.MAKE_SAFE if makes_safe else Action.NONE
        )
        assert row.raises == (row.action is not Action.NONE or event is Event.LINK_LOST), (mode, event)
