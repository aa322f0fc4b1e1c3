"""Encode the requests to robotd, and decode and check its answers. Pure: no I/O.

Names and units are those of the public protocol crate (duck-ipc-proto): metres, radians, seconds; x
forward, y left, z up; a positive ``vyaw`` turns left. Each ``read_*`` raises ``MalformedFrame`` for an answer
that it cannot read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

API_VERSION = 31
"""Our version in ``hello``. robotd accepts any version, and refuses the single calls that it does not
have."""

POLICIES_SINCE, HOMED_SINCE = 18, 31
"""First version with ``robot.policies``, and first version in which that reports whether the duck sits."""

ROBOT_SOCKET = "/run/robotd.sock"
TOF_SOCKET = "/run/tofd/tof.sock"

HELLO = "hello"
MOVE, HEAD, POSE, MOUTH = "robot.move", "robot.head", "robot.pose", "robot.mouth"
STOP, SUBSCRIBE, STATE = "robot.stop", "robot.subscribe", "robot.state"
ENABLE, INIT, RELAX, REBOOT_MOTORS = "robot.enable", "robot.init", "robot.relax", "robot.rebootMotors"
DO, LOOK, SOUND, THEREMIN = "robot.do", "robot.look", "robot.sound", "robot.theremin"
GET_MODE, SET_MODE, HEALTH, MODEL = "robot.mode", "robot.setMode", "robot.health", "robot.model"
POLICIES, LOAD_POLICY, RELOAD_POLICIES = "robot.policies", "robot.loadPolicy", "robot.reloadPolicies"
TOF_STREAM, TOF_FRAME = "tof.stream", "tof.frame"

HELD, HOMING = "held", "homing"
"""``policy`` of a state in which no policy drives the duck: it holds still or is limp, or it goes to its home pose
before the policy gets it."""
UNDRIVEN = frozenset((HELD, HOMING, "limp_fall", "limp_pose"))
"""All of them. With the last two, robotd itself catches a fall, and puts the duck back into its pose."""

AT_REST = 0.01
"""Magnitude of an applied twist (m/s, rad/s) up to which the duck counts as standing. robotd smooths the twist, so
after a stop it approaches zero and does not reach it. From 0.05 down robotd's policy stands [public source]."""

SIT_TOGGLE = "sit_toggle"
SOUNDS = ("alarm", "greet", "inquire", "peck", "chirp", "coo")
"""Tags that play once. ``wheee`` is missing: it has to be repeated with every tick."""

JOINTS = 15
HEAD_JOINTS = slice(5, 9)
ZONES = 64

_SLOTS = frozenset({"accepted", "walk", "stand", "sitstand", "unavailable", "skills"})
"""Members of the answer to ``robot.subscribe`` that are not skills."""

Row = tuple[float, ...]


class Hello(NamedTuple):
    api_version: int
    daemon_version: str


class State(NamedTuple):
    """One state of the duck, from ``robot.state``. Velocities are forward, left and turn."""

    t_s: float  # time of the state by robotd's clock
    policy: str
    requested: Row
    applied: Row
    limited_by: tuple[str, ...]
    head_rad: Row
    fallen: bool
    limp: bool  # True if the motors yield to a push, because their gains are low
    picked_up: bool
    joints_rad: Row  # measured joint positions; empty if not reported
    targets_rad: Row  # goals of the joints; empty if not reported
    position_m: Row
    yaw_rad: float
    gyro_rad_s: Row  # turn rates; empty if not reported
    quaternion_wxyz: Row

    @property
    def stands(self) -> bool:
        """Return True if the duck does not walk and has no command to walk."""
        return not any(self.requested) and math.hypot(*self.applied) <= AT_REST

    @property
    def is_driven(self) -> bool:
        """Return True if a policy drives the duck."""
        return self.policy not in UNDRIVEN


class Health(NamedTuple):
    healthy: bool
    reason: str
    battery_pct: float  # NaN if not measured
    battery_v: float


class Policies(NamedTuple):
    """The drive mode and the skills. ``sitting`` is None if the robot does not report it."""

    mode: str
    skills: tuple[str, ...]
    sitting: bool | None


def move(vx: float, vy: float, vyaw: float) -> dict[str, float]:
    return {"vx": float(vx), "vy": float(vy), "vyaw": float(vyaw)}


REST = {"vx": 0, "vy": 0, "vyaw": 0}
"""The zero of a stop. It is in whole numbers, so that a log can tell it from a writer's zero. For robotd they
are equal."""


def is_rest(params: Mapping[str, Any]) -> bool:
    """Return True if the parameters of a ``robot.move`` command the duck to stand."""
    return all(type(value) is int and value == 0 for value in params.values())


def head(row: Sequence[float]) -> dict[str, float]:
    neck_pitch, head_pitch, head_yaw, head_roll = row
    return {"neck_pitch": neck_pitch, "head_pitch": head_pitch, "head_yaw": head_yaw, "head_roll": head_roll}


def pose(row: Sequence[float]) -> dict[str, float | bool]:
    z, roll, pitch, active = row
    return {"z": z, "roll": roll, "pitch": pitch, "active": active != 0}


