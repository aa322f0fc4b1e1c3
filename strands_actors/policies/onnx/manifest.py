"""The manifest of an ONNX policy: the inputs and outputs of its network. Pure.

The manifest is the JSON object in ``manifest.json``, beside the network. An example:

    {"format": "strands-actors-onnx", "version": 1, "file": "policy.onnx", "control_hz": 30,
     "joints": [{"name": "shoulder_pan", "unit": "rad", "offset": 0.0, "scale": 1.0}],
     "observation": [{"block": "position"}, {"block": "last_action"}],
     "history": 1,
     "action": {"kind": "offset", "scale": 0.5, "chunk": 1}}

The network reads one vector of float32: the blocks of ``observation`` in their order, of the last ``history``
readings, the oldest first. It writes ``chunk`` rows of one number per joint.

    position       (position - offset) * scale of each joint, in the unit of the joint
    velocity       velocity * scale of each joint, in the unit of the joint per second
    last_action    the last row that the network wrote; zeros at the start
    gravity        direction of gravity in the frame of the body, from the sensor rpy_rad
    sensor         the values of a sensor, times a factor
    constant       fixed numbers
    command        numbers that the user may set (option ``command``)

A number ``a`` of a row becomes the target of its joint, where ``factor`` is the action's scale / the joint's scale:

    absolute, offset   offset + a * factor
    delta              the measured position + a * factor

With ``clip`` a target beyond the range of its joint becomes the end of that range. Without it the robot refuses
such a target, which ends the run. Networks of legged robots often aim beyond a range, to press harder.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path

import msgspec

FORMAT = "strands-actors-onnx"
VERSION = 1
FILE = "manifest.json"
MOST_BYTES = 1 << 20
"""Largest manifest. Real ones have a few kilobytes."""
MOST_JOINTS, MOST_NUMBERS, MOST_CHUNK, MOST_HISTORY = 256, 4096, 1000, 100

FACTORS = {
    ("deg", "rad"): math.pi / 180.0,
    ("rad", "deg"): 180.0 / math.pi,
    ("percent", "share"): 0.01,
    ("m", "mm"): 1000.0,
}
"""Factor from a unit of an axis to another unit that a manifest may use for it."""


class Joint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A joint of the network. ``offset`` is in ``unit``, ``scale`` has no unit."""

    name: str
    unit: str
    offset: float = 0.0
    scale: float = 1.0


class Position(msgspec.Struct, frozen=True, tag="position", tag_field="block", forbid_unknown_fields=True):
    """The positions of all joints."""


class Velocity(msgspec.Struct, frozen=True, tag="velocity", tag_field="block", forbid_unknown_fields=True):
    """The velocities of all joints."""

    scale: float = 1.0


class LastAction(msgspec.Struct, frozen=True, tag="last_action", tag_field="block", forbid_unknown_fields=True):
    """The last row that the network wrote."""


class Gravity(msgspec.Struct, frozen=True, tag="gravity", tag_field="block", forbid_unknown_fields=True):
    """The direction of gravity in the frame of the body, a unit vector."""


class SensorValues(msgspec.Struct, frozen=True, tag="sensor", tag_field="block", forbid_unknown_fields=True):
    """The values of a sensor of the robot."""

    key: str
    size: int
    scale: float = 1.0


class Constant(msgspec.Struct, frozen=True, tag="constant", tag_field="block", forbid_unknown_fields=True):
    """Fixed numbers."""

    values: tuple[float, ...]


class Command(msgspec.Struct, frozen=True, tag="command", tag_field="block", forbid_unknown_fields=True):
    """Numbers that the user may set. ``values`` are the defaults."""

    values: tuple[float, ...]


Block = Position | Velocity | LastAction | Gravity | SensorValues | Constant | Command


class ActionKind(StrEnum):
    """How a number of the network becomes a target."""

    ABSOLUTE = "absolute"
    OFFSET = "offset"
    DELTA = "delta"


