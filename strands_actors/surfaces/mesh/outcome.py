"""Read the result of a stop from a robot's answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.contract.shown import harmless
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.mesh.schemas import Response

Verdict = Literal["safe", "unconfirmed", "unreachable"]
"""As in ``supervisors/stop_result.py``. Handle all values in a ``match``."""
SAFE: Verdict = "safe"
UNCONFIRMED: Verdict = "unconfirmed"
UNREACHABLE: Verdict = "unreachable"


class Outcome(msgspec.Struct, frozen=True):
    """The result of a stop for one robot.

    Attributes:
        robot: Its name.
        outcome: ``safe``; ``unconfirmed``: the stop was ordered, and not every motor has confirmed it;
            ``unreachable``: there was no answer from the robot.
        detail: Why it is not safe.
        safe_state: The safe state.
        path: Which process has made it safe.
        locked: True after an e-stop, until a resume.
        took_ms: Time on the robot from its order to the last motor's confirmation.
        motors: The report of each motor.
        note: Why the lock of an e-stop ends with the tree; empty if it does not.
    """

    robot: str
    outcome: Verdict
    detail: str = ""
    safe_state: str = ""
    path: str = ""
    locked: bool = False
    took_ms: float = 0.0
    motors: tuple[dict[str, Any], ...] = ()
    note: str = ""


def result_of(response: Response) -> dict[str, Any] | Refused:
    """Return the result of a response, or its refusal."""
    if response.refused is not None:
        return Refused(**{name: harmless(text) for name, text in msgspec.structs.asdict(response.refused).items()})
    if response.type != "response":
        return Refused(Code.ERROR, harmless(response.error) or "the robot refused")
    return response.result


def outcome_of(robot: str, result: Mapping[str, Any]) -> Outcome:
    """Return the outcome of any answer. Never raises, so that a bad answer does not hide the outcomes of
    other robots. ``safe`` needs a confirmation of each motor."""
    listed = result.get("motors")
    motors = tuple(motor for motor in listed if isinstance(motor, dict)) if isinstance(listed, list | tuple) else ()
    detail = str(result.get("detail", ""))
    says_safe = result.get("outcome") == "safe"
    # A robot that had nothing to do reports its safe state, and no motor.
    has_evidence = bool(motors or result.get("safe_state"))
    safe = says_safe and has_evidence and all(motor.get("safe") is True for motor in motors)
    if says_safe and not has_evidence:
        detail = "it says that it is safe, and of no motor that it was read back"
    elif not detail and not safe:
        detail = ", ".join(
            f"{motor.get('axis')}: {motor.get('detail')}" for motor in motors if not motor.get("safe")
        )
    return Outcome(
        harmless(robot),
        SAFE if safe else UNCONFIRMED,
        harmless(detail),
        harmless(str(result.get("safe_state", ""))),
        harmless(str(result.get("path", ""))),
        bool(result.get("locked")),
        finite(result.get("took_ms")) or 0.0,
        motors,
        harmless(str(result.get("note", ""))),
    )
