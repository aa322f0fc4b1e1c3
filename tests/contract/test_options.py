"""Test the conversion of constructor keywords into a struct."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest

from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options, secrets_of


class Options(DriverOptions, frozen=True):
    baud: Annotated[Literal[1_000_000, 500_000], option("speed of the bus")] = 1_000_000
    timeout_s: Annotated[float, option("longest wait for an answer", gt=0, le=60)] = 10.0
    retries: Annotated[int, option("how often it is asked again", ge=0)] = 1
    activate: Annotated[bool, option("whether connecting may move")] = True
    signs: Annotated[tuple[float, float], option("direction of each joint")] = (1.0, 1.0)
    offset: Annotated[float, option("added to each reading")] = 0.0


def test_defaults_and_values() -> None:
    assert read_options("r", Options, {}) == Options()
    read = read_options("r", Options, {"timeout_s": 3, "signs": (1, -1), "tool_name": "left"})
    assert plain(read) == {
        "baud": 1_000_000,
        "timeout_s": 3.0,
        "retries": 1,
        "activate": True,
        "signs": (1.0, -1.0),
        "offset": 0.0,
    }
    assert read_options("r", Options, plain(read)) == read


def test_every_keyword_has_a_description() -> None:
    assert meanings(Options)["timeout_s"] == "longest wait for an answer; default 10.0"
    assert set(meanings(Options)) == {"baud", "timeout_s", "retries", "activate", "signs", "offset"}


def test_an_unknown_keyword_names_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"r: unknown option bau \('bau' -> 'baud'\?\)\. Use baud, timeout_s"):
        read_options("r", Options, {"bau": 1})
    with pytest.raises(TypeError, match="This robot takes no options"):
        read_options("r", DriverOptions, {"baud": 1})


@pytest.mark.parametrize(
    "given",
    [
        {"baud": 9600},
        {"timeout_s": 0},
        {"timeout_s": True},
        {"timeout_s": float("nan")},
        {"timeout_s": "3"},
        {"retries": True},
        {"retries": 2.5},
        {"activate": 1},
        {"signs": (1.0,)},
        {"offset": float("inf")},
    ],
)
def test_saf_014_a_bad_value_is_refused_with_the_accepted_values(given: dict[str, Any]) -> None:
    (name,) = given
    with pytest.raises(ValueError, match=rf"^r: {name} is .*It is: ") as refused:
        read_options("r", Options, given)
    assert ("500000" in str(refused.value)) or name != "baud", "the choices of a literal are named"


class Login(DriverOptions, frozen=True):
    username: Annotated[str, option("user")] = "admin"
    password: Annotated[str, option("theirs", secret=True)] = "admin"


def test_a_secret_is_known_by_name_and_in_no_refusal() -> None:
    assert secrets_of(Login) == {"password"} and secrets_of(Options) == frozenset()
    with pytest.raises(ValueError, match="r: password is not accepted") as refusal:
        read_options("r", Login, {"password": 73571})
    assert "73571" not in str(refusal.value)
    with pytest.raises(ValueError, match="r: username is 73571"):
        read_options("r", Login, {"username": 73571})
