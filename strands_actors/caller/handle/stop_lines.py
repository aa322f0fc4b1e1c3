"""Describe the result of a stop in one line for people."""

from __future__ import annotations

from typing import assert_never

from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult, Unconfirmed, Unreachable

from ..processes import directory


async def stop_by_name(robot: str, by: str) -> str:
    """Stop a robot of this user, and return the result in one line.

    It never raises, since this line is all that the user of a stop button sees.

    Args:
        robot: Name of the robot.
        by: The name of the sender, for the audit.
    """
    try:
        async with directory.join() as joined:
            for note in joined.notes:
                if note.robot == robot:
                    return line_of(await joined.stop(note, Reason.STOP, by))
    except OSError as failure:
        return f"NOT CONFIRMED: {failure}. Cut its power if it still moves"
    return f"NOT CONFIRMED: no tree of {robot} is found. Cut its power if it still moves"


def line_of(result: StopResult) -> str:
    """Describe in one line whether every motor confirmed the safe state after a stop, and what to do if not."""
    match result:
        case Unreachable():
            return f"NOT CONFIRMED: {result.text}"
        case Unconfirmed():
            named = ", ".join(f"{m.axis} (id {m.id}): {m.detail}" for m in result.unsafe)
            return f"NOT CONFIRMED by {named or 'the robot'}. Cut its power if it still moves"
        case Confirmed(proof):
            return _confirmed(proof)
        case _:
            assert_never(result)


def _confirmed(proof: StopReport | NothingRan) -> str:
    match proof:
        case NothingRan(why):
            return why
        case StopReport(motors=()):
            return f"{proof.safe_state}, it was already"
        case StopReport():
            how = " by the stop channel" if proof.path == "stop_channel" else ""
            count = len(proof.motors)
            motors = "1 motor" if count == 1 else f"{count} motors"
            return f"{proof.safe_state}, {motors} confirmed in {proof.took_ms:.1f} ms{how}"
        case _:
            assert_never(proof)
