"""What the tests of any robot read: the envelopes of its verbs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

T = TypeVar("T")

PATIENCE_S = 20.0
"""Of a test that waits for something that takes far less on a free machine."""


def resumed(robot: Any) -> None:
    """Arm it. Legs on a busy machine are let go again, and are taken up anew; a failure says why each
    attempt failed."""
    refusals: list[str] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while (answer := robot.resume())["status"] != "success":
        refusals.append(why(answer))
        assert time.monotonic() < deadline_s, f"not armed within {PATIENCE_S:g} s: {refusals}"
        time.sleep(0.01)


def until(look: Callable[[], T | None], what: str, within_s: float = PATIENCE_S) -> T:
    """Look until there is something to see."""
    deadline_s = time.monotonic() + within_s
    while not (seen := look()):
        assert time.monotonic() < deadline_s, f"not within {within_s:g} s: {what}"
        time.sleep(0.01)
    return seen


def json_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """The json of a success envelope."""
    assert answer["status"] == "success", answer
    (block,) = answer["content"]
    json: dict[str, Any] = block["json"]
    return json


def why(answer: Mapping[str, Any]) -> str:
    """The text of an error envelope."""
    assert answer["status"] == "error", answer
    text: str = answer["content"][0]["text"]
    return text


def status(arm: Any) -> dict[str, Any]:
    return json_of(arm.get_status())


def state(arm: Any) -> str | None:
    """None while the wire does not answer."""
    return status(arm).get("state")


def task(arm: Any) -> dict[str, Any]:
    return json_of(arm.get_task_status())


def task_ended(arm: Any) -> dict[str, Any]:
    return until(lambda: None if (now := task(arm))["running"] else now, "the task ends")


def pids(arm: Any) -> dict[str, int]:
    """The processes of its tree, by role."""
    tree = arm.tree()
    return {} if tree is None else {process["role"]: process["pid"] for process in tree["processes"]}
