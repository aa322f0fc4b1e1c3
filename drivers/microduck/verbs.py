"""The services of a Microduck (except move, head, pose and mouth), and the verbs that an AI agent may use."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Service
from strands_actors.contract.refusals import bad_argument
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.tool_verbs import MOVE_TO, SENSORS, STATUS, STOP, ToolVerb
from strands_actors.kernel.messages import Refused, sentence_case

from . import refusals
from .config import LATE_S
from .protocol import SOUNDS

CONFIRM = "confirm"
CONFIRMED = {
    "relax": "it takes the torque away: an unheld duck collapses",
    "init": "it powers the joints and moves all of them to the home pose",
    "reboot_motors": "it takes the torque away and restarts the servos: an unheld duck collapses",
}
"""Services that need ``confirm=True``, and the reason."""

FAR_M = 10.0
"""Largest distance of a point to look at [assumed]."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_IDS = re.compile(r"\[?\s*(\d{1,3}(\s*,\s*\d{1,3})*)?\s*\]?")

_TEXT = {"type": "string"}
_YES = {"type": "boolean", "description": "true: yes, although it does that"}
_M_S = {"type": "number", "description": "m/s"}
_RAD = {"type": "number", "description": "radians"}
_METRES = {"type": "number", "description": "metres, in the trunk's frame: forward, left, up"}


def services_for(timeout_s: float) -> dict[str, Service]:
    """Return the services, each with its longest duration."""
    ask_s, rise_s = timeout_s + 1.0, timeout_s + 8.0

    def asks(about: str, arguments: Mapping[str, Any] | None = None) -> Service:
        return Service(about, ask_s, dict(arguments or {}), in_motion=True)

    def moves(about: str, within_s: float, arguments: Mapping[str, Any] | None = None) -> Service:
        return Service(about, within_s, dict(arguments or {}), in_motion=True, moves=True, late_s=LATE_S)

    def powers(about: str, within_s: float = ask_s, arguments: Mapping[str, Any] | None = None) -> Service:
        return Service(about, within_s, dict(arguments or {}), in_motion=True, powers=True, late_s=LATE_S)

    def releases(about: str, arguments: Mapping[str, Any] | None = None) -> Service:
        return replace(powers(about, arguments=arguments), releases=True)

    return {
        "enable": powers("hand the duck to its policy: it stands up and balances", rise_s),
        "disable": releases("take it back from its policy: it holds its pose, and nothing balances it"),
        "do": moves("run a skill that the robot has, by name", ask_s, {"skill": ""}),
        "sit": moves("sit down, if it stands", ask_s),
        "stand": moves("stand up, if it sits", ask_s),
        "look_at": moves("turn the head towards a point", ask_s, {"x": 0.0, "y": 0.0, "z": 0.0, "neck_pitch": 0.0}),
        "relax": releases("take the torque away: an unheld duck collapses", {CONFIRM: False}),
        "init": powers("power the joints and move all of them to the home pose", arguments={CONFIRM: False}),
        "reboot_motors": releases("restart servos; torque goes off on all of them", {"ids": "", CONFIRM: False}),
        "skills": asks("list the skills that the robot has"),
        "sounds": asks("list the sounds that it can play"),
        "play_sound": asks("play a sound of its voice", {"tag": "chirp"}),
        "theremin": replace(
            powers("play by the depth sensor, the mouth moves along; or end that", arguments={"active": True}),
            releases={"active": False},
        ),
        "mode": asks("report the drive mode"),
        "set_mode": powers(
            "change the drive mode: it goes home, loads other policies, drives again", arguments={"mode": ""}
        ),
        "policies": asks("list the policy of each slot"),
        "load_policy": powers(
            "put a file of the robot's into a policy slot; no path: back to its own",
            arguments={"slot": "", "path": ""},
        ),
        "reload_policies": powers("read all policy slots again"),
        "health": asks("report the health of robotd"),
        "version": asks("report the versions of robotd and of its protocol"),
        "model": asks("report the geometry of the robot"),
        "odometry": asks("report the robot's estimate of its position"),
        "monitor": asks("report the newest state of robotd, unchanged"),
        "tof": asks("report one frame of the depth sensor: 8 by 8 distances in millimetres"),
    }


SERVICES: Mapping[str, Service] = services_for(5.0)

MOVING_POWER = frozenset({"enable", "init", "set_mode", "load_policy", "reload_policies"})
"""Services after which the robot moves by itself, with or without a policy. They are refused when the robot is
disarmed, and while it walks."""

_WITHOUT_INPUT = (
    "enable", "disable", "sit", "stand", "skills", "sounds", "mode", "policies", "reload_policies", "health",
    "version", "model", "odometry", "monitor", "tof",
)  # fmt: skip
"""Verbs without an input."""


