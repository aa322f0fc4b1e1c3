"""Test hostile peers with real processes: a robot's tree, its twin, and a relay between them (SAF-022,
SAF-025).

The tests check order and counts only. The suite in virtual time asserts the bounds.
"""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.common.twin.tcp import own_host
from strands_actors.testing import Twin
from tests.answers import pids, until
from tests.trees import armed, first_safe, robot_on

from .relay import Datagrams, Relay
from .rigs import RIGS

MOST_MEMORY = 32 << 20
MOST_FLOOD = 1200
"""Bytes of a bomb's body that are repeated."""
FLOODED_S = 0.7
"""Time from the beginning of the fault to the stop."""


class Cell(NamedTuple):
    """One test case. ``flood`` names a flood of its rig, or a bomb. The head of a bomb is sent once."""

    robot: str
    kind: str
    flood: str = ""
    ports: tuple[int, ...] = ()
    datagrams: Datagrams = Datagrams.NONE
    services: tuple[str, ...] = ()
    """Services that the robot must have done before it accepts a target."""

    def __str__(self) -> str:
        return "-".join(filter(None, self[:3])).replace(" ", "_")


XARM = (30001, 30002, 30003)
UR = (29999, 30001, 30002, 30003)
FRI, FCI, DDS = Datagrams.SAME_PORT, Datagrams.GREETING, Datagrams.DDS
RELEASED = ("release_sport_mode",)
CELLS = [
    Cell("rby1", "flood", "pings"),
    Cell("xarm7", "flood", "unasked answers", XARM),
    Cell("yahboom_m3pro", "garbled"),
    Cell("rby1", "flood", "settings"),
    Cell("reachy_mini", "flood", "pings"),
    Cell("earthrover", "flood", "endless chunks"),
    Cell("yahboom_m3pro", "flood", "pings"),
    Cell("yahboom_m3pro", "flood", "empty messages"),
    Cell("yahboom_m3pro", "flood", "fragments"),
    Cell("yahboom_m3pro", "half"),
    Cell("earthrover", "garbled"),
    Cell("earthrover", "half"),
    Cell("reachy_mini", "garbled"),
    Cell("reachy_mini", "half"),
    Cell("reachy_mini", "flood", "interim answers"),
    Cell("rby1", "flood", "empty data"),
    Cell("rby1", "garbled"),
    Cell("rby1", "half"),
    Cell("xarm7", "garbled", "", XARM),
    Cell("xarm7", "half", "", XARM),
    Cell("kinova_gen3", "flood", "notifications"),
    Cell("kinova_gen3", "garbled"),
    Cell("kinova_gen3", "half"),
    Cell("robotiq_2f85", "garbled"),
    Cell("kuka_iiwa", "flood", "the same message", (), FRI),
    Cell("kuka_iiwa", "garbled", "", (), FRI),
    Cell("kuka_iiwa", "half", "", (), FRI),
    Cell("panda", "flood", "unasked answers", (), FCI),
    Cell("panda", "garbled", "", (), FCI),
    Cell("panda", "half", "", (), FCI),
    Cell("ur5e", "flood", "texts", UR),
    Cell("ur5e", "garbled", "", UR),
    Cell("ur5e", "half", "", UR),
    Cell("microduck", "flood", "unasked answers"),
    Cell("microduck", "garbled"),
    Cell("microduck", "half"),
    Cell("unitree_go2", "flood", "empty states", (), DDS, RELEASED),
    Cell("unitree_go2", "flood", "announcements", (), DDS, RELEASED),
    Cell("unitree_go2", "garbled", "", (), DDS, RELEASED),
    Cell("unitree_go2", "half", "", (), DDS, RELEASED),
]
JOINTS = {
    "rby1": ["torso_0"],
    "xarm7": ["joint1"],
    "kinova_gen3": ["joint_1"],
    "robotiq_2f85": ["gripper"],
    "kuka_iiwa": ["joint1"],
    "ur5e": ["shoulder_pan_joint"],
    "panda": [f"joint{number}" for number in range(1, 8)],
    "unitree_go2": ["FR_hip_joint"],
}
"""The names in a target, for robots with position targets. The first one moves."""
ACTIONS: Mapping[str, Mapping[str, float]] = {
    "yahboom_m3pro": {"linear.x": 0.1},
    "earthrover": {"linear": 0.1},
    "reachy_mini": {"head_yaw": 5.0},
    "microduck": {"vx": 0.1},
}
"""The actions for all other robots."""
TWINS: Mapping[str, Mapping[str, object]] = {"microduck": {"enabled": True}}
"""Options of a twin."""
SCHEMES = {"yahboom_m3pro": "ws://", "earthrover": "http://", "reachy_mini": "http://"}

CALLER = """
import json, sys, time
from strands_actors import Robot
robot, port, action, services, *joints = sys.argv[1:]
arm = Robot(robot, mode="real", port=port)
while arm.connect_eagerly() is not None:
    time.sleep(0.1)
for service in json.loads(services):
    while arm.service(service)["status"] != "success":
        time.sleep(0.1)
seen = arm.get_observation()
target = json.loads(action) | {joint: seen[joint] for joint in joints}
print("ready", flush=True)
while True:
    for joint in joints[:1]:
        target[joint] = arm.get_observation()[joint] + 0.002
    arm.send_action(target)
    time.sleep(0.05)
"""


def address(cell: Cell, relay: Relay) -> str:
    """Return the relay's address as a user of this robot writes it."""
    return SCHEMES.get(cell.robot, "") + relay.port