class Action(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The output of the network."""

    kind: ActionKind
    scale: float = 1.0
    chunk: int = 1
    clip: bool = False


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The inputs and outputs of a network.

    Attributes:
        file: Name of the network's file, beside the manifest.
        control_hz: Actions per second.
        joints: The joints, in the order of the network.
        observation: The blocks of the input.
        action: The output.
        format: ``FORMAT``.
        version: ``VERSION``.
        history: Number of readings in the input.
        description: Text for people.
        ends_s: Time after which ``idle`` replaces the first numbers of the command (s); None for never.
        idle: See ``ends_s``.
    """

    file: str
    control_hz: float
    joints: tuple[Joint, ...]
    observation: tuple[Block, ...]
    action: Action
    format: str
    version: int
    history: int = 1
    description: str = ""
    ends_s: float | None = None
    idle: tuple[float, ...] = ()

    @property
    def inputs(self) -> int:
        """The number of values that the network reads."""
        return self.history * sum(size_of(block, len(self.joints)) for block in self.observation)

    @property
    def outputs(self) -> int:
        """The number of values that the network writes."""
        return self.action.chunk * len(self.joints)


_DECODER = msgspec.json.Decoder(Manifest)


def read_manifest(content: bytes) -> Manifest:
    """Return a manifest in this package's format.

    Args:
        content: The bytes of ``manifest.json``.

    Raises:
        ValueError: It is no such manifest, or a value cannot be right. The text names the field.
    """
    try:
        manifest = _DECODER.decode(content)
    except msgspec.DecodeError as failure:
        raise ValueError(f"{FILE}: {failure}") from failure
    if problem := next(_problems(manifest), None):
        raise ValueError(f"{FILE}: {problem}")
    return manifest


def size_of(block: Block, joints: int) -> int:
    """Return how many numbers a block has."""
    match block:
        case Position() | Velocity() | LastAction():
            return joints
        case Gravity():
            return 3
        case SensorValues(size=size):
            return size
        case Constant(values=values) | Command(values=values):
            return len(values)


def plain_file(name: str) -> str | None:
    """Return why a name is not a plain file name; None if it is one."""
    if name == Path(name).name and not name.startswith(".") and name.endswith(".onnx"):
        return None
    return f"file is {name[:100]!r}. Give the plain name of an .onnx file beside the manifest"


def factor_of(axis_unit: str, unit: str) -> float | None:
    """Return the factor from the unit of an axis to the unit of the manifest; None if they do not convert."""
    return 1.0 if axis_unit == unit else FACTORS.get((axis_unit, unit))


def _problems(manifest: Manifest) -> Iterator[str]:
    if (manifest.format, manifest.version) != (FORMAT, VERSION):
        yield f"its format is {manifest.format[:100]!r}, version {manifest.version}. Known is {FORMAT!r}, {VERSION}"
    if problem := plain_file(manifest.file):
        yield problem
    if not 0 < manifest.control_hz <= 1000:
        yield f"control_hz is {manifest.control_hz}. Give a rate in hertz, above 0 and at most 1000"
    names = [joint.name for joint in manifest.joints]
    if not 1 <= len(names) <= MOST_JOINTS or len(set(names)) != len(names):
        different = f"{len(names)} names, {len(set(names))} of them different"
        yield f"joints has {different}. Name 1 to {MOST_JOINTS}, each once"
    for joint in manifest.joints:
        if not math.isfinite(joint.offset) or not _is_factor(joint.scale):
            yield f"joint {joint.name[:100]}: offset or scale is no usable number. Give finite ones, no scale of 0"
    if not _is_factor(manifest.action.scale) or not 1 <= manifest.action.chunk <= MOST_CHUNK:
        yield f"action: scale must be finite and not 0, and chunk a number from 1 to {MOST_CHUNK}"
    if not 1 <= manifest.history <= MOST_HISTORY:
        yield f"history is {manifest.history}. Give a number from 1 to {MOST_HISTORY}"
    if manifest.history > 1 and manifest.action.chunk > 1:
        yield "history and chunk are both above 1. A reading is taken for each chunk, so a history needs chunk 1"
    if not all(_is_sound(block) for block in manifest.observation):
        yield f"observation: a number is not finite, or a sensor's size is not from 1 to {MOST_NUMBERS}"
    elif not 1 <= manifest.inputs <= MOST_NUMBERS * MOST_HISTORY:
        yield f"observation has {manifest.inputs} numbers. Give 1 to {MOST_NUMBERS} in each reading"
    if sum(isinstance(block, Command) for block in manifest.observation) > 1:
        yield "observation has two blocks of commands. Give one"


def _is_factor(value: float) -> bool:
    return math.isfinite(value) and value != 0.0


def _is_sound(block: Block) -> bool:
    match block:
        case SensorValues(size=size, scale=scale):
            return 1 <= size <= MOST_NUMBERS and _is_factor(scale)
        case Velocity(scale=scale):
            return _is_factor(scale)
        case Constant(values=values) | Command(values=values):
            return len(values) <= MOST_NUMBERS and all(math.isfinite(value) for value in values)
    return True


def command_of(manifest: Manifest, given: Sequence[float]) -> tuple[float, ...]:
    """Return the command of a run: the numbers that the user gives, then the manifest's defaults.

    Raises:
        ValueError: There are more numbers than the command has, or one is not finite.
    """
    defaults = next((block.values for block in manifest.observation if isinstance(block, Command)), ())
    if len(given) > len(defaults) or not all(_is_number(value) for value in given):
        raise ValueError(f"onnx: command is {list(given)[:20]!r}. Give at most {len(defaults)} finite numbers")
    return (*map(float, given), *defaults[len(given) :])


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


__all__ = ["FILE", "Action", "ActionKind", "Block", "Command", "Joint", "Manifest", "command_of", "read_manifest"]