def tool_verbs() -> tuple[ToolVerb, ...]:
    """Return the commands that an AI agent may call."""

    def service_verb(name: str, inputs: Mapping[str, Any], required: Sequence[str] = ()) -> ToolVerb:
        return ToolVerb(name, "service", f"{sentence_case(SERVICES[name].about)}.", inputs, tuple(required))

    head = dict.fromkeys(("neck_pitch", "head_pitch", "head_yaw", "head_roll"), _RAD)
    ids = {"type": "string", "description": "20, 21; empty: all"}
    return (
        SENSORS,
        STATUS,
        STOP,
        ToolVerb(
            "move",
            "action",
            "Walk for duration seconds (default 1, at most 10), then stand. A zero stands at once.",
            {
                "vx": {**_M_S, "description": "m/s forward"},
                "vy": {**_M_S, "description": "m/s to the left"},
                "vyaw": {"type": "number", "description": "rad/s to the left"},
                "duration": {"type": "number", "minimum": 0.1, "maximum": 10},
            },
            action={"vx": 0.0, "vy": 0.0, "vyaw": 0.0},
        ),
        MOVE_TO,
        ToolVerb("head", "action", "Turn the joints of the head.", head),
        ToolVerb(
            "pose",
            "action",
            "Shift and tilt the body on its feet.",
            {"z": {"type": "number", "description": "metres, -0.025 to 0.01"}, "roll": _RAD, "pitch": _RAD},
        ),
        ToolVerb(
            "mouth",
            "action",
            "Open the mouth: 0 closed, 1 open.",
            {"open": {"type": "number", "minimum": 0, "maximum": 1}},
            ("open",),
        ),
        service_verb("look_at", {"x": _METRES, "y": _METRES, "z": _METRES, "neck_pitch": _RAD}, ("x", "y", "z")),
        service_verb("do", {"skill": _TEXT}, ("skill",)),
        service_verb("play_sound", {"tag": {"type": "string", "enum": list(SOUNDS)}}),
        service_verb("theremin", {"active": {"type": "boolean"}}, ("active",)),
        service_verb("set_mode", {"mode": _TEXT}, ("mode",)),
        service_verb("load_policy", {"slot": _TEXT, "path": _TEXT}, ("slot",)),
        service_verb("relax", {CONFIRM: _YES}, (CONFIRM,)),
        service_verb("init", {CONFIRM: _YES}, (CONFIRM,)),
        service_verb("reboot_motors", {"ids": ids, CONFIRM: _YES}, (CONFIRM,)),
        *(service_verb(name, {}) for name in _WITHOUT_INPUT),
    )


def motor_ids(value: object) -> list[int] | None:
    """Return the numbers in a text such as ``20, 21``, or one number; None for anything else."""
    number = finite(value)
    if number is not None:
        return [int(number)] if number == int(number) else None
    if not isinstance(value, str) or not _IDS.fullmatch(value):
        return None
    return [int(digits) for digits in re.findall(r"\d+", value)]


def check_arguments(
    service: str, arguments: Mapping[str, Any], ids: Sequence[int], modes: Sequence[str], slots: Sequence[str]
) -> Refused | None:
    """Return a refusal for invalid arguments of a service; None if they are valid."""
    values = {**SERVICES[service].arguments, **arguments}
    if service in CONFIRMED and values[CONFIRM] is not True:
        return refusals.not_confirmed(service, CONFIRMED[service], CONFIRM, str(values[CONFIRM])[:SHOWN])
    match service:
        case "do":
            if not isinstance(values["skill"], str) or not NAME.fullmatch(values["skill"]):
                return bad_argument("skill", values["skill"], "the name of a skill: skills() has them")
        case "look_at":
            for name in ("x", "y", "z"):
                value = finite(values[name])
                if value is None or abs(value) > FAR_M:
                    return bad_argument(name, values[name], f"metres, -{FAR_M:g}..{FAR_M:g}")
            neck = finite(values["neck_pitch"])
            if neck is None or not -1.571 <= neck <= 1.047:
                return bad_argument("neck_pitch", values["neck_pitch"], "-1.571..1.047 rad")
        case "reboot_motors":
            requested = motor_ids(values["ids"])
            if requested is None or not set(requested) <= set(ids):
                return bad_argument("ids", values["ids"], f"some of {', '.join(map(str, ids))}; empty: all")
        case "play_sound" if values["tag"] not in SOUNDS:
            return bad_argument(
                "tag", values["tag"], f"one of {', '.join(SOUNDS)}; wheee has to be held and is not played"
            )
        case "theremin" if not isinstance(values["active"], bool):
            return bad_argument("active", values["active"], "true or false")
        case "set_mode" if values["mode"] not in modes:
            return bad_argument("mode", values["mode"], f"one of {', '.join(modes)}")
        case "load_policy":
            if values["slot"] not in slots:
                return bad_argument("slot", values["slot"], f"one of {', '.join(slots)}")
            if not isinstance(values["path"], str) or (values["path"] and not values["path"].startswith("/")):
                return bad_argument("path", values["path"], "an absolute path on the robot; empty: its own")
    return None
