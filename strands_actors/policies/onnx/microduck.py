"""Read the manifests of the Microduck community (schema 2) as manifests of this package. Pure.

Sources: ``docs/policy-manifest.md``, ``duck-control/src/obs.rs`` and ``model.rs`` of pollen-robotics/microduck
[read]. Every policy reads 61 numbers and writes 14, at 50 Hz:

    0..3     gyro of the trunk, rad/s            34..48   the last output of the network
    3..6     direction of gravity in the trunk   48..61   the command: vx, vy, vyaw; neck_pitch, head_pitch,
    6..20    positions minus the home pose, rad           head_yaw, head_roll; body x, y, z, roll, pitch, yaw
    20..34   velocities, rad/s

A folder holds one policy, with its fields at the top level, or a set of policies under ``policies``. Fields that
are absent claim nothing. A claim that is present and wrong is refused, as the robot's daemon refuses it.
"""

from __future__ import annotations

import math

import msgspec

from .manifest import (
    FILE,
    FORMAT,
    VERSION,
    Action,
    ActionKind,
    Command,
    Gravity,
    Joint,
    LastAction,
    Manifest,
    Position,
    SensorValues,
    Velocity,
    plain_file,
)

MODEL = "microduck"
OBSERVATIONS, ACTIONS, CONTROL_HZ = 61, 14, 50.0
ACTION_SCALE = 1.0
"""Scale of the output where the manifest states no ``action_scale`` [assumed]."""
NETWORK = "policy.onnx"
MODEL_API = 1
"""Newest ``model_api`` that is read here. Version 2 has recurrent networks."""
COMMAND = 13
KINDS = ("episodic", "perpetual", "scripted")

HOME_RAD = {
    "left_hip_yaw": 0.0,
    "left_hip_roll": -0.0873,
    "left_hip_pitch": -0.4579,
    "left_knee": -0.0049,
    "left_ankle": 0.4530,
    "neck_pitch": 0.3491,
    "head_pitch": 0.3491,
    "head_yaw": 0.0,
    "head_roll": 0.0,
    "right_hip_yaw": 0.0,
    "right_hip_roll": 0.0873,
    "right_hip_pitch": 0.4579,
    "right_knee": 0.0049,
    "right_ankle": -0.4530,
}
"""The joints in the order of the networks (without the mouth), and the home pose in rad."""


class RobotClaim(msgspec.Struct):
    """The claims about the robot."""

    model: str = MODEL
    control_hz: float = CONTROL_HZ


class CommandClaim(msgspec.Struct):
    """The claims about the command."""

    encoding: str = "constant"
    idle: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Entry(msgspec.Struct):
    """One policy. Fields that only people read are skipped."""

    file: str = NETWORK
    name: str = ""
    kind: str = ""
    description: str = ""
    duration_s: float | None = None
    action_scale: float = ACTION_SCALE
    obs_len: int = OBSERVATIONS
    action_len: int = ACTIONS
    model_api: int = MODEL_API
    robot: RobotClaim = msgspec.field(default_factory=RobotClaim)
    command: CommandClaim = msgspec.field(default_factory=CommandClaim)

    @property
    def label(self) -> str:
        """The name of the policy: its field, or else the stem of its file."""
        return self.name or self.file.removesuffix(".onnx")


class Document(Entry):
    """A manifest: one policy, or a set."""

    schema_version: int = 2
    policies: list[Entry] | None = None


_DECODER = msgspec.json.Decoder(Document)


def is_of_microduck(keys: set[str]) -> bool:
    """Return True if the keys of a manifest are those of the community's schema 1 or 2."""
    return "format" not in keys and bool(keys & {"schema_version", "obs_len", "policies", "model_api"})


def read_microduck(content: bytes, skill: str = "") -> Manifest:
    """Return the policy of a Microduck manifest.

    Args:
        content: The bytes of ``manifest.json``.
        skill: The policy of a set, by its name; empty if the manifest has only one.

    Raises:
        ValueError: The manifest is wrong, is not for this robot, or has no such policy. The text names the field.
    """
    try:
        document = _DECODER.decode(content)
    except msgspec.DecodeError as failure:
        raise ValueError(f"{FILE}: {failure}") from failure
    entry = _entry(document, skill)
    if problem := _problem(entry, document):
        raise ValueError(f"{FILE}: {entry.label[:100]}: {problem}")
    joints = tuple(Joint(name, "rad", home) for name, home in HOME_RAD.items())
    return Manifest(
        file=entry.file,
        control_hz=CONTROL_HZ,
        joints=joints,
        observation=(
            SensorValues("gyro_rad_s", 3),
            Gravity(),
            Position(),
            Velocity(),
            LastAction(),
            Command((0.0,) * COMMAND),
        ),
        action=Action(ActionKind.OFFSET, entry.action_scale, clip=True),
        format=FORMAT,
        version=VERSION,
        description=entry.description[:200],
        ends_s=entry.duration_s if entry.kind == "episodic" else None,
        idle=entry.command.idle,
    )


def _entry(document: Document, skill: str) -> Entry:
    if document.policies is None:
        if skill and skill != document.label:
            raise ValueError(f"{FILE} has only the skill {document.label[:100]!r}. Leave skill out")
        return document
    labels = {entry.label: entry for entry in document.policies}
    if skill not in labels:
        raise ValueError(f"{FILE} is a set. Give skill, one of {', '.join(sorted(labels))[:400]}")
    return labels[skill]


def _problem(entry: Entry, document: Document) -> str | None:
    """Return the first wrong claim of a policy; None if all are right."""
    if (entry.obs_len, entry.action_len) != (OBSERVATIONS, ACTIONS):
        lengths = f"obs_len is {entry.obs_len} and action_len {entry.action_len}"
        return f"{lengths}. A Microduck has {OBSERVATIONS} and {ACTIONS}"
    for robot in (document.robot, entry.robot):
        if (robot.model, robot.control_hz) != (MODEL, CONTROL_HZ):
            claim = f"robot is {robot.model[:100]!r} at {robot.control_hz:g} Hz"
            return f"{claim}. Known is {MODEL!r} at {CONTROL_HZ:g} Hz"
    if (newest := max(entry.model_api, document.model_api)) > MODEL_API:
        return f"model_api is {newest}, a recurrent network. Use one with model_api {MODEL_API}"
    if entry.kind and entry.kind not in KINDS:
        return f"kind is {entry.kind[:100]!r}. Known are {', '.join(KINDS)}"
    if entry.command.encoding != "constant":
        encoding = entry.command.encoding[:100]
        return f"its command has the encoding {encoding!r}, which only robotd gives. Run it there: load_policy()"
    numbers = (entry.action_scale, *entry.command.idle, 1.0 if entry.duration_s is None else entry.duration_s)
    if not all(map(math.isfinite, numbers)) or entry.action_scale == 0 or numbers[-1] <= 0:
        return "action_scale, duration_s or idle is no usable number. Give finite ones, and a duration above 0"
    return plain_file(entry.file)


__all__ = ["is_of_microduck", "read_microduck"]
