"""Read the arms of ``robots.toml``, the types of motors, and the table of an arm of one's own."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.drivers.common.kinematics.link_rows import with_limits
from strands_actors.drivers.common.kit.motor_targets import Joint
from strands_actors.drivers.common.kit.robot_tables import RobotTables

from .protocol import CODECS, HOST, Codec, Ranges

TABLES = RobotTables(__package__, "CAN motor")

GRIPPER = "gripper"


class MotorType(msgspec.Struct, frozen=True):
    """One row of ``motors.toml``."""

    family: str
    ranges: Ranges


def _types() -> dict[str, MotorType]:
    text = tomllib.loads(resources.files(__package__).joinpath("motors.toml").read_text("utf-8"))["types"]
    rows = (line.split() for line in text.splitlines() if line.strip())
    return {name: MotorType(family, Ranges(*map(float, numbers))) for name, family, *numbers in rows}


TYPES = _types()

Positive = Annotated[float, msgspec.Meta(gt=0)]
Gain = Annotated[float, msgspec.Meta(ge=0)]


class Motor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One joint with its motor. ``robots.toml`` describes each field."""

    key: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z]\w*$", max_length=32)]
    motor: str
    id: Annotated[int, msgspec.Meta(ge=1, le=0x7F)]
    feedback: Annotated[int, msgspec.Meta(ge=1, le=0x7FE)] | None = None
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    low: float
    high: float
    speed: Positive
    torque: Positive
    kp: Gain
    kd: Gain
    damp: Gain | None = None
    bus: Annotated[int, msgspec.Meta(ge=0, le=7)] = 0

    @property
    def type(self) -> MotorType:
        return TYPES[self.motor]

    @property
    def damp_kd(self) -> float:
        return self.kd if self.damp is None else self.damp

    @property
    def feedback_id(self) -> int:
        """The id of the motor's feedback. A RobStride motor sends it to the host."""
        if self.type.family == "robstride":
            return HOST
        return self.id + 16 if self.feedback is None else self.feedback

    @property
    def axis(self) -> Axis:
        return Axis(key=self.key, unit="rad", low=self.low, high=self.high, speed=self.speed, id=self.id)

    def codec(self, ranges: Ranges | None = None) -> Codec:
        """Return the motor's codec. ``ranges`` are those that the motor reports; None: those of its type."""
        return CODECS[self.type.family](
            self.id, self.feedback_id, ranges or self.type.ranges, self.sign, self.offset
        )


