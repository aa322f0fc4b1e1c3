"""``Robot(...)`` before anything is started: what it refuses, in which words, and the registry behind it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from serial.tools import list_ports

from strands_actors import Robot, drivers
from strands_actors.drivers import (
    list_driver_coverage,
    list_native_drivers,
    missing_driver_members,
    register_native_driver,
)
from strands_actors.drivers.feetech.driver import Feetech

PORT = {"mode": "real", "port": "/dev/ttyACM0"}

REFUSALS: list[tuple[str, dict[str, Any], tuple[str, ...]]] = [
    ("so10", PORT, ("'so10' is not known", "Did you mean: so10", "list_driver_coverage()")),
    ("toaster", PORT, ("'toaster' is not known", "list_driver_coverage()")),
    ("so101_leader", PORT, ("so101_leader is a teleoperator", "Teleoperator('so101_leader', port=...)")),
    ("ability_hand", PORT, ("ability_hand has no native driver", "hope_jr", "so100, so101")),
    (
        "so101",
        {"mode": "real", "prot": "x"},
        ("no 'prot'", "'prot' -> 'port'", "Feetech", "baud, calibration, port"),
    ),
    (
        "so101",
        {**PORT, "wheels": 4},
        ("no 'wheels'", "it takes baud, calibration, port, require_drill, tool_name, transport"),
    ),
    ("so101", {**PORT, "transport": "smoke"}, ("no transport 'smoke'", "it offers twin")),
    ("so101", {**PORT, "tool_name": "my arm"}, ("tool_name is 'my arm'", "1 to 64 of A-Z a-z 0-9 _ -")),
    ("so101", {**PORT, "tool_name": "a" * 65}, ("tool_name is",)),
    ("so101", {**PORT, "tool_name": ""}, ("tool_name is ''",)),
    ("so101", {**PORT, "tool_name": "arm\n"}, ("tool_name is",)),
    ("so101", {"mode": "dream", "port": "x"}, ("mode 'dream'", "mode='real'")),
    ("so101", {**PORT, "baud": 9600}, ("baud is 9600", "1000000, 500000")),
    ("so101", {**PORT, "calibration": 7}, ("calibration is 7", "Give a path, a dict or None")),
]


@pytest.mark.parametrize(("name", "keywords", "texts"), REFUSALS)
def test_what_is_wrong_is_refused_with_what_would_do(
    name: str, keywords: dict[str, Any], texts: tuple[str, ...]
) -> None:
    with pytest.raises(ValueError) as refusal:
        Robot(name, **keywords)
    for text in texts:
        assert text in str(refusal.value)


def test_close_names_are_offered() -> None:
    with pytest.raises(ValueError, match=r"Did you mean: .*so101"):
        Robot("so-101", mode="real", port="x")


@pytest.mark.parametrize(
    ("devices", "text"),
    [(["/dev/ttyUSB1", "/dev/ttyACM0"], "/dev/ttyACM0, /dev/ttyUSB1"), ([], "serial devices here: none")],
)
def test_without_a_port_the_devices_there_are_are_named(
    monkeypatch: pytest.MonkeyPatch, devices: list[str], text: str
) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(device=path) for path in devices])
    with pytest.raises(ValueError) as refusal:
        Robot("so101", mode="real")
    for part in ("so101 needs 'port'", "port='/dev/ttyACM0'", text, "a path is not an identity"):
        assert part in str(refusal.value)


def test_a_robot_is_made_by_any_of_its_names_and_starts_nothing() -> None:
    arm = Robot("so101_follower", mode="REAL", port="/dev/nowhere", tool_name="left")
    assert (arm.tool_name, arm.name, arm.tool_type) == ("left", "left", "robot")
    assert repr(arm) == "<Robot left (so101, /dev/nowhere)>"
    assert arm.tree() is None
    assert Robot("so101", mode="real", port="x").tool_name == "so101"


# -- the registry


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the test registers is forgotten after it."""
    list_native_drivers()
    monkeypatch.setattr(drivers, "_registered", dict(drivers._registered))


def test_the_robots_with_a_driver_are_listed_with_its_name() -> None:
    listed = list_native_drivers()
    assert list(listed) == sorted(listed)
    assert {name: listed[name] for name in ("hope_jr", "open_duck_mini", "so100", "so101")} == dict.fromkeys(
        ("hope_jr", "open_duck_mini", "so100", "so101"), "Feetech"
    )


def test_coverage_says_who_drives_what() -> None:
    coverage = list_driver_coverage()
    assert coverage["so101"] == ("lerobot", "strands")
    assert coverage["omx"] == ("lerobot",)
    assert coverage["ability_hand"] == ()
    assert coverage["open_duck_mini"] == ("strands",)
    assert list(coverage) == sorted(coverage)


class Half:
    """A driver class with two members of many."""

    tool_name = "half"

    def stop(self) -> None: ...


@pytest.mark.usefixtures("registry")
def test_a_class_that_lacks_members_is_refused_by_their_names() -> None:
    missing = missing_driver_members(Half)
    assert missing == sorted(missing)
    assert {"cleanup", "send_action", "run_policy", "tool_spec", "stream"} <= set(missing)
    assert not {"stop", "tool_name"} & set(missing)
    with pytest.raises(TypeError) as refusal:
        register_native_driver("half", Half)
    assert str(refusal.value) == f"register_native_driver: Half lacks {', '.join(missing)}"
    assert "half" not in list_native_drivers()


@pytest.mark.usefixtures("registry")
def test_a_name_is_bound_once_unless_it_is_to_be_replaced() -> None:
    assert missing_driver_members(Feetech) == []

    class Other(Feetech):
        pass

    with pytest.raises(ValueError, match="so101 is already served by Feetech"):
        register_native_driver("so101", Other)
    register_native_driver("so101", Other, overwrite=True)
    assert list_native_drivers()["so101"] == "Other"
    register_native_driver("so102", Other)
    assert list_driver_coverage()["so102"] == ("strands",)
