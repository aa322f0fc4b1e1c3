"""Read the answers of a robot's verbs, in tests of any robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

PATIENCE_S = 20.0
"""How long a test waits for an event that takes far less on an idle machine."""


def resumed(robot: Any) -> None:
    """Arm the robot.

    On a busy machine a robot with legs may be disarmed again while it is being armed. So try again
    until ``PATIENCE_S`` has passed; the failure lists the refusal of each attempt.
    """
    refusals: list[str] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while (answer := robot.resume())["status"] != "success":
        refusals.append(why(answer))
        assert time.monotonic() < deadline_s, f"not armed within {PATIENCE_S:g} s: {refusals}"
        time.sleep(0.01)


def until(look: Callable[[], T | None], what: str, within_s: float = PATIENCE_S) -> T:
    """Call ``look`` every 10 ms until its result is true, and return that result.

    Args:
        look: Reads the state that the test waits for.
        what: The expected event, for the text of the failure.
        within_s: Longest wait, in seconds. After it the test fails.
    """
    deadline_s = time.monotonic() + within_s
    while not (seen := look()):
        assert time.monotonic() < deadline_s, f"not within {within_s:g} s: {what}"
        time.sleep(0.01)
    return seen


def json_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON of a success envelope; fail on any other answer."""
    assert answer["status"] == "success", answer
    (block,) = answer["content"]
    json: dict[str, Any] = block["json"]
    return json


def why(answer: Mapping[str, Any]) -> str:
    """Return the text of an error envelope; fail on any other answer."""
    assert answer["status"] == "error", answer
    text: str = answer["content"][0]["text"]
    return text


def status(arm: Any) -> dict[str, Any]:
    return json_of(arm.get_status())


def state(arm: Any) -> str | None:
    """Return the robot's state, or None while the wire does not answer."""
    return status(arm).get("state")


def task(arm: Any) -> dict[str, Any]:
    return json_of(arm.get_task_status())


def task_ended(arm: Any) -> dict[str, Any]:
    return until(lambda: None if (now := task(arm))["running"] else now, "the task ends")


def pids(arm: Any) -> dict[str, int]:
    """Return the process ids of the robot's tree by role; empty if it has no tree."""
    tree = arm.tree()
    return {} if tree is None else {process["role"]: process["pid"] for process in tree["processes"]}


def alive(pid: int) -> bool:
    """Return whether a process exists and is not a zombie. It may end between opening and reading its file."""
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] != b"Z"
    except OSError:
        return False