def _memory(pid: int, key: str) -> int:
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) << 10 for line in status if line.startswith(key))


class Memory:
    """The memory growth of processes, in bytes."""

    def __init__(self, processes: dict[str, int]) -> None:
        self._before = {pid: _memory(pid, "VmRSS") for pid in processes.values()}
        for pid in self._before:
            Path(f"/proc/{pid}/clear_refs").write_text("5")  # resets the peak

    def grown(self) -> int:
        now = {pid: _memory(pid, "VmHWM") for pid in self._before if os.path.exists(f"/proc/{pid}/status")}
        return max((peak - self._before[pid] for pid, peak in now.items()), default=0)


@pytest.fixture
def cell(request: pytest.FixtureRequest) -> Cell:
    found: Cell = request.param
    return found


@pytest.fixture
def host(cell: Cell, tmp_path: Path) -> str:
    """Return the relay's address or its path."""
    return str(tmp_path / "relay.sock") if cell.robot == "microduck" else own_host()


@pytest.fixture
def twin(cell: Cell, host: str, tmp_path: Path) -> Iterator[Twin]:
    options = {"client": host} if cell.datagrams is FRI else TWINS.get(cell.robot, {})
    with Twin(cell.robot, tmp_path, options=options) as twin:
        yield twin


@pytest.fixture
def relay(cell: Cell, host: str, twin: Twin) -> Iterator[Relay]:
    with Relay(twin.port, cell.ports, cell.datagrams, host) as relay:
        yield relay


def begin(cell: Cell, relay: Relay) -> None:
    rig = RIGS[cell.robot]
    flood = {"": b"", **rig.floods, **rig.bombs}[cell.flood]
    words = flood if isinstance(flood, bytes) else flood(0)
    head, end, body = words.partition(b"\r\n\r\n") if cell.flood in rig.bombs else (b"", b"", words)
    relay.begin(cell.kind, body[:MOST_FLOOD], head + end)
    time.sleep(FLOODED_S)


def succeeds(arm: RealRobot, service: str) -> bool:
    return bool(arm.service(service)["status"] == "success")


def moving(arm: RealRobot, twin: Twin, cell: Cell) -> None:
    armed(arm)
    for service in cell.services:
        until(functools.partial(succeeds, arm, service), service)
    began_ns = time.monotonic_ns()
    until(lambda: moved(arm, cell.robot)["status"] == "success", "a target is taken")
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")


def moved(arm: RealRobot, robot: str) -> Mapping[str, Any]:
    """Send a small step from the present position, or the robot's row of ``ACTIONS``."""
    if robot in ACTIONS:
        sent: Mapping[str, Any] = arm.send_action(dict(ACTIONS[robot]))
        return sent
    joints = JOINTS[robot]
    seen = arm.get_observation()
    target = {joint: seen.get(joint, 0.0) for joint in joints}
    answer: Mapping[str, Any] = arm.send_action({**target, joints[0]: target[joints[0]] + 0.002})
    return answer


@pytest.mark.quick_cases(3)
@pytest.mark.real_time
@pytest.mark.parametrize("cell", CELLS, indirect=True, ids=str)
def test_saf_022_025_a_stop_behind_a_hostile_peer(cell: Cell, twin: Twin, relay: Relay) -> None:
    with robot_on(address(cell, relay), cell.robot) as arm:
        moving(arm, twin, cell)
        memory = Memory(pids(arm))
        begin(cell, relay)
        asked_ns = time.monotonic_ns()
        answer = arm.stop()
        safe = first_safe(twin.log, asked_ns)
        twin.log.no_setpoint_after_safe(asked_ns)
        assert memory.grown() <= MOST_MEMORY
        if cell.kind != "flood":
            assert answer["status"] == "error", "confirmed by words that cannot be understood"
        twin.log.silent_after(safe.t_ns, "setpoint", "enable")  # messages under way may arrive before the stop
        relay.begin("ok")
        until(lambda: arm.stop()["status"] == "success", "it is known to be safe")


@pytest.mark.quick_cases(2)
@pytest.mark.real_time
@pytest.mark.parametrize("cell", CELLS, indirect=True, ids=str)
def test_saf_022_025_the_caller_is_killed_behind_a_hostile_peer(cell: Cell, twin: Twin, relay: Relay) -> None:
    action = json.dumps(ACTIONS.get(cell.robot, {}))
    told = [cell.robot, address(cell, relay), action, json.dumps(cell.services), *JOINTS.get(cell.robot, [])]
    arguments = [sys.executable, "-c", CALLER, *told]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as caller:
        assert caller.stdout is not None
        try:
            assert caller.stdout.readline() == "ready\n"
            until(lambda: twin.log.host("setpoint"), "a setpoint")
            begin(cell, relay)
        finally:
            killed_ns = time.monotonic_ns()
            caller.send_signal(signal.SIGKILL)
    safe = first_safe(twin.log, killed_ns)
    time.sleep(0.3)
    twin.log.no_setpoint_after_safe(killed_ns)
    relay.begin("ok")
    healed_ns = time.monotonic_ns()
    if cell.kind != "flood" or cell.datagrams is Datagrams.NONE:  # a host may keep up with a flood of datagrams
        first_safe(twin.log, healed_ns)  # it is confirmed, and the tree ends
    time.sleep(0.3)
    twin.log.silent_after(safe.t_ns, "setpoint", "enable")
