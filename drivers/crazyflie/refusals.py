"""Refusals that only the Crazyflie driver uses: the codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

_CHECK_RADIO = "check radio and power"


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


# -- the state of the drone


def locked(offered: str = "") -> Refused:
    return Refused(
        CrazyflieCode.LOCKED, "the drone is locked after an emergency stop", "switch it off and on", offered
    )


def tumbled() -> Refused:
    return Refused(CrazyflieCode.TUMBLED, "the drone has tumbled", "put it on its feet", "tumbled")


def crashed() -> Refused:
    return Refused(CrazyflieCode.CRASHED, "the drone has crashed", "switch it off and on", "crashed")


def stale_battery(age_s: float, limit_s: float) -> Refused:
    reason = f"the drone has not reported its battery for {age_s:.1f} s"
    return Refused(Code.BATTERY, reason, _CHECK_RADIO, f"{age_s:.1f}", f"{limit_s:g} s")


def low_battery(volts: float, floor_v: float) -> Refused:
    reason = f"the battery has only {volts:.2f} V"
    limit = f"{floor_v:.1f} V"
    return Refused(Code.BATTERY, reason, f"charge it above {limit}", f"{volts:.2f}", limit)


def low_battery_by_firmware(volts: float, floor_v: float) -> Refused:
    """Return the refusal for a voltage above the floor that the firmware reports as low."""
    reason = f"the firmware reports a low battery, at {volts:.2f} V"
    return Refused(Code.BATTERY, reason, "charge it", f"{volts:.2f}", f"{floor_v:.1f} V")


def hovered_too_long(limit_s: float) -> Refused:
    limit = f"{limit_s:g} s"
    return Refused(
        CrazyflieCode.HOVERING,
        f"the drone hovered without a command for {limit}",
        "take off again",
        limit=limit,
    )


def no_supervisor_report() -> Refused:
    return Refused(Code.NO_OBSERVATION, "the drone's supervisor has not reported yet", "wait for its first report")


def not_flying() -> Refused:
    return Refused(
        CrazyflieCode.NOT_FLYING, "the drone stands on the floor with its motors off", "call takeoff() first"
    )


# -- actions


def both_vz_and_z() -> Refused:
    return Refused(Code.BOTH, "vz and z are both given", "send one of them", "vz and z", "vz or z")


def too_high_to_climb(vz_m_s: float, height_m: float, low_m: float, high_m: float) -> Refused:
    reason = f"vz {vz_m_s:g} m/s at {height_m:.2f} m, past {high_m:g}"
    return Refused(Code.PAST_TRAVEL, reason, "sink, or give z", f"{vz_m_s:g}", f"{low_m:g}..{high_m:g}")


def too_low_to_sink(vz_m_s: float, height_m: float, low_m: float, high_m: float) -> Refused:
    reason = f"vz {vz_m_s:g} m/s at {height_m:.2f} m, below {low_m:g}"
    return Refused(Code.PAST_TRAVEL, reason, "call land()", f"{vz_m_s:g}", f"{low_m:g}..{high_m:g}")


# -- services


def argument_out_of_range(argument: str, offered: str, low: float, high: float, unit: str) -> Refused:
    limit = f"{low:g}..{high:g} {unit}"
    return Refused(Code.BAD_ARGUMENT, f"{argument} is {offered}", f"give {limit}", offered, limit)


def stop_as_service() -> Refused:
    return Refused(CrazyflieCode.STOP, "this is an order to stop, not a service", "call stop() or emergency_stop()")


# -- taking off and landing


def silent_supervisor() -> Refused:
    return Refused(Code.NO_OBSERVATION, "the drone's supervisor does not answer", _CHECK_RADIO)


def tumbled_or_crashed() -> Refused:
    return Refused(
        CrazyflieCode.TUMBLED, "the drone has tumbled or crashed", "put it on its feet, switch it off and on"
    )


def cannot_arm() -> Refused:
    return Refused(CrazyflieCode.CANNOT_ARM, "the drone's supervisor does not allow arming", "check the drone")


def tilted(tilt_deg: float, limit_deg: float) -> Refused:
    return Refused(
        CrazyflieCode.TILTED,
        f"the drone is tilted by {tilt_deg:.0f} degrees",
        "put it on a level floor",
        limit=f"{limit_deg:g} degrees",
    )


def unknown_height(age_s: float, limit_s: float) -> Refused:
    """Return the refusal for a last report of the height that is ``age_s`` old."""
    return Refused(Code.STALE, "the drone's height is not known", _CHECK_RADIO, f"{age_s:.1f}", f"{limit_s:g} s")


def arming_not_confirmed() -> Refused:
    return Refused(Code.NOT_ARMED, "the drone did not confirm arming, so its motors stay off", "check the drone")


def not_spun_up() -> Refused:
    return Refused(Code.NOT_ARMED, "the motors did not spin up after arming", "check battery and propellers")


def incomplete_takeoff(height_m: float, does_not_fly: bool, landing_failure: str) -> Refused:
    """Return the refusal for a takeoff that did not reach its height.

    Args:
        height_m: The requested height.
        does_not_fly: The drone was not flying when the time was over.
        landing_failure: Why the drone could not be landed after that; empty if it was landed.
    """
    landed = (
        f"not landed: {landing_failure}"
        if landing_failure
        else "the drone does not fly"
        if does_not_fly
        else "the drone was landed"
    )
    return Refused(CrazyflieCode.TAKEOFF, f"takeoff did not reach {height_m:g} m; {landed}", "check the drone")


def not_landed(failure: str) -> Refused:
    return Refused(CrazyflieCode.LAND, failure, "call stop(), or emergency_stop()")
