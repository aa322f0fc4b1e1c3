"""The texts of the gate's refusals: one function for each text."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_LATER = "wait until it is done"
_RESUME_AGAIN = "call resume() again when the stop is confirmed"


# -- the shape of an action


def too_many_keys(count: int, limit: int) -> Refused:
    return Refused(
        Code.TOO_MANY_KEYS, f"the action has {count} keys", f"give at most {limit}", str(count), str(limit)
    )


def not_a_mapping(type_name: str) -> Refused:
    return Refused(Code.NOT_A_MAPPING, f"the action is a {type_name}", "give a mapping of joints to numbers")


# -- the mode of the robot


def locked_out(locked_by: str) -> Refused:
    return Refused(Code.LOCKED_OUT, _locked(locked_by), "resume() lifts the lockout")


def ending(cause: str) -> Refused:
    """Return the refusal that every command gets while the robot's processes are being ended."""
    return Refused(Code.ENDING, f"the robot's processes are being ended ({cause})", "start the robot again")


def restarts_spent() -> Refused:
    return not_connected_for_motion("the restart budget is spent")


def not_connected_for_motion(reason: str) -> Refused:
    return Refused(Code.NOT_CONNECTED, f"not connected: {reason}", "call connect_eagerly() first")


def not_connected(reason: str) -> Refused:
    """Return the refusal of a service or a resume."""
    return Refused(Code.NOT_CONNECTED, f"not connected: {reason}")


def arming() -> Refused:
    return Refused(Code.ARMING, "the robot is being energised", "try again when it is armed")


def not_armed(code: Code, mode: str, cause: str, because: str) -> Refused:
    """Return the refusal of a motion, because the robot was stopped.

    Args:
        code: Whether a stop or a fault ended the motion.
        mode: The mode of the robot.
        cause: Why the robot is in this mode, for people; may be empty.
        because: The same for programs; may be empty.
    """
    return Refused(code, f"the robot is {mode}{_in_brackets(cause)}", "call resume() first", because=because)


# -- leases


def no_lease() -> Refused:
    return Refused(Code.NO_LEASE, "no writer holds the lease", "acquire it first")


def lease_of_another(holder: str) -> Refused:
    """Return the refusal of a command from a writer that does not hold the lease."""
    return Refused(Code.LEASE, _held(holder), "wait until it is released")


def lease_taken(holder: str) -> Refused:
    """Return the refusal to give a lease."""
    return Refused(Code.LEASE, _held(holder), "wait until it is released, or stop it")


def no_script_lease(channel: str) -> Refused:
    reason = f"{channel} may write only under the lease of the script that started it"
    return Refused(Code.CHANNEL, reason, "name that lease")


def script_lease_ended() -> Refused:
    return Refused(Code.LEASE, "the lease of the script that started the policy has ended", "acquire it again")


def stopped_since_policy_start() -> Refused:
    return Refused(Code.STOPPED, "the robot was stopped after the policy was started", "start the policy again")


# -- the epoch and the time of a command


def stale_epoch(offered: int, current: int, cause: str, because: str) -> Refused:
    """Return the refusal of a command that was made in an earlier epoch.

    Args:
        offered: The epoch of the command.
        current: The present epoch.
        cause: Why the robot has stopped or held, for people; may be empty.
        because: The same for programs; may be empty.
    """
    reason = f"the robot has stopped or held since this command was made{_in_brackets(cause)}"
    return Refused(Code.STALE_EPOCH, reason, "send it again", str(offered), str(current), because=because)


def expired(late_ms: float) -> Refused:
    return Refused(Code.EXPIRED, f"the command is {late_ms:.1f} ms past its deadline")


def too_distant(ahead_s: float, limit_s: float) -> Refused:
    reason = f"the deadline is {ahead_s:.1f} s away"
    return Refused(Code.TOO_DISTANT, reason, f"give a deadline within {limit_s:g} s")


def latched(robot: str, longest_s: float) -> Refused:
    limit = f"{longest_s:g} s"
    reason = f"{robot} accepts no command without an end"
    return Refused(Code.LATCHED, reason, f"give a lifetime of at most {limit}", "latched", limit)


# -- observations


def not_read_yet() -> Refused:
    return Refused(Code.NO_OBSERVATION, "the robot has not been read yet", "wait for the first observation")


def stale_reading(age_s: float, limit_s: float) -> Refused:
    age = f"{age_s:.1f} s"
    reason = f"the newest reading is {age} old"
    return Refused(Code.STALE, reason, "check the robot's cable and power", age, f"{limit_s:g} s")


# -- services of the driver


def running_service() -> Refused:
    """Return the refusal of a setpoint."""
    return Refused(Code.BUSY, "a service of the robot is running", _LATER)


def other_running_service() -> Refused:
    """Return the refusal of a service."""
    return Refused(Code.BUSY, "another service is running", _LATER)


def command_as_service() -> Refused:
    return Refused(Code.A_COMMAND, "this service is a motion command", "send its arguments with send_action()")


def busy_for_service(mode: str) -> Refused:
    return Refused(Code.BUSY, f"the robot is {mode}", "try again when it is armed or stopped")


def in_motion() -> Refused:
    return Refused(Code.LIVE, "the robot is moving", "wait until the motion has ended, or call stop()")


# -- resumes


def stopped_since_resume() -> Refused:
    return resume_stopped("the robot was stopped after resume() was called")


def resume_stopped(cause: str) -> Refused:
    return Refused(Code.STOPPED, cause, _RESUME_AGAIN)


def resume_locked_out(locked_by: str) -> Refused:
    return Refused(Code.LOCKED_OUT, _locked(locked_by), "an operator's resume() lifts the lockout")


def no_standby(problem: str) -> Refused:
    reason = f"a process that could stop the robot is missing: {problem}"
    return Refused(Code.NO_STANDBY, reason, "try again in a moment, since this process is being started")


def busy_for_resume(mode: str) -> Refused:
    return Refused(Code.BUSY, f"the robot is {mode}", _RESUME_AGAIN)


def stop_unconfirmed(motors: Sequence[str]) -> Refused:
    """Return the refusal of a resume that had to stop the robot first. ``motors`` have not confirmed the stop."""
    named = ", ".join(motors) or "it"
    reason = f"the robot must be stopped first, and {named} has not confirmed the stop"
    return Refused(Code.UNCONFIRMED, reason, "check the robot, then call resume()")


def _locked(locked_by: str) -> str:
    return f"e-stopped by {locked_by}"


def _held(holder: str) -> str:
    return f"{holder} holds the lease"


def _in_brackets(cause: str) -> str:
    return f" ({cause})" if cause else ""
