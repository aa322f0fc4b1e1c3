"""The texts of the mesh's refusals: one function for each text.

These functions leave the verb empty. The caller adds it by ``about``.
"""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

SENDER = "<your name>"
"""Stands for the sender's name in the key of a remedy."""

# -- actions of strands-robots that are missing here

_TELEOP = (
    "a robot follows no input stream of another peer",
    "run the teleoperation on the robot's computer, or send acquire and then move",
)
_CALL = (
    "a robot's tool cannot be called over the mesh",
    "use the tool with an agent or an MCP client on the robot's computer",
)
MISSING_ACTIONS: Mapping[str, tuple[str, str]] = {
    "call": _CALL,
    "sim_call": _CALL,
    "teleop_receive": _TELEOP,
    "teleop_stop": _TELEOP,
}
"""Actions of strands-robots that are missing here, with the reason and the remedy."""


# -- the form of a message


def invalid_message(error: Exception) -> Refused:
    remedy = 'send {"sender_id", "turn_id", "command": {"action", ...}}'
    return Refused(Code.MALFORMED, f"the message is no valid command: {error}", remedy)


def oversized(size_bytes: int, limit_bytes: int) -> Refused:
    remedy = f"send at most {limit_bytes} bytes"
    return Refused(Code.OVERSIZED, f"{size_bytes} bytes", remedy, str(size_bytes), str(limit_bytes))


def invalid_json(error: Exception) -> Refused:
    return Refused(Code.MALFORMED, f"the command is no valid JSON: {error}", 'send {"action": ...}')


def missing_action(action: str, reason: str, remedy: str) -> Refused:
    """Return the refusal of an action in ``MISSING_ACTIONS``, with the reason and the remedy from there."""
    return Refused(Code.NOT_HERE, f"the action {action!r} is not available: {reason}", remedy, action)


def unknown_action(action: str, actions: str) -> Refused:
    return Refused(Code.UNKNOWN_ACTION, f"{action!r} is no action of this robot", f"send {actions}", action)


def invalid_fields(error: Exception) -> Refused:
    return Refused(Code.MALFORMED, str(error))


# -- the sender and the robot of a command. ``key`` is the key for queries, with ``SENDER`` in it


def unnamed_sender(key: str) -> Refused:
    reason = "the key of the query does not end with the name of its sender"
    return Refused(Code.MALFORMED, reason, _send_query(key))


def published_command(action: str, key: str) -> Refused:
    reason = "the sender of a published command is not known, and its answer is public"
    return Refused(Code.PUT, reason, _send_query(key), action)


def published_resume(key: str) -> Refused:
    return Refused(Code.PUT, "the sender of a published resume is not known", _send_query(key))


def _send_query(key: str) -> str:
    """Return the remedy for a published command (zenoh put) that must be sent as a query (zenoh get)."""
    return f"send it as a zenoh query (get) on {key}"


def other_robot(target: str, robot: str) -> Refused:
    reason = f"it is for {target!r}, and this is {robot}"
    return Refused(Code.TARGET, reason, "send it on the key of that robot", target)


def no_reply_requested() -> Refused:
    reason = "the message was sent without a request for a reply"
    return Refused(Code.NOT_A_REQUEST, reason, "send it as a request")


# -- rate, clock and repetition


def too_many_commands(most_per_s: int) -> Refused:
    reason = f"this sender sent more than {most_per_s} commands a second"
    return Refused(Code.RATE, reason, "send fewer commands", limit=f"{most_per_s}")


def clock_not_read(sender: str, ttl_s: float) -> Refused:
    reason = f"{sender} has not read this robot's clock in the last {ttl_s:g} s"
    return Refused(Code.CLOCK, reason, "send sync first")


def no_session(ttl_s: float) -> Refused:
    """Return the refusal of a command from a caller on another host that has not read the clock in time."""
    reason = f"you have not read this robot's clock in the last {ttl_s:g} s"
    return Refused(Code.CLOCK, reason, "send Sync first")


