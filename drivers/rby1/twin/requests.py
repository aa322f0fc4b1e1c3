"""Decode commands of all kinds that the simulated robot models.

    RobotCommand > component based > mobility: velocity of the wheels or of the base
                                   > body: one command for its twenty joints, or
                                           > torso, right arm, left arm: one command each
                                   > head: joint positions
                 > whole body: stop
                 > jog: one joint

Each command is a ``Part``: the motion of some joints. Its ``path`` has the field numbers from the outermost message
to its own one. The feedback to a command has the same field numbers as the command itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import msgspec
import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.rby1.protocol import double, messages, text

from . import fields as f
from .calls import COMMANDS
from .fields import Fields
from .parts import (
    BASE,
    BODY,
    JOINTS,
    Aim,
    BaseMove,
    CartesianMove,
    Jog,
    JointMove,
    LinkSpring,
    Optimum,
    Part,
    Reach,
    Spring,
    Weightless,
)


class Request(msgspec.Struct, frozen=True):
    """A ``RobotCommandRequest``."""

    parts: dict[str, Part] = {}
    priority: int = 0
    stops: bool = False  # True for a ``StopCommand`` to the whole body
    asks: bool = False  # True for a request without a command: it asks for the feedback
    others: tuple[str, ...] = ()  # commands in it that the simulated robot does not model

    @classmethod
    def decode(cls, data: bytes) -> Request:
        """Raise ``MalformedFrame``, also for numbers that are not finite."""
        fields = pb.message(data)
        command = pb.message(pb.last_bytes(fields, 2))
        whole = pb.message(pb.last_bytes(command, 2))
        parts: dict[str, Part] = {}
        others = [name for name in _names(whole, "whole_body") if name not in COMMANDS]
        components = pb.message(pb.last_bytes(command, 3))
        if any(number not in (1, 2, 3, 4) for number in (*command, *components)):
            others.append("robot")
        for component, path, joints, content in _components(command):
            for number, name in _numbers(content, _FIELDS[_table_of(component)]):
                kind = f"{_table_of(component)}.{name}"
                encoded = pb.last_bytes(content, number)
                if name in _KNOWN and kind in COMMANDS and max(pb.message(encoded), default=0) <= _KNOWN[name]:
                    parts[component] = _DECODERS[name](encoded, (*path, number), joints)
                else:
                    others.append(kind)
        priority = pb.last_int(fields, 3)
        return cls(parts, priority, 2 in whole, set(command) <= {1}, tuple(others))


# -- the components, and the kinds of commands to each of them

_FIELDS: dict[str, dict[int, str]] = {
    "whole_body": {2: "stop_command", 3: "real_time_control_command"},
    "body": {
        2: "joint_position_command",
        3: "optimal_control_command",
        4: "gravity_compensation_command",
        5: "cartesian_command",
        7: "joint_impedance_control_command",
        8: "cartesian_impedance_control_command",
    },
    "torso": {
        2: "joint_position_command",
        3: "gravity_compensation_command",
        4: "cartesian_command",
        5: "impedance_control_command",
        6: "optimal_control_command",
        7: "joint_impedance_control_command",
        8: "cartesian_impedance_control_command",
        9: "joint_group_position_command",
    },
    "arm": {
        2: "joint_position_command",
        3: "gravity_compensation_command",
        4: "cartesian_command",
        5: "impedance_control_command",
        6: "joint_impedance_control_command",
        7: "cartesian_impedance_control_command",
    },
    "head": {2: "joint_position_command"},
    "mobility": {2: "joint_velocity_command", 3: "se2_velocity_command"},
    "robot": {4: "jog_command"},
}
"""Field numbers of the vendor's messages, by component."""

KINDS = tuple(f"{component}.{name}" for component, names in _FIELDS.items() for name in names.values())

_KNOWN = {
    "stop_command": 1,
    "joint_position_command": 5,
    "joint_group_position_command": 6,
    "joint_impedance_control_command": 8,
    "cartesian_command": 10,
    "cartesian_impedance_control_command": 12,  # 13 is a target in the null space
    "impedance_control_command": 8,
    "gravity_compensation_command": 2,
    "optimal_control_command": 11,
    "se2_velocity_command": 4,
    "joint_velocity_command": 4,
    "jog_command": 7,
}
"""The highest field number of each command that is modelled."""

