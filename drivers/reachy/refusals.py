"""Refusal codes (the reasons for refusing a command) that only the Reachy Mini driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


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
