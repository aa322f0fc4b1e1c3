"""The refusals of the drivers page, for every robot: each names the given and the accepted values, and
starts nothing.
"""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import pytest
from serial.tools import list_ports

from strands_actors import Robot, list_native_drivers
from strands_actors.contract.driver import Driver
from strands_actors.drivers import constructor_keywords, get_native_driver_class, port_kind
from tests.answers import json_of

SEVERAL_PORTS = {"bi_openarm": "can0,can1"}
"""Ports of robots that have one for each side."""
NATIVE = sorted(list_native_drivers())


def driver_of(name: str) -> type[Driver]:
    driver_class = get_native_driver_class(name)
    assert driver_class is not None and issubclass(driver_class, Driver)
    return driver_class


def refusal(error: type[Exception], *args: Any, **keywords: Any) -> str:
    with pytest.raises(error) as raised:
        Robot(*args, **keywords)
    return str(raised.value)


SERIAL = [name for name in NATIVE if port_kind(name) == "serial" and not driver_of(name).PORT_OPTIONAL]
ADDRESSED = [name for name in NATIVE if port_kind(name) == "address" and not driver_of(name).PORT_OPTIONAL]
SIMULATED = [name for name in NATIVE if not driver_of(name).SIMULATION]


@pytest.mark.parametrize("name", NATIVE)
def test_the_refusal_of_an_unknown_keyword_names_the_closest_the_class_and_all_keywords(name: str) -> None:
    text = refusal(ValueError, name, mode="real", prot="x")
    assert list_native_drivers()[name] in text
    assert "'prot' -> 'port'" in text
    assert ", ".join(constructor_keywords(driver_of(name))) in text
    assert "'frobnicate'" in refusal(ValueError, name, mode="real", port="x", frobnicate=1)


@pytest.mark.parametrize("name", NATIVE)
def test_the_refusal_of_a_misspelled_name_names_close_ones(name: str) -> None:
    text = refusal(ValueError, f"{name}z")
    assert f"'{name}z' is not known" in text
    close = re.search(r"Did you mean: (.*)\?", text)
    assert close is not None and name in close[1].split(", ")
    assert "list_robots()" in text


@pytest.mark.parametrize("name", NATIVE)
def test_invalid_factory_arguments_are_refused_for_each_robot(name: str) -> None:
    assert "'auto', 'lerobot', 'strands'" in refusal(ValueError, name, driver="ros")
    assert "'sim', 'real', 'auto'" in refusal(ValueError, name, mode="dream")
    assert "transport 'smoke'. It offers " in refusal(ValueError, name, mode="real", transport="smoke")
    assert "Add it, or leave out sim=" in refusal(ValueError, name, mode="real", port="x", sim=object())
    assert "1 to 64 of A-Z a-z 0-9 _ -" in refusal(ValueError, name, tool_name="my robot")
    assert "is a teleoperator" in refusal(ValueError, f"{name}_leader", mode="real", port="x")


@pytest.mark.parametrize("name", NATIVE)
def test_invalid_cameras_are_refused_for_each_robot(name: str) -> None:
    text = refusal(ValueError, name, mode="real", transport="twin", cameras={"top": 0})
    assert text.startswith("Robot: camera 'top' is 0. Give its settings")


@pytest.mark.parametrize("name", SERIAL)
def test_the_refusal_of_a_missing_serial_port_names_the_connected_devices(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(list_ports, "comports", list)
    nothing = refusal(ValueError, name, mode="real")
    assert f"{name} needs 'port': Robot('{name}', mode='real', port='/dev/ttyACM0')" in nothing
    assert "Serial devices here: none" in nothing and "a path is not an identity" in nothing
    modem = SimpleNamespace(device="/dev/ttyS0", vid=None, pid=None)
    monkeypatch.setattr(list_ports, "comports", lambda: [modem])
    assert "/dev/ttyS0, none looks like a servo bus" in refusal(ValueError, name, mode="real")


@pytest.mark.parametrize("name", ADDRESSED)
def test_a_missing_address_has_an_example(name: str) -> None:
    assert f"{name} needs 'port', its address: Robot('{name}', mode='real', port=" in refusal(
        ValueError, name, mode="real"
    )


@pytest.mark.parametrize("name", SIMULATED)
def test_a_keyword_that_a_simulation_would_ignore_is_refused(name: str) -> None:
    driver = driver_of(name)
    keywords = {"port": "x", "transport": "twin"} | dict.fromkeys({*driver.OPTIONS} - {*driver.TWIN_OPTIONS}, 1)
    for keyword, value in keywords.items():
        text = refusal(TypeError, name, **{keyword: value})
        assert f"a simulation of {name} would ignore {keyword}=" in text
        assert "Add mode='real'" in text


def a_port(name: str) -> str:
    return driver_of(name).PORT_LIKE if port_kind(name) == "address" else "/dev/no-such-port"


@pytest.mark.parametrize("name", NATIVE)
def test_a_robot_that_was_never_connected_answers_and_touches_nothing(name: str) -> None:
    # a program on the robot's own computer needs no port
    boards = port_kind(name) == "serial" and driver_of(name).PORT_OPTIONAL
    port = {} if boards else {"port": SEVERAL_PORTS.get(name) or a_port(name)}
    robot = Robot(name, mode="real", **port)
    task = json_of(robot.get_task_status())
    assert (task["running"], task["steps"]) == (False, 0)
    status = json_of(robot.get_status())
    assert (status["tool_name"], status["connected"]) == (name, False)
    assert json_of(robot.cleanup())["stopped"] is True


@pytest.mark.parametrize("name", ["ability_hand", "omx", "bi_so101"])
def test_the_refusal_of_a_robot_without_a_native_driver_names_those_with_one(name: str) -> None:
    text = refusal(ValueError, name, mode="real", port="x", driver="strands")
    assert f"{name} has no native driver" in text
    assert ", ".join(NATIVE) in text
