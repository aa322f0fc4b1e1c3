"""Refusal codes that only this wire uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class CrazyflieCode(RefusalCode):
    """See ``docs/refusals.md``."""

    LOCKED = "locked", "the drone is locked after an emergency stop", "switch it off and on"
    CRASHED = "crashed", "the drone has crashed", "switch it off and on"
    TUMBLED = "tumbled", "the drone has tumbled", "put it on its feet"
    NOT_FLYING = "not_flying", "the drone stands on the floor", "takeoff()"
    HOVERING = "hovering", "the drone hovered for too long without a command", "take off again"
    CANNOT_ARM = "cannot_arm", "the drone's supervisor does not allow arming", "check the drone"
    TILTED = "tilted", "the drone is tilted", "put it on a level floor"
    STOP = "stop", "the service is an order to stop", "stop()"
    TAKEOFF = "takeoff", "the drone is not at its height", "look at the drone"
    LAND = "land", "the drone has not landed", "stop(), or emergency_stop()"
