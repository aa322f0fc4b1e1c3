"""An action by column says what the action by name says, or is not made."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.runtime.columns import by_axis, by_column

AXES = ("hip", "knee", "ankle")
NUMBERS = st.floats(allow_nan=False)
NAMES = st.lists(st.sampled_from(("q", "dq", "tau", "kp", "kd")), min_size=1, max_size=5, unique=True)


@given(names=NAMES, data=st.data())
def test_there_and_back_it_is_the_same(names: list[str], data: st.DataObject) -> None:
    action = {axis: {name: data.draw(NUMBERS) for name in names} for axis in AXES}
    columns = by_column(action)
    assert columns is not None
    assert [*columns] == names and {len(column) for column in columns.values()} == {3}
    assert by_axis(columns, AXES) == action


@pytest.mark.parametrize(
    "action",
    [
        {},
        {"hip": 1.0, "knee": 2.0},
        {"hip": {"q": 1.0}, "knee": 2.0},
        {"hip": {}, "knee": {}},
        {"hip": {"q": 1.0}, "knee": {"kp": 2.0}},
        {"hip": {"q": 1.0}, "knee": {"q": 1.0, "kp": 2.0}},
        {"hip": {"q": 1.0, "kp": 2.0}, "knee": {"q": 1.0}},
        {"hip": {"q": 1.0}, "knee": {"q": True}},
        {"hip": {"q": 1.0}, "knee": {"q": "0.1"}},
        {"hip": {"q": 1.0}, "knee": {"q": None}},
    ],
)
def test_any_other_action_stays_as_it_is(action: dict[str, Any]) -> None:
    assert by_column(action) is None


def test_a_column_of_another_length_names_no_axis_wrongly() -> None:
    columns = {"q": (1.0, 2.0), "kp": (3.0, 4.0, 5.0, 6.0)}
    assert by_axis(columns, AXES) == {"hip": {"q": 1.0, "kp": 3.0}, "knee": {"q": 2.0, "kp": 4.0}}
