"""Refusal codes (the reasons for refusing a command) that only the T1 driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class BoosterCode(RefusalCode):
    """See ``docs/refusals.md``."""

    FALLEN = "fallen", "the robot lies on the ground, or falls", "stand it up"
    CUSTOM_MODE = "custom_mode", "another program has set custom mode", "switch the robot to walking mode"
    TOO_FEW_MOTORS = "too_few_motors", "the robot reports fewer motors than a T1 has", "check that it is a T1"
    UPPER_BODY = "upper_body", "the robot has not given its arms to this program", "call enable_upper_body()"
    UNKNOWN_MODE = "unknown_mode", "there is no such mode", "use one of the listed modes"
    FALL_UNKNOWN = "fall_unknown", "the robot has not reported its fall state", "check the robot's fall_down topic"
    FALL_STALE = (
        "fall_stale",
        "the last report of the robot's fall state is too old",
        "check the robot and the network",
    )
    NOT_OURS = "not_ours", "only the onboard controller may move the joint", "use one of the listed joints"
    NOT_A_JOINT = "not_a_joint", "a speed of the base is given as a joint", "call move(vx, vy, vyaw)"
    NOT_CONFIRMED = (
        "not_confirmed",
        "the robot has not answered a request and may still carry it out",
        "check what the robot does",
    )
    STATUS = "status", "the robot answered a request with an error", "check the robot"
