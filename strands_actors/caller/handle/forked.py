"""The verbs of a robot's handle in a child that was forked from the robot's program.

A fork does not copy threads, so the connections to the robot stay with the parent. The child has no readings of
the robot. It can only stop the robot, by running the command line. The command line finds the robot in the run
directory, as for any other program of this user.
"""

from __future__ import annotations

import json
import subprocess
from typing import Any

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.supervisors.stop_result import StopResult

START_S = 10.0
"""Longest time for the command line to start, on a busy computer."""
_COMMAND = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"


def reason_unavailable(parent: int, robot: str) -> str:
    """Return why the child cannot run a verb, and where to run it."""
    reason = f"process {parent}, from which this one was forked, has the robot"
    return f"{reason}. Call it there, or run `strands-actors stop {robot}` to stop it"


def unknown(verb: str, parent: int, robot: str, driver: Driver) -> stop_result.Unreachable:
    """Return an unknown result for a verb that ends motion, since the child cannot run it."""
    reason, _, remedy = reason_unavailable(parent, robot).partition(". ")
    return stop_result.silent(verb, reason, driver, remedy, Code.FORKED)


def command_line(*words: str, within_s: float) -> dict[str, Any]:
    """Run the command line with ``--json``, and return its JSON; ``{"error": ...}`` if it does not answer."""
    try:
        done = subprocess.run(
            [*PYTHON, "-c", _COMMAND, *words, "--json"],
            capture_output=True,
            text=True,
            timeout=START_S + within_s,
            env=environment(),
            check=False,
        )
        answer: dict[str, Any] = json.loads(done.stdout)
    except (OSError, ValueError, subprocess.TimeoutExpired) as failure:
        return {"error": f"the command line does not answer ({failure})"}
    return answer


def stop(robot: str, driver: Driver) -> StopResult:
    """Stop the robot by running ``strands-actors stop``."""
    deadlines = StopDeadlines.of(driver.timing.safe_s)
    answer = command_line("stop", robot, within_s=deadlines.gate_s + deadlines.root_s)
    rows = answer.get("robots", [])
    if len(rows) != 1:
        return stop_result.silent("stop", answer.get("error") or "the command line names no robot", driver)
    (row,) = rows
    if row["done"] is not True and not row.get("motors"):
        return stop_result.silent("stop", row.get("detail") or "it is not confirmed", driver)
    motors = tuple(
        MotorReport(motor["axis"], motor["id"], True, motor["safe"], motor["safe"], motor["detail"])
        for motor in row.get("motors", ())
    )
    safe_state = SafeState(row.get("safe_state") or driver.fallbacks[Reason.STOP])
    path, took_ms = row.get("path") or "wire", row.get("took_ms", 0.0)
    return stop_result.of_report(StopReport(Reason.STOP, safe_state, 0, row["done"] is True, motors, path, took_ms))
