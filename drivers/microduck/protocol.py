"""What is said to robotd, and what it says: methods, parameters, and answers that were checked.
Pure.

Names and units are those of the public protocol crate (duck-ipc-proto): metres, radians, seconds;
x forward, y left, z up; a positive ``vyaw`` turns left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.malformed import MalformedFrame

API_VERSION = 31
"""What we say in ``hello``. robotd refuses nobody for it: what it does not know it says of each
call."""

POLICIES_SINCE, HOMED_SINCE = 18, 31
"""Versions from which ``robot.policies`` exists, and tells whether the duck sits."""

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

HELD = "held"
"""``policy`` of a state in which no policy drives the duck: it holds still, or is limp."""

SIT_TOGGLE = "sit_toggle"
SOUNDS = ("alarm", "greet", "inquire", "peck", "chirp", "coo")
"""Tags that play once. ``wheee`` is a ride that has to be held, tick by tick: not played."""

JOINTS = 15
HEAD_JOINTS = slice(5, 9)
ZONES = 64

_SLOTS = frozenset({"accepted", "walk", "stand", "sitstand", "unavailable", "skills"})
"""Members of the answer to ``robot.subscribe`` that are no skill."""

Row = tuple[float, ...]


class Hello(NamedTuple):
    api_version: int
    daemon_version: str


class State(NamedTuple):
    """One ``robot.state``. Velocities: forward, left, turn."""

    t_s: float  # robotd's clock
    policy: str
    requested: Row
    applied: Row
    limited_by: tuple[str, ...]
    head_rad: Row
    fallen: bool
    limp: bool  # its gains are low: it yields
    picked_up: bool
    joints_rad: Row  # measured; empty: it tells none
    targets_rad: Row  # where it sends them; empty: it tells none
    position_m: Row
    yaw_rad: float
    gyro_rad_s: Row  # empty: it tells none
    quaternion_wxyz: Row

    @property
    def stands(self) -> bool:
        """Whether it is neither asked to walk nor does."""
        return not any(self.requested) and not any(self.applied)


class Health(NamedTuple):
    healthy: bool
    reason: str
    battery_pct: float  # NaN: not measured
    battery_v: float


class Policies(NamedTuple):
    """``sitting``: None where the robot does not say."""

    mode: str
    skills: tuple[str, ...]
    sitting: bool | None


def move(vx: float, vy: float, vyaw: float) -> dict[str, float]:
    return {"vx": float(vx), "vy": float(vy), "vyaw": float(vyaw)}


REST = {"vx": 0, "vy": 0, "vyaw": 0}
"""The zero of a stop. Whole numbers, so that a log tells it from a writer's zero; robotd minds no
difference."""


def is_rest(params: Mapping[str, Any]) -> bool:
    """Whether the parameters of ``robot.move`` are those of a stop."""
    return all(type(value) is int and value == 0 for value in params.values())


def head(row: Sequence[float]) -> dict[str, float]:
    neck_pitch, head_pitch, head_yaw, head_roll = row
    return {"neck_pitch": neck_pitch, "head_pitch": head_pitch, "head_yaw": head_yaw, "head_roll": head_roll}


def pose(row: Sequence[float]) -> dict[str, float | bool]:
    z, roll, pitch, active = row
    return {"z": z, "roll": roll, "pitch": pitch, "active": active != 0}


# -- answers


def read_hello(value: object) -> Hello:
    """Raise ``MalformedFrame``, as all of these."""
    told = _object(value, "hello")
    version = told.get("api_version")
    if isinstance(version, bool) or not isinstance(version, int):
        raise MalformedFrame("hello without api_version")
    return Hello(version, str(told.get("daemon_version") or "")[:64])


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
    told = _object(value, "health")
    battery = _object(told.get("battery") or {}, "battery")
    percent, volts = (finite(battery.get(name)) for name in ("percent", "volts"))
    return Health(
        told.get("healthy") is True,
        str(told.get("reason") or "")[:200],
        math.nan if percent is None else percent,
        math.nan if volts is None else volts,
    )


def read_policies(value: object) -> Policies:
    """Skills come as names, or as objects that have one."""
    told = _object(value, "policies")
    sitting = told.get("sitting")
    mode, skills = told.get("mode"), told.get("skills") or []
    if not isinstance(mode, str) or not isinstance(skills, list):
        raise MalformedFrame("policies without a mode, or whose skills are no list")
    return Policies(
        mode[:64],
        _names([_name_of(one) for one in skills], "skills"),
        sitting if isinstance(sitting, bool) else None,
    )


def read_mode(value: object) -> str:
    mode = _object(value, "mode").get("mode")
    if not isinstance(mode, str):
        raise MalformedFrame("an answer without a mode")
    return mode[:64]


def read_skills(subscribed: object) -> tuple[str, ...]:
    """Return the skills that the answer to ``robot.subscribe`` names: a list, or before version 17
    a member each."""
    told = _object(subscribed, "subscribe")
    if "skills" in told:
        return _names(told["skills"], "skills")
    return tuple(str(name)[:64] for name in told if name not in _SLOTS)


def read_intent(value: object) -> tuple[bool, str]:
    """Return whether it was accepted, and what robotd says about it."""
    told = _object(value, "an answer")
    accepted = told.get("accepted")
    if not isinstance(accepted, bool):
        raise MalformedFrame("an answer that does not say whether it was accepted")
    return accepted, str(told.get("reason") or "")[:200]


def read_look(value: object) -> tuple[dict[str, float], bool]:
    """Return where the head was sent, and whether the point is out of its reach."""
    told = _object(value, "look")
    where = _object(told.get("head"), "head")
    names = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
    return {name: _number(where.get(name), name) for name in names}, told.get("clamped") is True


def read_object(value: object) -> dict[str, Any]:
    return _object(value, "an answer")


def read_distances(value: Mapping[str, Any]) -> list[float]:
    """Return the millimetres of one frame of the depth sensor, row by row, the top first."""
    return list(_row(value.get("distance_mm"), "distance_mm", ZONES))


def _object(value: object, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise MalformedFrame(f"{what} is no object")
    return value


def _number(value: object, what: str) -> float:
    number = finite(value)
    if number is None:
        raise MalformedFrame(f"{what} is no finite number")
    return number


def _row(value: object, what: str, length: int) -> Row:
    if not isinstance(value, list) or len(value) != length:
        raise MalformedFrame(f"{what} are not {length} numbers")
    return tuple(_number(one, what) for one in value)


def _name_of(value: object) -> object:
    return value.get("name") if isinstance(value, dict) else value


def _names(value: object, what: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        raise MalformedFrame(f"{what} are no names")
    return tuple(one[:64] for one in value[:64])
