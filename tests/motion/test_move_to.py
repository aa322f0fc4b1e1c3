"""``move_to`` as scripts and agents call it: on an SO-101 behind its bus, on a UR, in simulation."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, state, task, until, why
from tests.robot.helpers import IDS, goals, holds
from tests.trees import armed

PAN = "shoulder_pan"


def other_side(arm: RealRobot) -> float:
    """Return a target away from the joint's position."""
    return -25.0 if arm.get_observation()[PAN] > 0 else 25.0


def begun(arm: RealRobot, twin: Twin, seconds: float = 8.0) -> int:
    """Begin a long motion, wait until the robot moves, and return the time of the start."""
    armed(arm)
    began_ns = time.monotonic_ns()
    json_of(arm.move_to({PAN: other_side(arm)}, seconds=seconds, wait=False))
    until(lambda: len({entry.data for entry in twin.log.host("setpoint", began_ns)}) > 4, "it moves")
    return began_ns


def test_move_to_reaches_its_target_in_time_and_holds_there(arm: RealRobot, twin: Twin) -> None:
    target, began_ns = other_side(arm), time.monotonic_ns()
    result = json_of(arm.move_to({PAN: target}, seconds=1.0))
    assert result["commanded"] == {PAN: target} and result["seconds"] == 1.0
    assert result["position"][PAN] == pytest.approx(target, abs=3.0)
    written = [goals(entry) for entry in twin.log.host("setpoint", began_ns)]
    path = [at[IDS[PAN]] for at in written]
    assert len(set(path)) > 15 and sorted(path) in (path, path[::-1]), "small steps in one direction"
    assert len({at[IDS["elbow_flex"]] for at in written}) == 1, "a joint that the target does not name stays"
    assert state(arm) == "armed" and not holds(twin.log, began_ns), "the target stays in force"
    assert json_of(arm.send_action({PAN: target}))


def test_a_motion_without_waiting_runs_as_a_task_that_a_stop_ends(arm: RealRobot, twin: Twin) -> None:
    began_ns = begun(arm, twin)
    assert task(arm)["running"] and task(arm)["instruction"] == "move_to"
    assert "a task is running" in why(arm.send_action({PAN: 0.0}))
    assert json_of(arm.stop_task())["exit_reason"] == "stopped"
    assert until(lambda: holds(twin.log, began_ns), "it is held where it was")


def test_a_time_that_is_too_short_is_refused_with_the_least(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    refused = arm.move_to({PAN: other_side(arm)}, seconds=0.05)
    least = refused["content"][1]["json"]["refused"]["limit"]
    assert f"Give seconds={least} or more" in why(refused)
    assert "is past" in why(arm.move_to({PAN: 300.0}))
    assert "Give seconds, above 0" in why(arm.move_to({PAN: 0.0}, seconds=-1))
    assert twin.log.host("setpoint", began_ns) == []
    json_of(arm.move_to({PAN: other_side(arm)}, seconds=float(least) + 0.1))


def test_ctrl_c_ends_the_motion_that_is_waited_for(arm: RealRobot, twin: Twin) -> None:
    armed(arm)
    interrupt = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    began_ns = time.monotonic_ns()
    interrupt.start()
    with pytest.raises(KeyboardInterrupt):
        arm.move_to({PAN: other_side(arm)}, seconds=20.0)
    assert not task(arm)["running"]
    until(lambda: holds(twin.log, began_ns), "it is held")


def test_saf_006_a_stop_ends_it_and_no_setpoint_follows(arm: RealRobot, twin: Twin) -> None:
    begun(arm, twin)
    stopped_ns = time.monotonic_ns()
    json_of(arm.stop())
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0
    assert "resume() first" in why(arm.move_to({PAN: 0.0}))


SCRIPT = """
import sys
from strands_actors import Robot
arm = Robot("so101", mode="real", port=sys.argv[1])
print(arm.move_to({"shoulder_pan": float(sys.argv[2])}, seconds=20.0))
"""


def test_saf_003_a_killed_script_ends_it(twin: Twin, run_dir: Path) -> None:
    for target in ("25", "-25"):  # one of the two is away from the joint's position
        began_ns = time.monotonic_ns()
        script = subprocess.Popen([sys.executable, "-c", SCRIPT, twin.port, target])
        try:
            until(lambda ns=began_ns: len(twin.log.host("setpoint", ns)) > 20, "it moves")  # type: ignore[misc]
            killed_ns = time.monotonic_ns()
        finally:
            script.kill()
            script.wait()
        until(lambda ns=killed_ns: twin.log.host("safe", ns), "it is made safe")  # type: ignore[misc]
        time.sleep(0.3)
        assert twin.log.setpoints_after_safe(killed_ns) == 0


def test_an_agent_moves_in_a_time_and_can_stop_it(arm: RealRobot, twin: Twin) -> None:
    target = other_side(arm)
    moved = json_of(
        asyncio.run(arm.use_tool({"action": "move_to", "targets": {PAN: target}, "seconds": 1}, "agent"))
    )
    assert moved["position"][PAN] == pytest.approx(target, abs=3.0)

    async def moves_and_stops() -> tuple[object, object]:
        long = {"action": "move_to", "targets": {PAN: -target}, "seconds": 20}
        moving = asyncio.create_task(arm.use_tool(long, "agent"))
        await asyncio.sleep(0.5)
        stopped = await arm.use_tool({"action": "stop"}, "agent")
        return json_of(stopped)["safe_state"], why(await moving)

    safe_state, ended = asyncio.run(moves_and_stops())
    assert safe_state == "limp" and str(ended).startswith("move_to: it did not come to its end: stop")


def test_a_ur_that_takes_small_steps_alone_needs_no_loop(ur: RealRobot) -> None:
    joint = "wrist_3_joint"
    here = ur.get_observation()[joint]
    assert "steps" in why(ur.send_action({joint: here + 0.5}))
    result = json_of(ur.move_to({joint: here + 0.5}, seconds=1.0))
    assert result["position"][joint] == pytest.approx(here + 0.5, abs=0.01)


def test_a_simulation_moves_in_a_time_and_connects_by_itself() -> None:
    sim = Robot("so101")
    try:
        result = json_of(sim.move_to({PAN: 30.0}, seconds=1.0))
        assert result["position"][PAN] == pytest.approx(30.0, abs=3.0)
    finally:
        sim.cleanup()
