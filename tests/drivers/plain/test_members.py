"""Test how a class declares its axes, and how its answers are interpreted."""

from __future__ import annotations

import math
from typing import Any

import numpy
import pytest

from strands_actors.drivers.plain.members import (
    LONGEST_ROW,
    MOST_FIELDS,
    declared_by,
    failure_of,
    keys_of,
    number,
    rows_of,
)


class Says:
    def __init__(self, **members: Any) -> None:
        self.__dict__.update(members)


def test_axes_are_those_of_the_features_without_pictures() -> None:
    features = {"pan.pos": float, "x.vel": float, "front": (480, 640, 3)}
    assert declared_by(Says(action_features=features), "Arm").keys == ("pan.pos", "x.vel")
    assert declared_by(Says(action_features=["a", "b"]), "Arm").keys == ("a", "b")


@pytest.mark.parametrize(
    ("member", "given"),
    [("action_limits", {"Lift": (0, 1)}), ("action_speeds", {"lft": 1}), ("action_units", {"x": "m"})],
)
def test_limits_of_an_unknown_axis_are_refused(member: str, given: dict[str, Any]) -> None:
    """A misspelt limit would limit nothing."""
    (key,) = given
    with pytest.raises(
        ValueError, match=rf"Arm\.{member} names '{key}', which is no axis\. Use one of pan\.pos, lift"
    ):
        declared_by(Says(action_features=["pan.pos", "lift"], **{member: given}), "Arm")


def test_a_limit_may_be_of_an_axis_by_either_name() -> None:
    limits = {"pan": (-1, 1), "lift": (0, 1)}
    assert declared_by(Says(action_features=["pan.pos", "lift"], action_limits=limits), "Arm").limits == limits


def test_units_are_a_word_or_a_mapping() -> None:
    with pytest.raises(ValueError, match=r"Arm\.action_units is"):
        declared_by(Says(action_features=["pan"], action_units=["deg"]), "Arm")


def test_a_property_of_a_class_is_read_from_an_object() -> None:
    class Lazy:
        @property
        def action_features(self) -> dict[str, type]:
            return {"pan": float}

    assert declared_by(Lazy, "Lazy").keys == ()
    assert declared_by(Lazy(), "Lazy").keys == ("pan",)


@pytest.mark.parametrize(
    ("members", "text"),
    [
        (
            {"action_features": "pan"},
            "Arm.action_features is 'pan'. Give a mapping with the keys, or a list of keys",
        ),
        ({"action_features": {1: float}}, "Arm.action_features has the key 1. Give keys that are text"),
        ({"action_limits": 5}, "Arm.action_limits is 5. Give a mapping of keys"),
        ({"action_limits": {"pan": (1.0, -1.0)}}, r"Arm.action_limits\['pan'\] is \(1.0, -1.0\)"),
        ({"action_limits": {"pan": (-math.inf, 1.0)}}, "Give two finite numbers"),
        ({"action_speeds": {"pan": 0.0}}, "Give a finite number above 0"),
        ({"action_lifetime_s": True}, "Arm.action_lifetime_s is True"),
        ({"control_hz": 1000}, "Arm.control_hz is 1000. Give at most 250"),
    ],
)
def test_saf_014_a_wrong_declaration_is_refused(members: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        declared_by(Says(**members), "Arm")


def test_of_an_observation_positions_are_axes_else_every_number() -> None:
    assert keys_of({"a.pos": 1.0, "a.vel": 2.0, "temperature": 40}) == ("a.pos",)
    assert keys_of({"x": 1, "y": numpy.float32(2.0), "on": True, "name": "arm", "picture": [1]}) == ("x", "y")
    assert keys_of({"x": math.nan}) == ()


def test_numbers_of_any_library_are_numbers() -> None:
    assert (number(numpy.int64(3)), number(numpy.float32(0.5)), number(numpy.bool_(True))) == (3.0, 0.5, None)


@pytest.mark.parametrize(
    ("answer", "failure"),
    [
        (None, ""),
        (True, ""),
        (False, "it returned False"),
        ("done", ""),
        ({"status": "success", "content": [{"json": {"stopped": True}}]}, ""),
        ({"status": "success", "content": [{"json": {"stopped": False, "reason": "busy"}}]}, "busy"),
        ({"status": "error", "content": [{"text": "move: no. yes"}]}, "move: no. yes"),
        ({"status": "error", "content": [{"json": {"stopped": False, "reason": "hangs"}}]}, "hangs"),
        ({"status": "error"}, "it returned an error"),
        ({"status": "error", "content": 7}, "it returned an error"),
    ],
)
def test_an_answer_is_a_success_unless_it_has_an_error(answer: Any, failure: str) -> None:
    assert failure_of(answer) == failure


def test_a_sensors_record_becomes_rows_of_numbers() -> None:
    record = {
        "rpy": numpy.zeros(3),
        "x": numpy.float32(0.5),
        "frame": "map",
        "on": True,
        "grid": [[1.0]],
        "none": None,
    }
    assert rows_of("pose", record) == {"pose.rpy": (0.0, 0.0, 0.0), "pose.x": (0.5,)}
    assert rows_of("battery", 12) == {"battery.pct": (12.0,)}
    for no_record in (None, 3, "x", [1.0], numpy.zeros((4, 4)), {"x": math.nan}, {"x": [0.0] * (LONGEST_ROW + 1)}):
        assert rows_of("imu", no_record) == {}
    assert len(rows_of("imu", {str(at): at for at in range(1000)})) == MOST_FIELDS
