"""The services of a Reachy Mini, their arguments, and the commands that an AI agent may call. Pure: no I/O."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Service
from strands_actors.contract.refusals import bad_argument
from strands_actors.contract.tool_verbs import MOVE_TO, SENSORS, STATUS, STOP, ToolVerb
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import LATE_S
from .gates import LONGEST_S, SHORTEST_S
from .protocol import DATASET, MODES, NAME

SPOKEN = 500
"""Most characters of a text to speak [assumed]."""

_ANGLE = {"type": "number", "description": "degrees"}
_LENGTH = {"type": "number", "description": "millimetres"}
_METRES = {"type": "number", "description": "metres from the head: to the front, to the left, up"}
_TEXT = {"type": "string"}
_DURATION = {
    "type": "number",
    "minimum": SHORTEST_S,
    "maximum": LONGEST_S,
    "description": "seconds; left out: as long as it takes at half speed",
}
_HEAD = {
    "head_pitch": {**_ANGLE, "description": "degrees, down positive"},
    "head_roll": _ANGLE,
    "head_yaw": {**_ANGLE, "description": "degrees, left positive, body included"},
    "head_x": _LENGTH,
    "head_y": _LENGTH,
    "head_z": _LENGTH,
}
_REST = dict.fromkeys((*_HEAD, "body_yaw", "antenna_left", "antenna_right"), 0.0)

ALSO: Mapping[str, str] = {"wake_up": "wake", "goto_sleep": "sleep", "play_move": "express"}
"""Other names of services, as in the vendor's own library and in scripts of strands-robots."""

_SERVICES: Mapping[str, Service] = {
    "wake": Service("wake up: the head rises and nods", 20.0, in_motion=True, moves=True, late_s=LATE_S),
    "sleep": Service(
        "go to sleep: the head sinks; torque stays on", 20.0, in_motion=True, moves=True, late_s=LATE_S
    ),
    "express": Service(
        "play a recorded move, an emotion or a dance, to its end",
        90.0,
        {"move": "", "dataset": DATASET},
        in_motion=True,
        moves=True,
        late_s=LATE_S,
    ),
    "list_moves": Service("list the recorded moves", 30.0, {"dataset": DATASET}, in_motion=True),
    "motors": Service(
        "give the motors torque where they are, take it away (the head drops), or let them float",
        2.0,
        {"mode": "enabled"},
        in_motion=True,
        powers=True,
        releases={"mode": "disabled"},
        late_s=LATE_S,
    ),
    "say": Service("say a text by the speaker", 30.0, {"text": ""}, in_motion=True),
    "play_sound": Service("play a sound file of the robot's", 5.0, {"file": ""}, in_motion=True),
    "volume": Service("report the speaker's volume", 5.0, in_motion=True),
    "set_volume": Service("set the speaker's volume", 5.0, {"volume": 50}, {"volume": 100}, in_motion=True),
    "track_face": Service(
        "let the daemon turn the head after a face, or end that; a stop ends it, too",
        5.0,
        {"enabled": True, "weight": 1.0},
        in_motion=True,
        moves=True,
        late_s=LATE_S,
    ),
    "tracking_status": Service("report the face that the daemon tracks", 5.0, in_motion=True),
    "camera": Service("report the camera, and the address at which it streams its pictures", 5.0, in_motion=True),
    "record_audio": Service(
        "refused, because the daemon sends sound only over WebRTC", 1.0, {"duration": 5.0}, in_motion=True
    ),
    "turn_to_sound": Service(
        "turn the head towards what is heard now", 15.0, in_motion=True, moves=True, late_s=LATE_S
    ),
    "turn_to_sound_status": Service("report where sound comes from", 5.0, in_motion=True),
}

SERVICES: Mapping[str, Service] = {**_SERVICES, **{also: _SERVICES[name] for also, name in ALSO.items()}}

