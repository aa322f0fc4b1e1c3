"""Key strokes from a terminal, which does not report the release of a key."""

from __future__ import annotations

import pytest

from strands_actors.teleoperation.keys import DEADMAN, DELAY_S, REPEAT_S, TAP_S, Keys

AXES = ("pan", "lift")


def test_a_tap_is_a_small_step_and_a_key_that_repeats_is_held_until_it_is_silent() -> None:
    keys = Keys(AXES)
    assert keys.press("q", 10.0)
    assert keys.hold(10.0 + TAP_S - 0.01) == (True, {"pan": 1.0})
    assert keys.hold(10.0 + TAP_S + 0.01) == (False, {})
    keys.press("q", 10.5)
    for repeat in range(10):
        assert keys.press("q", 10.53 + repeat * 0.03)
    assert keys.hold(10.8 + REPEAT_S - 0.01).held
    assert not keys.hold(10.8 + REPEAT_S + 0.01).held


def test_the_space_bar_bridges_the_delay_before_it_repeats() -> None:
    keys = Keys(())
    assert keys.press(DEADMAN, 1.0)
    assert keys.hold(1.0 + DELAY_S - 0.01).held
    keys.press(DEADMAN, 1.0 + DELAY_S - 0.1)
    assert not keys.hold(1.0 + DELAY_S - 0.1 + REPEAT_S + 0.01).held


def test_two_keys_of_one_axis_cancel_and_two_axes_move_together() -> None:
    keys = Keys(AXES)
    for key in ("q", "a", "s"):
        keys.press(key, 1.0)
    assert keys.hold(1.0) == (True, {"pan": 0.0, "lift": -1.0})
    keys.release()
    assert keys.hold(1.0) == (False, {})


@pytest.mark.parametrize("key", ["z", "1", "\x1b", DEADMAN])
def test_other_keys_mean_nothing(key: str) -> None:
    keys = Keys(AXES)
    assert not keys.press(key, 1.0)
    assert not keys.hold(1.0).held