_BY_PART = {"right_arm": 2, "left_arm": 3, "torso": 4}
_BY_PART_FIELD = 6


def _components(command: Fields) -> Iterator[tuple[str, tuple[int, ...], tuple[int, ...], Fields]]:
    """Yield name, path, joints and content of each component that a command names."""
    components = pb.message(pb.last_bytes(command, 3))
    if 2 in components:
        yield "mobility", (3, 2), BASE, pb.message(pb.last_bytes(components, 2))
    if 3 in components:
        body = pb.message(pb.last_bytes(components, 3))
        by_part = pb.message(pb.last_bytes(body, _BY_PART_FIELD))
        body.pop(_BY_PART_FIELD, None)
        yield "body", (3, 3), BODY, body
        for name, number in _BY_PART.items():
            if number in by_part:
                content = pb.message(pb.last_bytes(by_part, number))
                yield name, (3, 3, _BY_PART_FIELD, number), JOINTS[name], content
    if 4 in components:
        yield "head", (3, 4), JOINTS["head"], pb.message(pb.last_bytes(components, 4))
    if 4 in command:
        yield "robot", (), BODY, {4: command[4]}


def _table_of(component: str) -> str:
    return "arm" if component.endswith("_arm") else component


def _numbers(content: Fields, names: Mapping[int, str]) -> Iterator[tuple[int, str]]:
    """Yield number and name of each command in a message. Field 1 is a header."""
    for number in content:
        if number != 1:
            yield number, names.get(number, "")


def _names(content: Fields, component: str) -> Iterator[str]:
    for _, name in _numbers(content, _FIELDS[component]):
        yield f"{component}.{name}"


# -- single commands


def _joint_position(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    position = f.row(data, 3)
    if len(position) != len(joints):
        raise MalformedFrame(f"rb.api: {len(position)} positions for {len(joints)} joints")
    return JointMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 2),
        hold_s=f.hold_s(fields),
        position=position,
        speed=f.row_of(data, 4, len(joints)),
        acceleration=f.row_of(data, 5, len(joints)),
    )


def _joint_group(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    names = tuple(text(value) for value in fields.get(2, ()) if isinstance(value, bytes))
    position = f.row(data, 4)
    if len(position) != len(names):
        raise MalformedFrame(f"rb.api: {len(position)} positions for {len(names)} names of joints")
    return JointMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 3),
        hold_s=f.hold_s(fields),
        position=position,
        speed=f.row_of(data, 5, len(names)),
        acceleration=f.row_of(data, 6, len(names)),
        names=names,
    )


def _joint_impedance(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    move = _joint_position(data, path, joints)
    count = len(joints)
    spring = Spring(f.row_of(data, 6, count), f.optional(pb.message(data), 7, 1.0), f.row_of(data, 8, count))
    return msgspec.structs.replace(move, spring=f.checked(spring))


def _reach(entry: Fields) -> Reach:
    """Return a pose that a link should reach, with the limits that every kind of Cartesian command has."""
    return Reach(
        reference=f.name(entry, 1),
        link=f.name(entry, 2),
        pose=f.pose(entry, 3),
        linear_m_s=f.optional(entry, 4, math.inf),
        angular_rad_s=f.optional(entry, 5, math.inf),
    )


def _cartesian(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    return CartesianMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 2),
        hold_s=f.hold_s(fields),
        reaches=tuple(
            msgspec.structs.replace(_reach(entry), acceleration_scale=f.optional(entry, 6, 1.0))
            for entry in messages(fields, 3)
        ),
        aims=f.aims(fields, 10),
        stop_errors=f.stop_errors(fields, 4),
    )


