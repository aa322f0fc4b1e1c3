"""The refusals of the Microduck driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

INTENTS = "move (vx, vy, vyaw), head (neck_pitch ...), pose (z, roll, pitch, active), mouth (open) or do(skill=...)"


class MicroduckCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SEATED = "seated", "the duck sits", "call stand() first"
    NOT_DRIVEN = "not_driven", "no walking policy drives the duck", "call enable() first"
    SKILL = "skill", "a skill is a service, not a target", "call do(skill=...)"
    NO_SKILL = "no_skill", "the robot has no such skill", "use one of the listed skills"
    UNSUPPORTED = "unsupported", "this version of robotd lacks the function", "update the robot"
    FALLEN = "fallen", "the duck has fallen", "put it on its feet"
    LIMP = "limp", "the duck is limp: its motors yield to a push", "put it on its feet"
    PICKED_UP = "picked_up", "the duck is held up", "put it on its feet"


# -- actions


def skill_as_target(skill: str) -> Refused:
    return Refused(
        MicroduckCode.SKILL,
        "a skill is a service, not a target",
        f"call do(skill={skill!r})",
        skill,
        "do(skill=...)",
    )


def unknown_command(key: str, robot: str, axes: str) -> Refused:
    reason = f"{key} is not a command of {robot}: robotd accepts no joint targets"
    return Refused(Code.UNKNOWN_JOINT, reason, f"use {INTENTS}", key, axes)


def active_not_boolean(value: str) -> Refused:
    return Refused(Code.NOT_FINITE, f"active is {value}", "give true or false", value, "true, false")


def pose_ended_and_given(key: str) -> Refused:
    reason = f"active=False ends the pose, and {key} is given"
    return Refused(Code.BOTH, reason, "send only one of the two", key, "active=False alone")


def bad_duration(key: str, value: str, shortest_s: float, longest_s: float) -> Refused:
    limit = f"{shortest_s:g}..{longest_s:g} s"
    return Refused(Code.DURATION, f"{key} is {value}", f"give {limit}", value, limit)


def duration_without_twist(key: str, value: str, speeds: str) -> Refused:
    reason = f"{key} applies to a twist, and none is given"
    return Refused(Code.DURATION, reason, f"name one of {speeds}", value, speeds)


# -- gates and conditions


def no_state(age_ms: float, limit: str) -> Refused:
    age = f"{age_ms:.0f} ms"
    remedy = "check robotd. Commands are accepted after its next state"
    return Refused(Code.STALE, f"no state for {age}", remedy, age, limit)


def seated() -> Refused:
    return Refused(MicroduckCode.SEATED, "the duck sits", "call stand() first", "sitting", "standing")


def unknown_mode(modes: str) -> Refused:
    reason = "the drive mode is unknown or not supported"
    return Refused(Code.MODE, reason, f"call set_mode(mode=...) with one of {modes}", "unknown", modes)


def past_speed_limit(key: str, value: float, unit: str, most: float, mode: str) -> Refused:
    reason = f"{key}={value:g} {unit} is over {most:g} for {mode}"
    limit = f"{most:g} {unit}"
    return Refused(Code.PAST_TRAVEL, reason, f"stay within {limit}", f"{value:g}", limit)


def past_combined_speed_limit(speed_m_s: float, most_m_s: float, mode: str) -> Refused:
    reason = f"vx and vy are {speed_m_s:.3f} m/s, over {most_m_s:g} for {mode}"
    limit = f"{most_m_s:g} m/s"
    return Refused(Code.PAST_TRAVEL, reason, f"stay within {limit}", f"{speed_m_s:.3f}", limit)


def not_on_its_feet(code: MicroduckCode, state: str) -> Refused:
    return Refused(code, f"the duck {state}", "put it on its feet", state, "on its feet")


def not_driven() -> Refused:
    return Refused(
        MicroduckCode.NOT_DRIVEN,
        "the duck holds still or is relaxed: no policy drives it",
        "call enable() first",
        "held",
        "driven",
    )


# -- services


def not_confirmed(service: str, effect: str, key: str, value: str) -> Refused:
    """Return the refusal of a service that needs a confirmation.

    Args:
        service: The service.
        effect: What the service does to the robot.
        key: The argument that confirms the service.
        value: The value of this argument, as it was given.
    """
    return Refused(Code.UNCONFIRMED, effect, f"call {service}({key}=True)", value, "true")


def walking() -> Refused:
    return Refused(Code.LIVE, "the robot walks", "wait until the walk ends, or call stop()")


def no_such_skill(skill: str, skills: str) -> Refused:
    return Refused(MicroduckCode.NO_SKILL, f"the robot has no skill {skill}", f"it has {skills}", skill, skills)


def unsupported_function(api_version: int, needed_version: int) -> Refused:
    reason = f"robotd (API {api_version}) does not have this function"
    return Refused(MicroduckCode.UNSUPPORTED, reason, "update the robot", str(api_version), str(needed_version))


def sitting_not_reported(api_version: int, needed_version: int, skill: str) -> Refused:
    """Return the refusal to sit or stand, because robotd does not report whether the duck sits.

    Args:
        api_version: Version of robotd's API.
        needed_version: The first version that reports it.
        skill: The skill that toggles between both.
    """
    reason = f"robotd (API {api_version}) does not report whether the duck sits"
    remedy = f"update the robot, or look at the duck, then call do(skill={skill!r})"
    return Refused(MicroduckCode.UNSUPPORTED, reason, remedy, str(api_version), str(needed_version))


def robotd_error(message: str, code: int) -> Refused:
    return Refused(Code.ROBOT, f"robotd answered with an error: {message} ({code})", "check the robot")


def refused_by_robotd(reason: str) -> Refused:
    return Refused(Code.ROBOT, f"robotd refused the request: {reason or 'no reason given'}", "check the robot")
