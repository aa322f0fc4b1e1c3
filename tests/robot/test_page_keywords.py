"""The keywords of the drivers page are accepted, checked and passed to the driver."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation

LOOPBACK = next(name for _, name in socket.if_nameindex() if name.startswith("lo"))
ROBOTIQ, UR, G1 = {"port": "192.0.2.20"}, {"port": "192.0.2.30"}, {"port": "192.168.123.161"}


@pytest.mark.parametrize(
    ("robot", "keywords"),
    [
        ("so101", {"port": "/dev/ttyACM0", "baud_rate": 1_000_000, "timeout": 1.0, "transport": "serial"}),
        ("so101", {"port": "/dev/ttyACM0", "motor_ids": (1, 2, 3, 4, 5, 6)}),
        ("koch", {"port": "/dev/ttyACM0", "baud_rate": 1_000_000, "motor_ids": (1, 2, 3, 4, 5, 6), "timeout": 0.5}),
        ("unitree_g1", {**G1, "network_interface": "eth0", "battery_floor_pct": 20.0}),
        ("unitree_go2", {**G1, "network_interface": "192.168.123.222", "battery_floor_pct": 15.0}),
        ("robotiq_2f85", {**ROBOTIQ, "tcp_port": 502, "unit_id": 9, "stroke_mm": 85, "speed": 1.0, "force": 1.0}),
        ("ur5e", {**UR, "model": "ur5e", "control_frequency": 125, "rtde_frequency": 125}),
        ("ur5e", {"port": "192.0.2.30:30004", "rtde_frequency": None}),
    ],
)
def test_the_keywords_are_accepted(robot: str, keywords: dict[str, Any]) -> None:
    assert Robot(robot, mode="real", **keywords).driver.robot == robot


@pytest.mark.parametrize(
    ("robot", "keywords", "says"),
    [
        ("robotiq_2f85", {**ROBOTIQ, "tcp_port": 0}, "tcp_port is 0"),
        ("robotiq_2f85", {**ROBOTIQ, "tcp_port": 65536}, "tcp_port is 65536"),
        ("robotiq_2f85", {**ROBOTIQ, "tcp_port": True}, "tcp_port is True"),
        (
            "robotiq_2f85",
            {"port": "192.0.2.20:503", "tcp_port": 502},
            "tcp_port is 502. Give the TCP port only once",
        ),
        ("robotiq_2f85", {**ROBOTIQ, "speed": 1.5}, "speed is 1.5"),
        ("robotiq_2f85", {**ROBOTIQ, "force": -0.1}, "force is -0.1"),
        ("robotiq_2f85", {**ROBOTIQ, "force": float("nan")}, "force is nan"),
        ("unitree_g1", {**G1, "network_interface": 3}, "network_interface is 3"),
        ("unitree_g1", {**G1, "network_interface": "eth0; reboot"}, "network_interface is 'eth0; reboot'"),
        ("unitree_g1", {**G1, "network_interface": "a", "interface": "b"}, "mean the same"),
        ("ur5e", {"port": "192.0.2.30:80"}, "its ports are fixed"),
        ("so101", {"port": "/dev/ttyACM0", "baud_rate": 0}, "baud is 0"),
        ("ur5e", {**UR, "rtde_frequency": 0}, "rtde_frequency is 0"),
        ("ur5e", {**UR, "rtde_frequency": 1000}, "rtde_frequency is 1000"),
        ("ur5e", {**UR, "rtde_frequency": "fast"}, "rtde_frequency is 'fast'"),
    ],
)
def test_a_wrong_value_is_refused_by_the_name_of_its_keyword(
    robot: str, keywords: dict[str, Any], says: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=says.replace(".", r"\.")):
        Robot(robot, mode="real", **keywords)


def test_speed_and_force_are_the_defaults_of_an_action() -> None:
    gripper = Robot("robotiq_2f85", mode="real", **ROBOTIQ, speed=0.25, force=0.5).driver
    state = GateState(0, Observation(0, (0.0,), (1,)), (0.0, 1.0, 1.0), 0, stream=False)
    for action, expected in (
        ({"gripper": 0.5}, (0.5, 0.25, 0.5)),
        ({"gripper": 0.5, "force": 1.0}, (0.5, 0.25, 1.0)),
    ):
        candidate = gripper.parse(action, state)
        assert isinstance(candidate, Candidate) and candidate.values == expected


def test_the_port_of_the_gateway_may_be_given_by_either_keyword() -> None:
    def address(**keywords: Any) -> tuple[str, int]:
        endpoint: tuple[str, int] = Robot("robotiq_2f85", mode="real", **keywords).driver.config.address()
        return endpoint

    assert address(port="192.0.2.20") == ("192.0.2.20", 502)
    assert address(port="192.0.2.20", tcp_port=1502) == ("192.0.2.20", 1502)
    assert address(port="192.0.2.20:1502") == address(port="192.0.2.20:1502", tcp_port=1502) == ("192.0.2.20", 1502)


def test_connecting_over_an_unknown_interface_names_it() -> None:
    with_others = f"network_interface is 'eth99' .*This host has .*{LOOPBACK}"
    with (
        pytest.raises(ConnectionError, match=with_others),
        Robot("unitree_g1", mode="real", **G1, network_interface="eth99"),
    ):
        pytest.fail("the block is not entered")
