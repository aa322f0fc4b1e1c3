"""Refusal codes (the reasons for refusing a command) that only the Spot driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class SpotCode(RefusalCode):
    """See ``docs/refusals.md``."""

    LEASE_LOST = (
        "lease_lost",
        "another client has the body's lease",
        "let its owner return the lease, then resume()",
    )
    ESTOP_LOST = (
        "estop_lost",
        "our e-stop endpoint is no longer in force",
        "call resume(), which sets up the e-stop again",
    )
    ESTOPPED = "estopped", "the robot is E-stopped", "release the e-stop"
    NO_ARM = "no_arm", "the robot has no arm, or no claw", "move the robot's base"
    READ_ONLY = "read_only", "only the robot's own controller moves legs", "move the robot's base"
    NOT_STANDING = "not_standing", "the robot does not stand", "check the robot"
    NO_POWER = "no_power", "the motors are not powered on", "check the robot"
