"""One e-stop stops four robots of four kinds on their real wires, judged by the wire log of each twin."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.surfaces.mesh import estop_button, resume
from strands_actors.testing import Twin
from tests.answers import resumed
from tests.trees import connected

MOVES = {
    "so101": ("shoulder_pan", 20.0),
    "koch": ("shoulder_pan", 20.0),
    "ur5e": ("shoulder_pan_joint", 0.01),
    "robotiq_2f85": ("gripper", 0.5),
}
"""The motion of each robot: a joint, and the distance from its present position (for the gripper, the target)."""
SAFE_STATES = {"so101": "limp", "koch": "limp", "robotiq_2f85": "hold"}
BOUND_S = 1.0
"""Longest time from the call to the safe frame of each robot. It is far above the measured time, for a busy
machine."""


BUSY_S = 0.5


async def busy() -> None:
    """Blocks the caller's loop for some time."""
    time.sleep(BUSY_S)  # noqa: ASYNC251


class Member(NamedTuple):
    twin: Twin
    robot: RealRobot


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[dict[str, Member]]:
    with contextlib.ExitStack() as stack, ThreadPoolExecutor() as at_once:
        twins = []
        for kind in MOVES:
            (tmp_path / kind).mkdir()
            twins.append(Twin(kind, tmp_path / kind))
        for twin, _ in zip(twins, at_once.map(Twin.__enter__, twins), strict=True):
            stack.push(twin.__exit__)
        members = {twin.robot: Member(twin, Robot(twin.robot, mode="real", port=twin.port)) for twin in twins}
        for member in members.values():
            stack.callback(member.robot.cleanup)
        list(at_once.map(connected, (member.robot for member in members.values())))
        yield members


def move(kind: str, robot: RealRobot) -> str:
    joint, by = MOVES[kind]
    seen = robot.get_observation()
    start = 0.0 if kind == "robotiq_2f85" else seen[joint]
    answer = robot.send_action({joint: start + by})
    return str(answer["content"][0].get("text", "")) if answer["status"] == "error" else ""


def test_saf_007_one_estop_stops_every_robot_on_the_mesh(fleet: dict[str, Member]) -> None:
    for member in fleet.values():  # its link may have been lost while the others started
        resumed(member.robot)
    assert {kind: move(kind, member.robot) for kind, member in fleet.items()} == dict.fromkeys(fleet, "")

    began_ns = time.monotonic_ns()
    outcomes = {outcome.robot: outcome for outcome in estop(by="the fleet's button", within_s=3.0)}

    assert {robot: outcome.outcome for robot, outcome in outcomes.items()} == dict.fromkeys(fleet, "safe")
    for kind, member in fleet.items():
        took_s = member.twin.log.safe_within(began_ns, BOUND_S)
        print(f"{kind}: safe on the wire after {1e3 * took_s:.1f} ms, {outcomes[kind].safe_state}")
        assert "e-stopped by the fleet's button" in move(kind, member.robot)
    time.sleep(0.3)
    for member in fleet.values():
        assert member.twin.log.setpoints_after_safe(began_ns) == 0
    assert {kind: outcomes[kind].safe_state for kind in SAFE_STATES} == SAFE_STATES

    # The mesh is joined in advance. The e-stop comes from a thread while the loop is busy.
    resume("so101")
    assert move("so101", fleet["so101"].robot) == ""
    with estop_button(by="the red one") as press:
        began_ns = time.monotonic_ns()
        portal().submit(busy)
        with ThreadPoolExecutor(1) as thread:
            outcomes = {outcome.robot: outcome for outcome in thread.submit(press).result()}
        took_s = fleet["so101"].twin.log.safe_within(began_ns, BOUND_S)
    print(f"so101: safe on the wire after {1e3 * took_s:.1f} ms by the button")
    assert took_s < BUSY_S / 2
    assert outcomes.keys() == fleet.keys()
    assert "e-stopped by the red one" in move("so101", fleet["so101"].robot)
    with pytest.raises(RuntimeError, match="has ended"):
        press()

    resume("so101")
    assert move("so101", fleet["so101"].robot) == ""
    assert "e-stopped" in move("koch", fleet["koch"].robot)  # each robot needs its own resume
