"""Read the result of a stop from a robot's answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.contract.shown import harmless
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import Response

from . import refusals

Verdict = Literal["safe", "unconfirmed", "unreachable"]
"""As in ``supervisors/stop_result.py``. Handle all values in a ``match``."""
SAFE: Verdict = "safe"
UNCONFIRMED: Verdict = "unconfirmed"
UNREACHABLE: Verdict = "unreachable"


class Outcome(msgspec.Struct, frozen=True):
    """The result of a stop for one robot.

    Attributes:
        robot: The name of the robot.
        outcome: ``safe``; ``unconfirmed``: the stop was ordered, and not every motor has confirmed it;
            ``unreachable``: there was no answer from the robot.
        detail: Why the robot is not confirmed safe. Empty if it is.
        safe_state: The safe state that the robot was brought to, for example limp or hold.
        path: The connection by which the robot was stopped: ``wire``, or ``stop_channel`` of the root process.
        locked: True after an e-stop, until a resume.
        took_ms: Time in milliseconds from the order of the stop to the last motor's confirmation, measured on
            the robot.
        motors: The report of each motor.
        note: Why the lock of an e-stop ends when the robot's processes end. Empty if the lock outlives them.
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
    """Return the result in a robot's response, or the refusal in it."""
    if response.refused is not None:
        fields = msgspec.structs.asdict(response.refused)
        return refusals.from_robot({name: harmless(text) for name, text in fields.items()})
    if response.type != "response":
        return refusals.without_code(harmless(response.error))
    return response.result


def outcome_of(robot: str, result: Mapping[str, Any]) -> Outcome:
    """Convert an answer of a robot to an outcome. The outcome is ``safe`` only if every motor has confirmed it.

    A malformed answer raises no exception, so that it does not hide the outcomes of other robots.
    """
    listed = result.get("motors")
    motors = tuple(motor for motor in listed if isinstance(motor, dict)) if isinstance(listed, list | tuple) else ()
    detail = str(result.get("detail", ""))
    says_safe = result.get("outcome") == "safe"
    # A robot that had no motor to stop reports its safe state, but no motors.
    has_evidence = bool(motors or result.get("safe_state"))
    safe = says_safe and has_evidence and all(motor.get("safe") is True for motor in motors)
    if says_safe and not has_evidence:
        detail = "the robot reported safe, but did not report that any motor was read"
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
