"""``driver="lerobot"`` on a bus of rustypot, which locks its port. ``test_descriptors.py`` runs this as an ordinary
user: root could open the locked port, and would not notice that a stop channel cannot."""

from __future__ import annotations

import errno
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until

from .test_lerobot import calibrated, lerobot, twin

__all__ = ["lerobot", "twin"]

pytestmark = pytest.mark.real_time


@pytest.fixture
def arm(twin: Twin, lerobot: None, tmp_path: Path) -> Iterator[Any]:
    robot = Robot("so101", mode="real", driver="lerobot", port=twin.port, bus="rustypot", **calibrated(tmp_path))
    try:
        until(lambda: robot.connect_eagerly() is None, "it connects")
        yield robot
    finally:
        robot.cleanup()


def test_the_port_is_locked_and_each_end_of_a_process_takes_the_torque(twin: Twin, arm: Any) -> None:
    with pytest.raises(OSError) as locked:
        os.open(twin.port, os.O_RDWR | os.O_NOCTTY)
    assert locked.value.errno == errno.EBUSY, "this user may open the port twice: the test proves nothing"
    assert status(arm)["stop_channel"].startswith("torque off by our own codec")
    json_of(arm.send_action({"shoulder_pan": arm.get_observation()["shoulder_pan"] + 8.0}))
    killed_ns = time.monotonic_ns()
    os.kill(pids(arm)["wire"], signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "it is limp")
    until(lambda: status(arm)["connected"] and state(arm) == "disarmed", "there is another wire")
    twin.log.no_setpoint_after_safe(killed_ns)
    twin.log.silent_after(killed_ns, "enable")
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": arm.get_observation()["shoulder_pan"] + 8.0}))
    both = [pids(arm)[role] for role in ("root", "wire")]
    killed_ns = time.monotonic_ns()
    for pid in both:
        os.kill(pid, signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "the standby takes the torque")
    twin.log.no_setpoint_after_safe(killed_ns)


def test_a_stop_is_read_back_and_a_root_that_ends_leaves_nothing_energised(twin: Twin, arm: Any) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    stopped_ns = time.monotonic_ns()
    assert json_of(arm.stop())["safe_state"] == "limp"
    twin.log.no_setpoint_after_safe(stopped_ns)
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": 8.0}))
    killed_ns = time.monotonic_ns()
    os.kill(pids(arm)["root"], signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "the wire stops it")
    twin.log.no_setpoint_after_safe(killed_ns)