class Arm(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One arm, or two arms with one controller. It is the model that ``motor_targets`` checks commands by."""

    name: str
    motors: tuple[Motor, ...]
    on_silence: Literal["damp", "hold"] = "damp"
    hot_c: Positive = 80.0
    adapter: Literal["slcan", "damiao", "robstride"] = "slcan"
    rest: tuple[float, ...] | None = None

    @property
    def buses(self) -> int:
        return 1 + max(motor.bus for motor in self.motors)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        return tuple(
            Joint(
                key=motor.key,
                slot=motor.id,
                mode=0,
                low=motor.low,
                high=motor.high,
                torque=motor.torque,
                speed=motor.speed,
                kp=motor.kp,
                kd=motor.kd,
            )
            for motor in self.motors
        )

    @property
    def max_kp(self) -> float:
        return min(motor.type.ranges.kp for motor in self.motors)

    @property
    def max_kd(self) -> float:
        return min(motor.type.ranges.kd for motor in self.motors)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The axes: arms and grippers, each a separate part."""
        parts: list[tuple[PartKind, list[Axis]]] = []
        for motor in self.motors:
            kind = PartKind.GRIPPER if motor.key.endswith(GRIPPER) else PartKind.ARM
            if not parts or parts[-1][0] is not kind:
                parts.append((kind, []))
            parts[-1][1].append(motor.axis)
        return tuple(Part(kind, tuple(axes)) for kind, axes in parts)


class _Entries(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The entries of an arm of one's own."""

    joints: tuple[Motor, ...]
    on_silence: Literal["damp", "hold"] = "damp"
    hot_c: Positive = 80.0
    adapter: Literal["slcan", "damiao", "robstride"] = "slcan"
    rest: tuple[float, ...] | None = None
    links: str = ""
    base: dict[str, Any] = {}
    armature: float = 0.02
    friction: float = 0.1
    damping: float = 0.05


SIDES = ("left", "right")


def table_of(robot: str, side: str = "right") -> dict[str, Any]:
    """Return the table of an arm of ``robots.toml``, with the entries of one side."""
    table = TABLES.table(robot)
    if "both" not in table:
        return _of_side(table, side)
    joints: list[dict[str, Any]] = []
    links: list[str] = []
    for bus, name in enumerate(SIDES):
        one = _of_side(TABLES.table(table["both"]), name)
        joints += ({**joint, "key": f"{name}_{joint['key']}", "bus": bus} for joint in one["joints"])
        for body, parent, key, *rest in map(str.split, _lines(one["links"])):
            carrier = parent if parent == "base" else f"{name}_{parent}"
            links.append(" ".join((f"{name}_{body}", carrier, f"{name}_{key}", *rest)))
    return {**one, "joints": joints, "links": "\n".join(links), "rest": one["rest"] * 2}


def _of_side(table: Mapping[str, Any], side: str) -> dict[str, Any]:
    """Return the table of one arm. For a left arm the entries "left" of the joints and the rows of "left_links"
    replace those of a right arm."""
    kept = {name: value for name, value in table.items() if name not in ("aliases", "left_links", "looks")}
    kept["joints"] = [
        {**{name: value for name, value in joint.items() if name != "left"}, **(joint.get(side) or {})}
        for joint in table["joints"]
    ]
    if side == "left":
        other = {line.split()[0]: line for line in _lines(table.get("left_links", ""))}
        kept["links"] = "\n".join(other.get(line.split()[0], line) for line in _lines(table["links"]))
    return kept


def _lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip()]


def read_table(robot: str, path: str) -> dict[str, Any]:
    """Read the table of an arm of one's own.

    Raises:
        ValueError: The file cannot be read, or an entry is missing or not accepted.
    """
    try:
        table = tomllib.loads(Path(path).expanduser().read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{robot}: the table {path} cannot be read ({error}). Give the path of a TOML file"
        ) from None
    arm_of(robot, table)
    return table


def arm_of(robot: str, table: Mapping[str, Any]) -> Arm:
    """Return the arm of a table.

    Raises:
        ValueError: An entry is missing, unknown or not accepted. The text names it.
    """
    try:
        entries = msgspec.convert(table, _Entries)
    except msgspec.ValidationError as error:
        raise ValueError(f"{robot}: the table is not accepted: {error}. See docs/robots/can_motors.md") from None
    for wrong in _wrongs(entries):
        raise ValueError(f"{robot}: the table is not accepted: {wrong}")
    return Arm(
        name=robot,
        motors=entries.joints,
        on_silence=entries.on_silence,
        hot_c=entries.hot_c,
        adapter=entries.adapter,
        rest=entries.rest,
    )


def _wrongs(entries: _Entries) -> list[str]:
    motors = entries.joints
    if not motors:
        return ["it has no joints. Give at least one"]
    wrongs = [
        f"{joint.key} has the motor {joint.motor!r}. Use one of {', '.join(TYPES)}"
        for joint in motors
        if joint.motor not in TYPES
    ]
    if wrongs:
        return wrongs
    for joint in motors:
        ranges = joint.type.ranges
        limits = (("torque", joint.torque, ranges.torque), ("kp", joint.kp, ranges.kp))
        gains = (("kd", joint.kd, ranges.kd), ("damp", joint.damp_kd, ranges.kd))
        wrongs += [
            f"{name} of {joint.key} is {value:g}. A {joint.motor} has {most:g} at most"
            for name, value, most in (*limits, *gains)
            if not value <= most
        ]
        ends = [joint.sign * end + joint.offset for end in (joint.low, joint.high)]
        if not joint.low < joint.high or not all(abs(end) <= ranges.position for end in ends):
            wrongs.append(
                f"{joint.key} goes from {joint.low:g} to {joint.high:g} rad. Give low < high in the range"
            )
    keys = Counter(joint.key for joint in motors)
    ids = Counter((joint.bus, joint.type.family, joint.id) for joint in motors)
    answers = Counter((joint.bus, joint.feedback_id) for joint in motors if joint.type.family == "damiao")
    for name, counted in (("key", keys), ("id", ids), ("feedback", answers)):
        wrongs += [f"two joints have the same {name} ({each})" for each, count in counted.items() if count > 1]
    if entries.rest is not None and len(entries.rest) != len(motors):
        wrongs.append(f"rest has {len(entries.rest)} numbers. Give one for each of the {len(motors)} joints")
    return wrongs


def model_table(arm: Arm, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table from which the links are read: for the twin, gravity compensation and lowering.

    A table without links gets a body for each joint that turns alone, without gravity.
    """
    motors = {motor.key: motor for motor in arm.motors}

    def limits_of(key: str) -> str:
        motor = motors[key]
        return f"{motor.low},{motor.high} {motor.torque} -"

    links = str(table.get("links", "")) or "\n".join(
        f"link{number} base {motor.key} z {0.1 * number:g},0,0.2 0 0.5 0,0,0 s0.03"
        for number, motor in enumerate(arm.motors, 1)
    )
    entries = {name: table.get(name, value) for name, value in (("armature", 0.02), ("friction", 0.1))}
    return {
        **entries,
        "damping": table.get("damping", 0.05),
        "base": table.get("base", {}),
        "bandwidth": 30.0,
        "torque_motors": True,
        "home_rad": arm.rest or [0.0 if motor.low <= 0.0 <= motor.high else motor.low for motor in arm.motors],
        "joints": [{"key": motor.key} for motor in arm.motors],
        "model_rows": with_limits(links, limits_of),
        "lowers": bool(table.get("links")) and arm.rest is not None,
    }