_VERBS: tuple[ToolVerb, ...] = (
    SENSORS,
    ToolVerb("get_state", "state", "Measured positions and velocities."),
    STATUS,
    STOP,
    MOVE_TO,
    ToolVerb("look", "action", "Turn and shift the head.", {**_HEAD, "duration": _DURATION}),
    ToolVerb(
        "look_at",
        "action",
        "Turn the head towards a point.",
        {"look_x": _METRES, "look_y": _METRES, "look_z": _METRES, "duration": _DURATION},
        ("look_x", "look_y", "look_z"),
    ),
    ToolVerb(
        "antennas",
        "action",
        "Move the antennas.",
        {"antenna_left": _ANGLE, "antenna_right": _ANGLE, "duration": _DURATION},
    ),
    ToolVerb(
        "body_turn",
        "action",
        "Turn the body, at most 65 degrees away from the head.",
        {"body_yaw": _ANGLE, "duration": _DURATION},
        ("body_yaw",),
    ),
    ToolVerb(
        "goto",
        "action",
        "Move head, body and antennas together.",
        {
            **_HEAD,
            "body_yaw": _ANGLE,
            "antenna_left": _ANGLE,
            "antenna_right": _ANGLE,
            "duration": _DURATION,
            "head": {"type": "object", "description": "instead of head_...: pitch, roll, yaw, x, y, z"},
            "antennas": {"type": "array", "description": "instead of antenna_...: right, left"},
        },
    ),
    ToolVerb("home", "action", "Head, body and antennas straight.", {"duration": _DURATION}, action=_REST),
    ToolVerb("wake", "service", "Wake up; the motors must have torque."),
    ToolVerb("sleep", "service", "Go to sleep."),
    ToolVerb("express", "service", "Play a recorded move.", {"move": _TEXT, "dataset": _TEXT}, ("move",)),
    ToolVerb("list_moves", "service", "The recorded moves there are.", {"dataset": _TEXT}),
    ToolVerb(
        "motors",
        "service",
        "Torque on (enabled), off (disabled: the head drops) or floating (gravity_compensation).",
        {"mode": {"type": "string", "enum": list(MODES)}},
        ("mode",),
    ),
    ToolVerb("say", "service", "Say a text.", {"text": _TEXT}, ("text",)),
    ToolVerb("play_sound", "service", "Play a sound file.", {"file": _TEXT}, ("file",)),
    ToolVerb("volume", "service", "The speaker's volume."),
    ToolVerb(
        "set_volume",
        "service",
        "Set the speaker's volume, 1 to 100.",
        {"volume": {"type": "number", "minimum": 1, "maximum": 100}},
        ("volume",),
    ),
    ToolVerb(
        "track_face",
        "service",
        "Turn the head after a face, or end that.",
        {"enabled": {"type": "boolean"}, "weight": {"type": "number", "minimum": 0, "maximum": 1}},
        ("enabled",),
    ),
    ToolVerb("tracking_status", "service", "The face that is seen."),
    ToolVerb("camera", "service", "What the camera is, and where its pictures are streamed."),
    ToolVerb(
        "record_audio",
        "service",
        "Refused, because the daemon sends sound only over WebRTC, at the address that `camera` reports.",
        {"duration": {"type": "number", "description": "seconds"}},
    ),
    ToolVerb("turn_to_sound", "service", "Turn the head towards what is heard."),
    ToolVerb("turn_to_sound_status", "service", "Where sound comes from."),
)


TOOL_VERBS: tuple[ToolVerb, ...] = (
    *_VERBS,
    *(replace(verb, name=also) for also, name in ALSO.items() for verb in _VERBS if verb.name == name),
)


def plain_goto(inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
    """Convert a ``goto`` to a plain command of axes. It may have ``head`` and ``antennas`` as in scripts for
    strands-robots."""
    command = dict(inputs)
    pose, antennas = command.pop("head", {}), command.pop("antennas", ())
    if antennas and len(antennas) != 2:
        return refusals.wrong_antenna_count(len(antennas))
    spread = {f"head_{axis}": value for axis, value in pose.items()}
    if unknown := sorted(spread.keys() - _HEAD.keys()):
        axis = unknown[0].removeprefix("head_")
        axes = ", ".join(name.removeprefix("head_") for name in _HEAD)
        return refusals.unknown_head_axis(axis, axes)
    spread |= zip(("antenna_right", "antenna_left"), antennas, strict=False)
    if twice := sorted(spread.keys() & command.keys()):
        return refusals.given_twice(twice[0])
    return command | spread


def check_arguments(service: str, arguments: Mapping[str, Any], tts_url: str) -> Refused | None:
    """Return a refusal for invalid arguments of a service; None if they are valid."""
    values = {**SERVICES[service].arguments, **arguments}
    match ALSO.get(service, service):
        case "express":
            return _name("move", values["move"]) or _dataset(values["dataset"])
        case "list_moves":
            return _dataset(values["dataset"])
        case "motors" if values["mode"] not in MODES:
            return bad_argument("mode", values["mode"], ", ".join(MODES))
        case "say" if not tts_url:
            return refusals.no_speech_service()
        case "say":
            text = values["text"]
            if not isinstance(text, str) or not 0 < len(text) <= SPOKEN:
                return bad_argument("text", text, f"1..{SPOKEN} characters")
        case "record_audio":
            return refusals.no_recording()
        case "play_sound":
            return _name("file", values["file"])
        case "track_face":
            weight = finite(values["weight"])
            if not isinstance(values["enabled"], bool):
                return bad_argument("enabled", values["enabled"], "true or false")
            if weight is None or not 0.0 <= weight <= 1.0:
                return bad_argument("weight", values["weight"], "0..1")
    return None


def _dataset(dataset: object) -> Refused | None:
    """Refuse a dataset name that is not ``name`` or ``owner/name``. It becomes part of a URL path."""
    names = dataset.split("/") if isinstance(dataset, str) else [""]
    if len(names) > 2:
        return bad_argument("dataset", dataset, "owner/name")
    return next((refusal for name in names if (refusal := _name("dataset", name))), None)


def _name(argument: str, name: object) -> Refused | None:
    if isinstance(name, str) and NAME.fullmatch(name):
        return None
    return bad_argument(argument, name, "1..128 letters, digits and . _ -, the first a letter or digit")
