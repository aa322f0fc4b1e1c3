"""Refusal codes that only robots with a user's driver class have."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class PlainCode(RefusalCode):
    """See ``docs/refusals.md``."""

    REFUSED_BY_DRIVER = "refused_by_driver", "the robot's own driver refused a command", "resume()"
