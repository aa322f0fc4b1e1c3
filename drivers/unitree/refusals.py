"""Refusal codes that only the Unitree driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class UnitreeCode(RefusalCode):
    """See ``docs/refusals.md``."""

    FSM = "fsm", "the robot's state machine accepts no commands in this state", "select one of the named states"
    FSM_UNKNOWN = "fsm_unknown", "the robot does not report the state of its state machine", "check the robot"
    FSM_STALE = "fsm_stale", "the last report of the state machine is too old", "check the network"
    SPORT_MODE = "sport_mode", "the onboard mode is active", "release_sport_mode()"
    SPORT_MODE_UNKNOWN = "sport_mode_unknown", "the onboard mode is not known", "check the robot"
    SPORT_MODE_STALE = "sport_mode_stale", "the last report of the onboard mode is too old", "check the network"
    SPORT_MODE_RELEASED = "sport_mode_released", "the onboard mode was released", "select_sport_mode()"
    BATTERY_LOW = "battery_low", "the battery's charge is below the minimum", "charge the battery"
    BATTERY_UNKNOWN = "battery_unknown", "the battery's charge is not known", "check the robot"
    POSTURE = "posture", "the robot cannot walk from this posture", "call the service that is named"
