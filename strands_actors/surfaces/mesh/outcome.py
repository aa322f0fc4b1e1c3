"""What a robot's answer says became of it."""

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
"""As ``supervisors/stop_result.py`` has it. ``match`` it exhaustively."""
SAFE: Verdict = "safe"
UNCONFIRMED: Verdict = "unconfirmed"
UNREACHABLE: Verdict = "unreachable"


class Outcome(msgspec.Struct, frozen=True):
    """What became of one robot. ``outcome``: safe, unconfirmed (it was ordered, and not every motor has
    confirmed it) or unreachable (nobody answered who could know). ``note``: of an e-stop whose lock
    ends with the tree, why."""

    robot: str
    outcome: Verdict
    detail: str = ""
    safe_state: str = ""
    path: str = ""
    locked: bool = False
    took_ms: float = 0.0  # on the robot: from its order to the last motor's confirmation
    motors: tuple[dict[str, Any], ...] = ()
    note: str = ""


def result_of(response: Response) -> dict[str, Any] | Refused:
    if response.refused is not None:
        return Refused(**{name: harmless(text) for name, text in msgspec.structs.asdict(response.refused).items()})
    if response.type != "response":
        return Refused(Code.ERROR, harmless(response.error) or "the robot refused")
    return response.result


def outcome_of(robot: str, result: Mapping[str, Any]) -> Outcome:
    """Whatever it answers: one that answers nonsense keeps nobody from hearing of the others."""
    listed = result.get("motors")
    motors = tuple(motor for motor in listed if isinstance(motor, dict)) if isinstance(listed, list | tuple) else ()
    detail = str(result.get("detail", ""))
    says_safe = result.get("outcome") == "safe"
    # A robot that had nothing to do names its safe state, and no motor.
    told = bool(motors or result.get("safe_state"))
    safe = says_safe and told and all(motor.get("safe") is True for motor in motors)
    if says_safe and not told:
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
