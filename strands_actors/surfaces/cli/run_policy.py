"""``run``: let a policy control a robot for some seconds, from the terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from strands_actors.caller.handle.envelopes import warn_unless_safe
from strands_actors.caller.handle.progress import TerminalLine
from strands_actors.caller.handle.real_robot import RealRobot

from .errors import Problem
from .one_robot import OneRobot

FAILED = 1
INTERRUPTED = 130
STEPS = "steps"
"""Key of an answer that reports a rollout. A call that was refused before its start has no such key."""


def run_policy(
    chosen: OneRobot,
    policy: str,
    seconds: float,
    instruction: str,
    hz: float | None,
    max_age: float,
    options: Mapping[str, Any],
    as_json: bool,
) -> int:
    """Start a robot, let a policy control it, de-energise it, and print what happened.

    Args:
        chosen: The robot, and how to connect it.
        policy: A name, a folder or a server, as for ``RealRobot.run``.
        seconds: Duration from the policy's first action.
        instruction: Text for the policy.
        hz: Actions per second; None for the policy's or the driver's.
        max_age: As for ``RealRobot.run``, in seconds.
        options: Keyword arguments for the policy.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if the policy ran for the whole time and the robot confirmed its hold, 130 after Ctrl-C,
        else 1.

    Raises:
        Problem: Nothing was started: the robot or the policy is unknown, or the robot cannot be connected.
    """
    try:
        robot = chosen.make("run")
    except (ValueError, TypeError) as refusal:
        raise Problem(f"run: {refusal}") from refusal
    progress = False if as_json else TerminalLine(seconds)
    code, text = 0, ""
    try:
        answer = robot.run(policy, seconds, instruction, hz, progress, max_age, **options)
        code, text = (0, "") if answer["status"] == "success" else (FAILED, answer["content"][0]["text"])
        report: dict[str, Any] = answer["content"][-1].get("json", {})
    except KeyboardInterrupt:
        code, report = INTERRUPTED, _interrupted(robot, policy)
    finally:
        ended = robot.cleanup()
        warn_unless_safe(robot.name, ended)
    if ended["status"] != "success":
        code = code or FAILED
    if STEPS not in report:
        raise Problem(text)
    if as_json:
        print(json.dumps({**report, "error": text} if text else report))
    else:
        print(_line(report))
        if text:
            print(f"strands-actors: {text}", file=sys.stderr)
    return code


def _interrupted(robot: RealRobot, policy: str) -> dict[str, Any]:
    """Return the report of a rollout that Ctrl-C has ended."""
    status: dict[str, Any] = robot.get_task_status()["content"][-1]["json"]
    return {"robot": robot.name, "policy": policy, **status}


def _line(report: Mapping[str, Any]) -> str:
    refused = f", {report['refused']} refused" if "refused" in report else ""
    age = f", actions up to {report['action_age_s']:.2f} s old" if "action_age_s" in report else ""
    done = f"{report[STEPS]} steps in {report['elapsed_s']:.1f} s, {report['hz']:.1f} steps/s{refused}{age}"
    return f"{report['robot']}: {report['policy']}: {done}; ended: {report['exit_reason']}"
