"""Refusal codes that only simulated robots have."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class SimCode(RefusalCode):
    """See ``docs/refusals.md``."""

    NOT_HELD = "not_held", "a joint is not held by the simulation", "resume()"
    WIRE = "wire", "the simulation refuses it", "follow the text"
