"""SAF-002 on twins: the services of a stopped robot, called one after the other, energise and move nothing.

``tests/house/test_arming_services.py`` tests the gate. Here a service that energises without being declared so
writes a frame that energises, and the log of the twin shows it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from strands_actors.testing import Twin
from tests.answers import json_of, state, why
from tests.trees import robot_on

from ..house.test_arming_services import SAMPLES, variants

ROBOTS = (
    "panda",
    "rby1",
    "earthrover",
    "spot",
    "reachy_mini",
    "crazyflie",
    "microduck",
    "stretch3",
    "booster_t1",
    "unitree_go2",
    "unitree_go2:sport",
    "unitree_g1:sport",
    "unitree_h1:sport",
    "b2:sport",
)
"""A robot of each wire that has services, and each level."""

RECOVERS: Mapping[str, int] = {"panda": 1}
"""Robot to its frames of the kind ``enable`` that a service may write. A Franka's ``recover`` lets the controller
leave its reflex. It begins no motion, and the arm still has to be armed."""

STOPPED = ("disarmed", "unconfirmed", "locked_out")


@pytest.mark.parametrize("name", ROBOTS)
def test_saf_002_no_service_energises_a_stopped_robot(name: str, tmp_path: Path, run_dir: Path) -> None:
    robot_type, _, level = name.partition(":")
    options: Mapping[str, Any] = {"level": level} if level else {}
    with Twin(robot_type, tmp_path) as twin, robot_on(twin.port, robot_type, **options) as robot:
        json_of(robot.stop())
        stopped_ns = time.monotonic_ns()
        services = {key: service for key, service in robot.driver.SERVICES.items() if service.stops is None}
        assert services
        for key, service in services.items():
            for arguments in variants(service):
                given = {**SAMPLES.get(key, {}), **arguments}
                answer = robot.service(key, **given)
                if service.arms(given) or service.moves:
                    assert why(answer).startswith(f"{key}: the robot is "), answer
                    assert answer["content"][1]["json"]["refused"]["code"] in STOPPED, answer
        assert state(robot) in STOPPED
        assert twin.log.host("setpoint", stopped_ns) == []
        assert len(twin.log.host("enable", stopped_ns)) == RECOVERS.get(name, 0)
