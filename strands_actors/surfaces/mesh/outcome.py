"""What a robot's answer says became of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import Response


class Outcome(msgspec.Struct, frozen=True):
    """What became of one robot. ``outcome``: safe, unconfirmed (told, and not known to be safe) or
    unreachable. ``note``: of an e-stop whose lock ends with the tree, why."""

    robot: str
    outcome: str
    detail: str = ""
    safe_state: str = ""
    path: str = ""
    locked: bool = False
    took_ms: float = 0.0  # on the robot: from its order to the last motor's confirmation
    motors: tuple[dict[str, Any], ...] = ()
    note: str = ""


def result_of(response: Response) -> dict[str, Any] | Refused:
    if response.refused is not None:
        return Refused(**msgspec.structs.asdict(response.refused))
    if response.type != "response":
        return Refused("error", response.error or "the robot refused")
    return response.result


def outcome_of(robot: str, result: Mapping[str, Any]) -> Outcome:
    motors = tuple(motor for motor in result.get("motors", ()) if isinstance(motor, dict))
    detail = str(result.get("detail", ""))
    if not detail and result.get("outcome") != "safe":
        detail = ", ".join(
            f"{motor.get('axis')}: {motor.get('detail')}" for motor in motors if not motor.get("safe")
        )
    return Outcome(
        robot,
        "safe" if result.get("outcome") == "safe" else "unconfirmed",
        detail,
        str(result.get("safe_state", "")),
        str(result.get("path", "")),
        bool(result.get("locked")),
        float(result.get("took_ms", 0.0)),
        motors,
        str(result.get("note", "")),
    )
