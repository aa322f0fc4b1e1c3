"""Refusal codes that only this wire uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class MicroduckCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SEATED = "seated", "the duck sits", "stand()"
    NOT_DRIVEN = "not_driven", "no policy drives the duck", "enable()"
    SKILL = "skill", "a skill is no action", "do(skill=...)"
    NO_SKILL = "no_skill", "the robot has no such skill", "use one that is named"
    UNSUPPORTED = "unsupported", "this robotd does not have it", "update the robot"
    FALLEN = "fallen", "the duck has fallen", "put it on its feet"
    LIMP = "limp", "the duck yields", "put it on its feet"
    PICKED_UP = "picked_up", "the duck is held up", "put it on its feet"
