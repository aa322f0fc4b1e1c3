"""Test that every wire refuses an impossible port or option when the robot is made, and names what it accepts.
It accepts all examples on the robot's page."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.drivers.common.ports.addresses import is_host, parse_address

DRIVERS: dict[str, type[Driver]] = {wire: load(where) for wire, where in WIRES.items()}
ADDRESSED = [wire for wire, driver in DRIVERS.items() if driver.PORT_KIND == "address"]
SERIAL = [wire for wire, driver in DRIVERS.items() if driver.PORT_KIND == "serial"]

NO_ADDRESS = (
    "192.0.2.10:no", "192.0.2.10:99999", "192.0.2.10:0", "192.0.2.10:", "192.0.2.300", "192.0.2", "http://",
    "ftp://192.0.2.10", "[::1", ":80", "host:80:90", "-host", "a..b", "x\0y", "a" * 300,
)  # fmt: skip
NO_DEVICE = ("192.0.2.10", "192.0.2.10:502", "http://192.0.2.10", "/dev/tty\0ACM0", "/")

GOOD = {
    "feetech": ("/dev/ttyACM0", "/dev/serial/by-id/usb-1a86", "COM3", "/dev/null"),
    "dynamixel": ("/dev/ttyUSB0",),
    "ur": ("192.0.2.10", "192.0.2.10:30004", "arm.local", "[2001:db8::10]", "2001:db8::10"),
    "franka": ("192.0.2.10", "robot.lab.example"),
    "robotiq": ("192.0.2.10", "192.0.2.10:502", "/dev/ttyUSB0"),
    "xarm": ("192.0.2.10", "xarm_7"),
    "can_motors": ("can0", "vcan_left", "/dev/ttyACM0"),
    "kuka": ("192.0.2.10", "192.0.2.10:30200", ""),
    "kinova": ("192.0.2.10",),
    "rby1": ("192.0.2.10:50051", "rby1."),
    "earthrover": ("http://192.0.2.10:8000", "192.0.2.10:8000", "localhost"),
    "yahboom": ("192.0.2.10", "192.0.2.10:9090", "ws://192.0.2.10:9090/", ""),
    "spot": ("192.0.2.10", "192.0.2.10:443?ca=/tmp/ca.pem"),
    "reachy": ("reachy-mini.local", "192.0.2.10:8000", "http://192.0.2.10:8000/", ""),
    "crazyflie": (
        "radio://0/80/2M",
        "radio://0/80/2M/E7E7E7E7E7",
        "usb://0",
        "serial:///dev/ttyAMA0",
        "192.0.2.10",
    ),
    "microduck": ("/run/robotd.sock", "ssh://radxa@duck.local:22", "ssh://192.0.2.10", ""),
    "stretch": ("",),
    "booster": ("192.0.2.10", "192.0.2.10:7410", ""),
    "unitree_g1": ("192.168.123.161",),
    "unitree": ("192.168.123.161", "127.0.0.1:7412"),
}


def robot_of(wire: str) -> str:
    return DRIVERS[wire].SUPPORTED_ROBOTS[0]


@pytest.mark.parametrize("wire", ADDRESSED)
def test_an_invalid_address_is_refused_when_the_robot_is_made(wire: str) -> None:
    taken = []
    for port in NO_ADDRESS:
        try:
            Robot(robot_of(wire), mode="real", port=port)
        except ValueError as refusal:
            assert "Give" in str(refusal) or "without spaces" in str(refusal), refusal
        else:
            taken.append(port)
    assert taken == []


@pytest.mark.parametrize("wire", SERIAL)
def test_an_invalid_device_is_refused_when_the_robot_is_made(wire: str, tmp_path: Path) -> None:
    file = tmp_path / "port"
    file.write_text("/dev/pts/7\n")  # the --port-file of a twin: its content is the port
    for port in (*NO_DEVICE, str(file)):
        with pytest.raises(ValueError, match=r"port is .*(Give the path of a serial device|Leave it out)"):
            Robot(robot_of(wire), mode="real", port=port)


@pytest.mark.parametrize("wire", DRIVERS)
def test_examples_of_the_pages_are_accepted(wire: str) -> None:
    for port in GOOD[wire]:
        Robot(robot_of(wire), mode="real", port=port or None)


@pytest.mark.parametrize("wire", DRIVERS)
def test_a_port_that_is_no_text_is_a_type_error(wire: str) -> None:
    for port in (3, True, b"/dev/ttyACM0", ["192.0.2.10"]):
        with pytest.raises(TypeError, match="port is "):
            Robot(robot_of(wire), mode="real", port=port)


NO_OPTION = (object(), b"x", {1: 2}, math.nan, math.inf, -1e9, 1e30, 10**12)


@pytest.mark.parametrize("wire", DRIVERS)
def test_an_invalid_option_is_refused_under_the_given_keyword(wire: str) -> None:
    driver = DRIVERS[wire]
    port = GOOD[wire][0] or None
    for keyword in (*driver.OPTIONS, *driver.SPELLINGS):
        for value in NO_OPTION:
            with pytest.raises((TypeError, ValueError), match=rf"\b{keyword}\b"):
                Robot(robot_of(wire), mode="real", port=port, **{keyword: value})


@pytest.mark.parametrize(
    ("text", "host"),
    [("[::1]:80", "::1"), ("fe80::1%eth0", "fe80::1%eth0"), ("müller.local:80", "müller.local"), ("h", "h")],
)
def test_an_address_is_read(text: str, host: str) -> None:
    assert parse_address(text, 80) == (host, 80)


@pytest.mark.parametrize("text", ["", ".", "a_", "1.2.3.4.5", "::g", "a b", "x/y", "a" * 64, "٣.2.3.4:80"])
def test_an_invalid_host(text: str) -> None:
    assert is_host(text) is (text == "a_")
