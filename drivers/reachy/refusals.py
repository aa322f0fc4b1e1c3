"""Refusals of this wire alone."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class ReachyCode(RefusalCode):
    """See ``docs/refusals.md``."""

    IGNORED = "ignored", "the daemon ignores commands: a move of another client runs", "wait, or stop()"
    TWISTED = "twisted", "the head would be too far from the body", "keep them closer"
    TOO_NEAR = "too_near", "the point to look at is too near", "give one that is farther away"
    ASLEEP = "asleep", "a joint would stay where only a sleeping head is", "wake(), or give it, too"
    DAEMON = "daemon", "the daemon answers with an error", "look at its log"
    MOVE = "move", "a move did not come to its end", "look at the robot"
    NO_MOVE = "no_move", "there is no such move", "use one that is named"
    NO_SOUND = "no_sound", "the daemon reports no direction of sound", "it needs microphones"
    NO_CAMERA = "no_camera", "the daemon has no camera", "connect one"
    NO_SPEECH = "no_speech", "no speech could be made", "look at the server"
    NO_TTS = "no_tts", "there is nothing to make speech of a text", "give tts_url="
    NO_RECORDING = "no_recording", "the daemon gives sound over WebRTC alone", "ask it there"
