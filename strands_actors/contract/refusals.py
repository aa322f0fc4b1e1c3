"""The texts of the refusals of a driver's gates: one function for each text.

A gate decides, and a function of this module words the decision: the reason, the remedy, the refused value and the
accepted ones. The drivers of all robots use these texts. A driver has further ones in its own ``refusals`` module.
A caller that formats a limit rounds it inwards, so that the shown limit is accepted.
"""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

from .shown import SHOWN

CHECK_POWER = "check its cable and power. When it answers again, send the command again"
CHECK_NETWORK = "check the robot and the network"


# -- keys and values of an action


def empty_action(keys: str) -> Refused:
    return Refused(Code.EMPTY, "the action names no joint", f"use {keys}", "{}", keys)


def unknown_joint(key: str, robot: str, keys: str) -> Refused:
    return Refused(Code.UNKNOWN_JOINT, f"{key} is not a joint of {robot}", f"use {keys}", key, keys)


def both_spellings(key: str) -> Refused:
    both = f"{key} and {key}.pos"
    return Refused(Code.BOTH_SPELLINGS, f"{both} are both given", "send one of them", both, key)


def not_finite(key: str, value: str, description: str) -> Refused:
    """Return the refusal of a value that is no finite number.

    Args:
        key: The key or argument that has the value.
        value: The value, as it was given.
        description: The value for the text, such as ``the text '1.0'``.
    """
    return Refused(Code.NOT_FINITE, f"{key} is {description}", "send a finite number", value, "a finite number")


# -- readings


def no_position(axis: str, limit: str) -> Refused:
    return Refused(Code.STALE, f"no position from {axis} yet", CHECK_POWER, "yet", limit)


def stale_position(axis: str, age_ms: float, limit: str) -> Refused:
    age = f"for {age_ms:.0f} ms"
    return Refused(Code.STALE, f"no position from {axis} {age}", CHECK_POWER, age, limit)


def stale_report(code: RefusalCode, report: str, age: str, limit: str, remedy: str = CHECK_NETWORK) -> Refused:
    """Return the refusal of a command because the robot's last report is too old.

    Args:
        code: The code of the refusal.
        report: The report, such as ``last report of the mode``.
        age: Its age, with the unit.
        limit: The greatest age at which it counts, with the unit.
        remedy: What to check.
    """
    return Refused(code, f"{report} is {age} old (limit {limit})", remedy, age, limit)


# -- ranges and speeds


def past_travel(key: str, offered: str, unit: str, end: str, limit: str) -> Refused:
    return Refused(Code.PAST_TRAVEL, f"{key} {offered}{unit} is past {end}", f"stay within {limit}", offered, limit)


def too_fast(key: str, step: str, unit: str, period_ms: float, limit: str, target: float | None = None) -> Refused:
    """Return the refusal of a step that is too long for its time. ``target``: see ``or_move_to``."""
    reason = f"{key} steps {step}{unit} in {period_ms:.3g} ms"
    return Refused(Code.TOO_FAST, reason, or_move_to(f"step at most {limit}{unit}", key, target), step, limit)


def or_move_to(remedy: str, key: str, target: float | None) -> str:
    """Return a remedy that also names ``move_to``, which plans the steps to the target.

    Args:
        remedy: The remedy of a stream of targets.
        key: The axis.
        target: The target of a single command. None if ``move_to`` is no remedy: for a target of a stream, and for
            a robot that runs no planned motion. Then ``remedy`` is returned unchanged.
    """
    return remedy if target is None else f'{remedy}, or use move_to({{"{key}": {target:.4g}}}, seconds=2)'


# -- services


def unknown_service(robot: str, service: str, services: str) -> Refused:
    return Refused(
        Code.UNKNOWN_SERVICE, f"{robot} has no service {service}", f"it has {services}", service, services
    )


def unknown_argument(argument: str, arguments: str) -> Refused:
    return Refused(
        Code.UNKNOWN_ARGUMENT, f"unknown argument {argument}", f"it takes {arguments}", argument, arguments
    )


def bad_count(argument: str, value: object, most: int) -> Refused:
    return Refused(
        Code.BAD_ARGUMENT, f"{argument} is {value!r}", f"give a whole number, 1 to {most}", f"{value}", f"1..{most}"
    )


def bad_argument(argument: str, value: object, limit: str) -> Refused:
    text = str(value)[:SHOWN]
    return Refused(Code.BAD_ARGUMENT, f"{argument} is {text!r}", f"give {limit}", text, limit)


def robot_stopped() -> Refused:
    return Refused(Code.DISARMED, "the robot was stopped", "call resume() first")
