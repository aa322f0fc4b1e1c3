"""The responses of the services: what a robot has confirmed, in the form of std_srvs/srv/Trigger. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.contract.shown import harmless
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.outcome import SAFE, UNREACHABLE, Outcome


def of_stop(outcome: Outcome) -> dict[str, Any]:
    """Return the response to ``stop`` or ``estop``: the report of each motor."""
    if outcome.outcome == UNREACHABLE:
        remedy = f"Run `strands-actors stop {outcome.robot}` on its computer, or cut its power"
        return _response(False, f"{outcome.robot}: NOT CONFIRMED: {outcome.detail}. {remedy}")
    motors = ", ".join(_motor(motor) for motor in outcome.motors)
    if outcome.outcome != SAFE:
        detail = outcome.detail or motors or "no motor has confirmed"
        return _response(False, f"{outcome.robot}: NOT CONFIRMED: {detail}. Cut its power if it still moves")
    text = f"{outcome.robot}: {outcome.safe_state}"
    text += f", in {outcome.took_ms:.1f} ms: {motors}" if motors else " already, before this stop"
    return _response(True, f"{text}. It is locked until `resume`" if outcome.locked else text)


def of_resume(robot: str, answer: Mapping[str, Any] | Refused) -> dict[str, Any]:
    """Return the response to ``resume``: the new epoch, or the robot's refusal."""
    if isinstance(answer, Refused):
        return _response(False, f"{robot}: {answer.text}")
    return _response(True, f"{robot}: armed at the measured position, epoch {answer.get('epoch')}")


def of_flood(robot: str, service: str, calls: int) -> dict[str, Any]:
    """Return the response to a call that is not carried out, because many calls of the service are under way."""
    return _response(False, f"{robot}: {calls} calls of {service} are under way already. Wait for their responses")


def _motor(motor: Mapping[str, Any]) -> str:
    axis = motor.get("axis", "a motor")
    return f"{axis} confirmed" if motor.get("safe") is True else f"{axis} NOT confirmed ({motor.get('detail')})"


def _response(success: bool, message: str) -> dict[str, Any]:
    return {"success": success, "message": harmless(message)}
