"""Refusal codes that only this wire uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class BoosterCode(RefusalCode):
    """See ``docs/refusals.md``."""

    FALLEN = "fallen", "the robot lies on the ground, or falls", "stand it up"
    CUSTOM_MODE = "custom_mode", "another program has set the robot's mode", "bring it to walking mode"
    TOO_FEW_MOTORS = "too_few_motors", "the robot reports fewer motors than a T1 has", "check that it is a T1"
    UPPER_BODY = "upper_body", "the arms are not ours to move", "enable_upper_body()"
    UNKNOWN_MODE = "unknown_mode", "there is no such mode", "use one that is named"
    FALL_UNKNOWN = "fall_unknown", "its fall state is not known", "check its topic"
    FALL_STALE = "fall_stale", "the last report of its fall state is too old", "check the robot and the network"
    NOT_OURS = "not_ours", "the joint belongs to the onboard controller", "use one that is named"
    NOT_A_JOINT = "not_a_joint", "a speed is given as a joint", "move(vx, vy, vyaw)"
    NOT_CONFIRMED = "not_confirmed", "the robot has not answered a service", "look at the robot"
    STATUS = "status", "the robot answers a service with an error", "look at the robot"