# -- answers


def read_hello(value: object) -> Hello:
    """Decode the answer to ``hello``. Raise ``MalformedFrame``, as all functions here do."""
    fields = _object(value, "hello")
    version = fields.get("api_version")
    if isinstance(version, bool) or not isinstance(version, int):
        raise MalformedFrame("hello without api_version")
    return Hello(version, str(fields.get("daemon_version") or "")[:64])


def read_state(value: Mapping[str, Any]) -> State:
    moves = _object(value.get("move"), "move")
    safety = _object(value.get("safety"), "safety")
    policy = value.get("policy")
    if not isinstance(policy, str):
        raise MalformedFrame("a state without policy")
    odometry = _object(value.get("odom") or {}, "odom")
    imu = _object(value.get("imu") or {}, "imu")
    return State(
        t_s=_number(value.get("t"), "t"),
        policy=policy[:64],
        requested=_row(moves.get("requested"), "requested", 3),
        applied=_row(moves.get("applied"), "applied", 3),
        limited_by=_names(moves.get("limited_by") or [], "limited_by"),
        head_rad=_row(value.get("head"), "head", 4),
        fallen=safety.get("fallen") is True,
        limp=safety.get("limp") is True,
        picked_up=safety.get("picked_up") is True,
        joints_rad=_row(value["joints"], "joints", JOINTS) if value.get("joints") else (),
        targets_rad=_row(value["targets"], "targets", JOINTS) if value.get("targets") else (),
        position_m=_row(odometry.get("position", [0.0] * 3), "position", 3),
        yaw_rad=_number(odometry.get("yaw", 0.0), "yaw"),
        gyro_rad_s=_row(imu["gyro"], "gyro", 3) if "gyro" in imu else (),
        quaternion_wxyz=_row(imu["quat"], "quat", 4) if "quat" in imu else (),
    )


def read_health(value: object) -> Health:
    fields = _object(value, "health")
    battery = _object(fields.get("battery") or {}, "battery")
    percent, volts = (finite(battery.get(name)) for name in ("percent", "volts"))
    return Health(
        fields.get("healthy") is True,
        str(fields.get("reason") or "")[:200],
        math.nan if percent is None else percent,
        math.nan if volts is None else volts,
    )


def read_policies(value: object) -> Policies:
    """Decode the answer with the drive mode and the skills. A skill is a name or an object with a name."""
    fields = _object(value, "policies")
    sitting = fields.get("sitting")
    mode, skills = fields.get("mode"), fields.get("skills") or []
    if not isinstance(mode, str) or not isinstance(skills, list):
        raise MalformedFrame("policies without a mode, or whose skills are no list")
    return Policies(
        mode[:64],
        _names([_name_of(entry) for entry in skills], "skills"),
        sitting if isinstance(sitting, bool) else None,
    )


def read_mode(value: object) -> str:
    mode = _object(value, "mode").get("mode")
    if not isinstance(mode, str):
        raise MalformedFrame("an answer without a mode")
    return mode[:64]


def read_skills(subscribed: object) -> tuple[str, ...]:
    """Return the skills in the answer to ``robot.subscribe``. They are a list, or before version 17 one field
    for each skill."""
    fields = _object(subscribed, "subscribe")
    if "skills" in fields:
        return _names(fields["skills"], "skills")
    return tuple(str(name)[:64] for name in fields if name not in _SLOTS)


def read_intent(value: object) -> tuple[bool, str]:
    """Decode the answer to a command: True if robotd accepted it, and robotd's reason."""
    fields = _object(value, "an answer")
    accepted = fields.get("accepted")
    if not isinstance(accepted, bool):
        raise MalformedFrame("an answer without the field that shows whether the request was accepted")
    return accepted, str(fields.get("reason") or "")[:200]


def read_look(value: object) -> tuple[dict[str, float], bool]:
    """Decode the answer to "look at a point": the goal of the head, and True if the point is out of reach."""
    fields = _object(value, "look")
    head = _object(fields.get("head"), "head")
    names = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
    return {name: _number(head.get(name), name) for name in names}, fields.get("clamped") is True


def read_object(value: object) -> dict[str, Any]:
    return _object(value, "an answer")


def read_distances(value: Mapping[str, Any]) -> list[float]:
    """Return one frame of the depth sensor in millimetres, row by row from the top."""
    return list(_row(value.get("distance_mm"), "distance_mm", ZONES))


def _object(value: object, label: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise MalformedFrame(f"{label} is no object")
    return value


def _number(value: object, label: str) -> float:
    number = finite(value)
    if number is None:
        raise MalformedFrame(f"{label} is no finite number")
    return number


def _row(value: object, label: str, length: int) -> Row:
    if not isinstance(value, list) or len(value) != length:
        raise MalformedFrame(f"{label} are not {length} numbers")
    return tuple(_number(number, label) for number in value)


def _name_of(value: object) -> object:
    return value.get("name") if isinstance(value, dict) else value


def _names(value: object, label: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise MalformedFrame(f"{label} are no names")
    return tuple(name[:64] for name in value[:64])
