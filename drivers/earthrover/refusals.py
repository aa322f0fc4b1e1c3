"""Refusal codes of the EarthRover driver."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class EarthRoverCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SERVICE = "service", "the SDK process answers with an error", "look at the SDK process"
