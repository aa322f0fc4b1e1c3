"""Refusal codes that only this wire uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class SpotCode(RefusalCode):
    """See ``docs/refusals.md``."""

    LEASE_LOST = "lease_lost", "another client has the body's lease", "let its owner return it, then resume()"
    ESTOP_LOST = "estop_lost", "the e-stop is not ours any more", "resume(), which sets it up anew"
    ESTOPPED = "estopped", "the robot is E-stopped", "release it"
    NO_ARM = "no_arm", "the robot has no arm, or no claw", "move its base"
    READ_ONLY = "read_only", "legs belong to the locomotion controller", "move its base"
    NOT_STANDING = "not_standing", "the robot does not stand", "look at the robot"
    NO_POWER = "no_power", "its motors are not powered on", "look at the robot"
