"""Test a twin's options, as values or as text from a command line. Unknown ones are refused."""

from __future__ import annotations

import re

import pytest

from strands_actors.drivers.common.twin import read_twin_options
from strands_actors.drivers.spot.twin import SpotTwinOptions
from strands_actors.drivers.unitree.twin import UnitreeTwinOptions


@pytest.mark.parametrize("text", ["false", "False", "0"])
def test_a_bool_in_text_has_its_value(text: str) -> None:
    assert read_twin_options("spot", SpotTwinOptions, {"arm": text}).arm is False


def test_text_and_values_are_the_same_options() -> None:
    as_text = {"arm": "true", "skew_s": "-3.5", "port": "7000", "host": "127.0.0.9"}
    as_values = {"arm": True, "skew_s": -3.5, "port": 7000, "host": "127.0.0.9"}
    read = read_twin_options("spot", SpotTwinOptions, as_text)
    assert read == read_twin_options("spot", SpotTwinOptions, as_values) == SpotTwinOptions(**as_values)
    assert read_twin_options("unitree_g1", UnitreeTwinOptions, {"battery": "unknown"}).battery == "unknown"
    assert read_twin_options("unitree_g1", UnitreeTwinOptions, {"battery": "30"}).battery == 30


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"arm": "perhaps"}, "spot: arm is 'perhaps'. It is: whether it has one; default True"),
        ({"skew_s": "nan"}, "spot: skew_s is 'nan'. It is: seconds that its clock is ahead"),
        ({"skew_s": float("inf")}, "spot: skew_s is inf. It is: seconds that its clock is ahead"),
        ({"port": "70000"}, "spot: port is '70000'. It is: port to serve at; 0: any free one"),
        ({"tool_name": "x"}, "spot: unknown option tool_name"),
        (
            {"sink_s": "1"},
            "spot: unknown option sink_s ('sink_s' -> 'sync_s'?). "
            "Use host, port, skew_s, sync_s, arm, user, password, haste",
        ),
    ],
)
def test_an_unknown_option_is_refused_with_the_known_ones(given: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=re.escape(why)):
        read_twin_options("spot", SpotTwinOptions, given)
