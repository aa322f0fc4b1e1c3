"""Refusal codes (the reasons for refusing a command) that only the Microduck driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


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
