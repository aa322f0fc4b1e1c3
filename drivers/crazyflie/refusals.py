"""Refusal codes (the reasons for refusing a command) that only the Crazyflie driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class CrazyflieCode(RefusalCode):
    """See ``docs/refusals.md``."""

    LOCKED = "locked", "the drone is locked after an emergency stop", "switch it off and on"
    CRASHED = "crashed", "the drone has crashed", "switch it off and on"
    TUMBLED = "tumbled", "the drone has tumbled", "put it on its feet"
    NOT_FLYING = "not_flying", "the drone stands on the floor", "call takeoff() first"
    HOVERING = "hovering", "the drone hovered for too long without a command", "take off again"
    CANNOT_ARM = "cannot_arm", "the drone's supervisor does not allow arming", "check the drone"
    TILTED = "tilted", "the drone is tilted", "put it on a level floor"
    STOP = "stop", "a stop command is called as a service", "call stop() or emergency_stop()"
    TAKEOFF = "takeoff", "the takeoff did not reach its height", "check the drone"
    LAND = "land", "the drone has not landed", "call stop(), or emergency_stop()"
