"""The texts of the refusals of a mesh client: one function for each text."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

# -- commands


def not_a_command(value: str, actions: str) -> Refused:
    """Return the refusal of a value that is neither an action nor a mapping."""
    return Refused(Code.MALFORMED, f"the command is {value}", f'give an action, or {{"action": ...}}: {actions}')


def not_for_all(action: str, actions: str) -> Refused:
    reason = f"broadcast: {action} cannot be sent to all robots at once"
    return Refused(Code.ONE_ROBOT, reason, f"send one of {actions} to all robots, or name one robot")


# -- the robot's clock


def clock_not_read() -> Refused:
    return Refused(Code.CLOCK, "the robot's clock could not be read")


def clock_not_known() -> Refused:
    reason = "the robot's clock is not known, so no command was sent"
    return Refused(Code.CLOCK, reason, "check the network to the robot")


# -- robots that are missing or silent


def unknown_robot(robot: str, robots: str) -> Refused:
    return Refused(Code.UNREACHABLE, f"{robot} is not on the mesh", f"check the name. Robots on the mesh: {robots}")


def missing_robot(robot: str) -> Refused:
    return Refused(Code.UNREACHABLE, f"{robot} is not on the mesh")


def failed_search(detail: str) -> Refused:
    """Return the refusal that stands for the robots of a failed search."""
    return Refused(Code.UNREACHABLE, detail)


def no_answer(robot: str, within_s: float) -> Refused:
    remedy = "check that the robot's program runs, and that your certificate may command it"
    return Refused(Code.NO_ANSWER, f"{robot} gave no answer within {within_s:g} s", remedy)


def late_command(timeout: Exception, verb: str) -> Refused:
    reason = f"{timeout}. The command may have been carried out, and will not be carried out later"
    return Refused(Code.TIMEOUT, reason, "check with get_status()", verb=verb)


def silent_at_resume(robot: str, host: str, verb: str) -> Refused:
    return Refused(Code.UNREACHABLE, f"{robot} at {host} does not answer", "try again", verb=verb)


# -- the result of a stop


def silent_at_stop(robot: str, host: str, failure: Exception | None, verb: str) -> Refused:
    cause = f" ({failure})" if failure else ""
    consequence = "it is not known if it has stopped. It holds its position when its setpoint or lease expires"
    return Refused(
        Code.UNREACHABLE,
        f"{robot} at {host} does not answer{cause}: {consequence}",
        "look if the robot has stopped",
        verb=verb,
    )


def unreachable(detail: str, remedy: str) -> Refused:
    return Refused(Code.UNREACHABLE, detail, remedy)


def unconfirmed(robot: str, motors: str, detail: str, remedy: str) -> Refused:
    """Return the refusal after a stop that was not confirmed.

    Args:
        robot: The name of the robot.
        motors: The motors that have not confirmed the stop. Empty if they are not known.
        detail: Why they have not. May be empty.
        remedy: What to do.
    """
    added = f" ({detail})" if detail else ""
    return Refused(Code.UNCONFIRMED, f"{robot}: not confirmed by {motors or 'the robot'}{added}", remedy)


# -- refusals of the robot


def from_robot(fields: Mapping[str, str]) -> Refused:
    """Return the refusal that a robot has sent, by the names of its fields."""
    return Refused(**fields)


def without_code(error: str) -> Refused:
    """Return the refusal for an error that a robot has sent without a code. ``error`` may be empty."""
    return Refused(Code.ERROR, error or "the robot refused")