def repeated_turn(sender: str, turn: str) -> Refused:
    reason = f"{sender} has already used the turn_id {turn}"
    return Refused(Code.DUPLICATE, reason, "give each command a new turn_id")


# -- the lease, and the robot's mode


def no_lease(sender: str) -> Refused:
    return Refused(Code.LEASE, f"{sender} holds no lease of this robot", "acquire it first")


def no_lease_in_session() -> Refused:
    return Refused(Code.LEASE, "this session holds no lease with this number", "acquire a lease first")


def stale_lease(lease_epoch: int, command_epoch: int) -> Refused:
    reason = f"the lease was given in epoch {lease_epoch}, the command has {command_epoch}"
    return Refused(Code.STALE_EPOCH, reason, "acquire it again")


def locked_out(locked_by: str) -> Refused:
    return Refused(Code.LOCKED_OUT, f"e-stopped by {locked_by}", "resume the robot to unlock it")


def not_writable(mode: str, cause: str) -> Refused:
    """Return the refusal of a lease in a mode without setpoints. ``cause`` may be empty."""
    added = f" ({cause})" if cause else ""
    return Refused(Code.DISARMED, f"the robot is {mode}{added}", "resume the robot first")


def holding(cause: str) -> Refused:
    return Refused(Code.HOLDING, f"the robot holds ({cause})", "resume the robot first")


# -- motions


def no_rollout(robot: str, reason: str) -> Refused:
    return Refused(Code.NO_ROLLOUT, f"{robot}: {reason}")


def too_long(robot: str, duration_s: float, longest_s: float) -> Refused:
    reason = f"{robot} cannot keep a command for {duration_s:g} s"
    remedy = f"give a duration of at most {longest_s:g} s, or run a policy"
    return Refused(Code.TOO_LONG, reason, remedy, f"{duration_s:g}", f"{longest_s:g}")


def no_simulation(robot: str) -> Refused:
    return Refused(
        Code.NO_SIMULATION, f"{robot} is no simulation", "use start, set_joints or move for a real robot"
    )


def unconfirmed_reset() -> Refused:
    return Refused(Code.UNCONFIRMED, "the simulated robot did not confirm the stop", "try again")


# -- policies


def policy_running() -> Refused:
    return Refused(Code.RUNNING, "a policy is already running", "stop it first")


def policy_not_started(failure: Exception) -> Refused:
    return Refused(Code.TIMEOUT, f"{failure}, so the policy was not started", "try again")


def policy_path(provider: str) -> Refused:
    """Return the refusal of a path to code in place of the name of a policy."""
    reason = f"policy_provider is {provider!r}"
    return Refused(
        Code.BAD_POLICY, reason, "give the name of a policy that is installed on the robot's host", provider
    )


def policy_host_not_allowed(host: str, hosts: str, variable: str) -> Refused:
    """Return the refusal of the host of a policy server.

    Args:
        host: The host.
        hosts: The hosts that are always allowed.
        variable: The environment variable that allows further hosts.
    """
    reason = f"policy_host is {host!r}"
    return Refused(
        Code.BAD_POLICY, reason, f"use {hosts}, or a host in the variable {variable} of the robot's host"
    )


def unusable_policy(error: Exception) -> Refused:
    return Refused(Code.BAD_POLICY, str(error))


# -- processes that do not answer


def silent_gate() -> Refused:
    return Refused(Code.NO_ANSWER, "the robot's gate did not answer", "try again")


def silent_wire(failure: Exception) -> Refused:
    return _silent_wire(failure, "call resume when the robot answers again")


def silent_wire_at_resume(failure: Exception) -> Refused:
    return _silent_wire(failure, "try again")


def silent_wire_elsewhere(failure: Exception) -> Refused:
    """Return the refusal of a message from a caller on another host, because the wire process is silent."""
    return _silent_wire(failure, "resume it")


def _silent_wire(failure: Exception, remedy: str) -> Refused:
    return Refused(Code.UNREACHABLE, f"the process that talks to the robot does not answer ({failure})", remedy)


def resume_under_way() -> Refused:
    return Refused(Code.BUSY, "another resume is being carried out", "wait for its answer")
