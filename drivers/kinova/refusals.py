"""Refusal codes (the reasons for refusing a command) that only the Kinova driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class KinovaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    STOPPED = "stopped", "the driver has stopped the arm by itself", "resume()"
    ARM_STATE = "arm_state", "the arm is not ready", "make it ready on the base's web page"
    BASE_IN_FAULT = "base_in_fault", "the base is in fault", "clear the fault, then reconnect"
