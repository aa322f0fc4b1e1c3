"""Refusals of this wire alone."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class KinovaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    STOPPED = "stopped", "the wire has stopped the arm by itself", "resume()"
    ARM_STATE = "arm_state", "the arm is not ready", "make it ready on the base's own page"
    BASE_IN_FAULT = "base_in_fault", "the base is in fault", "clear it, then reconnect"