def _cartesian_impedance(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    count = len(joints)
    return CartesianMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 2),
        hold_s=f.hold_s(fields),
        reaches=tuple(
            msgspec.structs.replace(
                _reach(entry),
                linear_m_s2=f.optional(entry, 6, math.inf),
                angular_rad_s2=f.optional(entry, 7, math.inf),
            )
            for entry in messages(fields, 3)
        ),
        aims=f.aims(fields, 4),
        stop_errors=f.stop_errors(fields, 5),
        limits=tuple((f.name(entry, 1), double(entry, 2), double(entry, 3)) for entry in messages(fields, 11)),
        spring=f.checked(Spring(f.row_of(data, 8, count), f.optional(fields, 9, 1.0), f.row_of(data, 10, count))),
    )


def _impedance(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    return LinkSpring(
        path=path,
        joints=joints,
        hold_s=f.hold_s(fields),
        reach=Reach(reference=f.name(fields, 3), link=f.name(fields, 4), pose=f.pose(fields, 5)),
        translation=f.positive(f.vector(fields, 6)),
        rotation=f.positive(f.vector(fields, 7)),
        damping=f.optional(fields, 8, 1.0),
    )


def _gravity(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    return Weightless(path=path, joints=joints, hold_s=f.hold_s(fields), on=bool(pb.last_int(fields, 2)))


def _optimal(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    mass = pb.message(pb.last_bytes(fields, 3))
    patience = pb.message(pb.last_bytes(fields, 9))
    return Optimum(
        path=path,
        joints=joints,
        hold_s=f.hold_s(fields),
        reaches=tuple(
            Reach(
                reference=f.name(entry, 1),
                link=f.name(entry, 2),
                pose=f.pose(entry, 3),
                weights=(f.finite(double(entry, 4)), f.finite(double(entry, 5))),
            )
            for entry in messages(fields, 2)
        ),
        aims=tuple(
            Aim(f.name(entry, 1), f.finite(double(entry, 2)), weight=f.finite(double(entry, 3)))
            for entry in messages(fields, 4)
        ),
        mass=(f.name(mass, 1), np.array(f.vector(mass, 2)), f.finite(double(mass, 3))) if mass else None,
        speed_scale=f.optional(fields, 5, 1.0),
        stop_cost=f.optional(fields, 7, None),
        least_change=f.optional(fields, 8, 0.0),
        patience=pb.last_int(patience, 1),
    )


def _se2_velocity(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    limit = pb.message(pb.last_bytes(fields, 4))
    return BaseMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 2),
        hold_s=f.hold_s(fields),
        velocity=f.velocity(pb.message(pb.last_bytes(fields, 3))),
        acceleration=f.velocity(limit) if limit else None,
    )


def _wheel_velocity(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    wheels = f.row(data, 3)
    if len(wheels) != len(joints):
        raise MalformedFrame(f"rb.api: {len(wheels)} speeds for {len(joints)} wheels")
    return BaseMove(
        path=path,
        joints=joints,
        minimum_s=f.minimum_s(fields, 2),
        hold_s=f.hold_s(fields),
        velocity=(0.0, 0.0),
        wheels=wheels,
    )


def _jog(data: bytes, path: tuple[int, ...], joints: tuple[int, ...]) -> Part:
    fields = pb.message(data)
    kinds = {5: "absolute", 6: "relative", 7: "one_step"}
    number = next((number for number in kinds if number in fields), 0)
    if not number:
        raise MalformedFrame("rb.api: a jog without a target")
    value = double(fields, number) if number != 7 else float(pb.last_int(fields, 7))
    return Jog(
        path=path,
        joints=joints,
        hold_s=f.hold_s(fields),
        name=f.name(fields, 2),
        kind=kinds[number],
        value=f.finite(value),
        rad_s=f.optional(fields, 3, math.inf),
    )


_DECODERS: dict[str, Callable[[bytes, tuple[int, ...], tuple[int, ...]], Part]] = {
    "joint_position_command": _joint_position,
    "joint_group_position_command": _joint_group,
    "joint_impedance_control_command": _joint_impedance,
    "cartesian_command": _cartesian,
    "cartesian_impedance_control_command": _cartesian_impedance,
    "impedance_control_command": _impedance,
    "gravity_compensation_command": _gravity,
    "optimal_control_command": _optimal,
    "se2_velocity_command": _se2_velocity,
    "joint_velocity_command": _wheel_velocity,
    "jog_command": _jog,
}
