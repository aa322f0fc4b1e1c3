"""The refusals of the Reachy Mini driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class ReachyCode(RefusalCode):
    """See ``docs/refusals.md``."""

    IGNORED = (
        "ignored",
        "the daemon ignores commands: a move of another client runs",
        "wait until that move ends, or call stop()",
    )
    TWISTED = "twisted", "head and body would be turned too far apart", "keep their yaw angles closer"
    TOO_NEAR = "too_near", "the point to look at is too near", "give a point that is farther away"
    ASLEEP = (
        "asleep",
        "a joint would stay outside its range, as in the sleeping pose",
        "call wake(), or give that joint, too",
    )
    DAEMON = "daemon", "the daemon answered with an error", "check the daemon's log"
    MOVE = "move", "a move ended early", "check the robot"
    NO_MOVE = "no_move", "there is no such move", "use one of the listed moves"
    NO_SOUND = "no_sound", "the daemon reports no direction of sound", "check that the robot has microphones"
    NO_CAMERA = "no_camera", "the daemon has no camera", "connect a camera"
    NO_SPEECH = "no_speech", "no speech could be made", "check the speech server"
    NO_TTS = "no_tts", "no text-to-speech service is configured", "give tts_url="
    NO_RECORDING = "no_recording", "the daemon sends sound only over WebRTC", "read the WebRTC stream"


# -- actions


def with_further_keys(refusal: Refused, duration_key: str, point_keys: str) -> Refused:
    """Return a refusal of an action's keys that also lists the accepted keys that are not axes."""
    keys = f"{refusal.limit}; {duration_key} or {point_keys} beside them"
    return Refused(refusal.code, refusal.reason, f"use {keys}", refusal.offered, keys)


def duration_outside_limits(key: str, duration_s: float, shortest_s: float, longest_s: float) -> Refused:
    limit = f"{shortest_s:g}..{longest_s:g} s"
    reason = f"{key} {duration_s:g} s is outside {limit}"
    return Refused(Code.DURATION, reason, f"give {limit}", f"{duration_s:g}", limit)


def point_and_angle(point_keys: str, angle_key: str) -> Refused:
    reason = f"{point_keys} and {angle_key} are both given"
    return Refused(Code.BOTH_SPELLINGS, reason, "send one of them", angle_key, point_keys)


def point_not_finite(point_keys: str, point: str) -> Refused:
    reason = f"{point_keys} are not three finite numbers"
    return Refused(Code.NOT_FINITE, reason, "give all three, in metres", point, "three finite numbers")


def point_too_near(point: str, distance_m: float, nearest_m: float) -> Refused:
    reason = f"the point to look at is {distance_m:.3f} m away"
    remedy = f"give one at least {nearest_m:g} m away"
    return Refused(ReachyCode.TOO_NEAR, reason, remedy, point, f"{nearest_m:g} m")


# -- the goto verb


def wrong_antenna_count(count: int) -> Refused:
    reason = f"antennas has {count} numbers"
    return Refused(Code.BAD_INPUT, reason, "give right and left, in degrees", str(count), "2")


def unknown_head_axis(axis: str, axes: str) -> Refused:
    return Refused(Code.BAD_INPUT, f"head has no {axis!r}", f"give some of {axes}", axis, axes)


def given_twice(key: str) -> Refused:
    return Refused(Code.BAD_INPUT, f"{key} is given twice", "give it once", key, "once")


# -- gates and conditions


def asleep(key: str, value: str, low: str, high: str, unit: str) -> Refused:
    limit = f"{low}..{high} {unit}"
    reason = f"{key} would stay at {value}, past {limit}: the head is asleep"
    return Refused(ReachyCode.ASLEEP, reason, f"call wake(), or give {key}, too", value, limit)


def twisted(head_yaw: str, body_yaw: str, difference: str, limit_deg: float) -> Refused:
    """Return the refusal of a yaw of head and body.

    Args:
        head_yaw: Yaw of the head, in degrees.
        body_yaw: Yaw of the body, in degrees.
        difference: Yaw of the head minus yaw of the body, in degrees.
        limit_deg: The largest accepted difference.
    """
    reason = f"head_yaw {head_yaw} and body_yaw {body_yaw} are {difference.removeprefix('-')} deg apart"
    remedy = f"keep them within {limit_deg:g} deg of each other"
    return Refused(ReachyCode.TWISTED, reason, remedy, difference, f"-{limit_deg:g}..{limit_deg:g}")


def too_fast(key: str, step: str, unit: str, duration_s: float, least_s: float) -> Refused:
    return Refused(
        Code.TOO_FAST,
        f"{key} goes {step} {unit} in {duration_s:g} s",
        f"give a duration of at least {least_s:g} s",
        f"{duration_s:g}",
        f"{least_s:g} s",
    )


def motors_off(mode: str) -> Refused:
    return Refused(Code.MOTORS_OFF, f"the motors are {mode}", 'call motors(mode="enabled") first', mode, "enabled")


def ignored() -> Refused:
    return Refused(
        ReachyCode.IGNORED,
        "the daemon ignores commands while a move of another client runs",
        "wait until that move ends, or call stop(), which ends it",
        "a move",
        "none",
    )


# -- services


def no_speech_service() -> Refused:
    remedy = "give tts_url=, the http address of a service that makes a WAV file of a text"
    return Refused(ReachyCode.NO_TTS, "no text-to-speech service is configured", remedy, "", "tts_url=")


def no_recording() -> Refused:
    remedy = "read the stream at the address that camera() returns"
    return Refused(ReachyCode.NO_RECORDING, "the daemon sends sound only over WebRTC", remedy)


def daemon_error(status: int, body: bytes) -> Refused:
    text = body[:120].decode("utf-8", "replace")
    return Refused(
        ReachyCode.DAEMON, f"the daemon answers status {status}: {text}", "check the daemon's log", str(status)
    )


def move_ended_early(event_type: str, details: str) -> Refused:
    event = event_type.replace("_", " ")
    return Refused(ReachyCode.MOVE, f"{event} {details}".rstrip(), "check the robot")


def no_such_move(dataset: str, move: str, moves: str) -> Refused:
    return Refused(ReachyCode.NO_MOVE, f"{dataset} has no move {move}", f"use one of {moves}", move, moves)


def no_direction_of_sound() -> Refused:
    return Refused(
        ReachyCode.NO_SOUND, "the daemon reports no direction of sound", "check that the robot has microphones"
    )


def sound_out_of_reach(difference_deg: float, limit_deg: float) -> Refused:
    """Return the refusal to turn the head to a sound, with the yaw that head and body would differ by."""
    reason = f"the head would be {difference_deg:.1f} deg from the body"
    offered, limit = f"{difference_deg:.1f}", f"-{limit_deg:g}..{limit_deg:g}"
    return Refused(ReachyCode.TWISTED, reason, "turn the body first", offered, limit)


def no_camera() -> Refused:
    return Refused(ReachyCode.NO_CAMERA, "the daemon has no camera to track with", "connect a camera")


def no_speech(status: int) -> Refused:
    reason = f"tts_url answers status {status}, no WAV file"
    return Refused(ReachyCode.NO_SPEECH, reason, 'use a service that answers POST {"text": ...} with a WAV file')
