"""Name the function of the simulated base that carries out each call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import Call, SubError

from . import messages as m
from .commands import MOST_DEG_S, MOST_M_S
from .controller import Controller
from .errors import CallFailed
from .functions import ActionKind, Function
from .kinematics import numbers_of, pose_of
from .sessions import BaseSession
from .stores import Store
from .topics import TOPICS
from .zones import decode_zone, encode_zone


class Request(NamedTuple):
    payload: bytes
    device: int
    session: BaseSession


Answering = Callable[[Request], bytes]


def functions_of(base: Controller) -> Mapping[int, Answering]:
    """Return the function for each call, except ``CREATE_SESSION``."""
    functions: dict[int, Answering] = {**_of_the_base(base), **_of_the_stores(base), **_of_the_devices(base)}
    for topic in TOPICS:
        functions[topic] = _subscribing(base, topic)
    return functions


def _of_the_base(base: Controller) -> dict[int, Answering]:
    return {
        Call.KEEP_ALIVE: lambda request: b"",
        Call.CLOSE_SESSION: _done(lambda request: base.sessions.close(request.session.number)),
        Call.REFRESH_FEEDBACK: lambda request: base.encoded_feedback(),
        Call.GET_ARM_STATE: lambda request: p.encode_number(base.arm_state),
        Call.GET_SERVOING_MODE: lambda request: p.encode_number(base.mode),
        Call.GET_ACTUATOR_COUNT: lambda request: p.encode_number(p.JOINTS),
        Call.SET_SERVOING_MODE: _done(lambda request: base.choose_mode(p.decode_number(request.payload))),
        # Tests replace ``halt``, so it is looked up at each call.
        Call.STOP: _done(lambda request: base.halt()),
        Call.APPLY_EMERGENCY_STOP: _done(lambda request: base.stop_in_emergency()),
        Call.CLEAR_FAULTS: _done(lambda request: base.clear_faults()),
        Call.SEND_JOINT_SPEEDS: _done(lambda request: base.drive(request.payload)),
        Function.SEND_TWIST_COMMAND: _done(lambda request: base.move_tool(request.payload)),
        Function.SEND_GRIPPER_COMMAND: _done(lambda request: base.grip(request.payload)),
        Function.EXECUTE_ACTION: _done(lambda request: base.execute(request.payload)),
        Function.EXECUTE_ACTION_FROM_REFERENCE: _executing(base, ActionKind.EXECUTE_ACTION),
        Function.PLAY_JOINT_TRAJECTORY: _executing(base, ActionKind.REACH_JOINT_ANGLES),
        Function.PLAY_CARTESIAN_TRAJECTORY: _executing(base, ActionKind.REACH_POSE),
        Function.EXECUTE_WAYPOINT_TRAJECTORY: _executing(base, ActionKind.EXECUTE_WAYPOINT_LIST),
        Function.STOP_ACTION: _done(lambda request: base.stop_action()),
        Function.PLAY_SEQUENCE: _done(lambda request: base.play_sequence(request.payload)),
        Function.STOP_SEQUENCE: _done(lambda request: base.sequences.stop()),
        Function.UNSUBSCRIBE: _done(lambda request: base.topics.unsubscribe(request.payload)),
        Function.GET_MEASURED_GRIPPER_MOVEMENT: lambda request: (
            b"" if base.gripper is None else base.gripper.measured(request.payload)
        ),
        Function.GET_MEASURED_JOINT_ANGLES: lambda request: m.encode_angles(
            joint.position_deg for joint in base.feedback().actuators
        ),
        Function.GET_MEASURED_CARTESIAN_POSE: lambda request: m.floats(base.readings.pose(base.feedback())),
        Function.GET_ALL_JOINTS_SPEED_HARD_LIMITATION: lambda request: m.encode_joint_limits(
            np.degrees(base.fastest_rad_s).tolist()
        ),
        Function.GET_TWIST_HARD_LIMITATION: lambda request: m.floats((MOST_M_S, MOST_DEG_S)),
        Function.COMPUTE_FORWARD_KINEMATICS: lambda request: _forward(base, pb.message(request.payload)),
        Function.COMPUTE_INVERSE_KINEMATICS: lambda request: _inverse(base, pb.message(request.payload)),
        Function.VALIDATE_WAYPOINT_LIST: lambda request: base.waypoints.validate(base.arm.rest(), request.payload),
        Function.REFRESH: lambda request: base.refresh(request.payload) or base.encoded_feedback(),
        Function.REFRESH_COMMAND: lambda request: base.refresh(request.payload),
    }


def _of_the_stores(base: Controller) -> dict[int, Answering]:
    actions, sequences = base.actions, base.sequences
    return {
        Function.CREATE_USER_PROFILE: lambda request: base.users.create(request.payload),
        Function.DELETE_USER_PROFILE: lambda request: base.users.delete(request.payload),
        Function.CREATE_SEQUENCE: lambda request: sequences.create(request.payload),
        Function.READ_SEQUENCE: lambda request: sequences.read(request.payload),
        Function.READ_ALL_SEQUENCES: lambda request: sequences.read_all(),
        Function.DELETE_SEQUENCE: _deleting(sequences.store),
        Function.CREATE_PROTECTION_ZONE: lambda request: m.Handle(
            base.zones.add(decode_zone(request.payload))
        ).encode(),
        Function.READ_PROTECTION_ZONE: lambda request: _zone(base, m.identifier_of(request.payload)),
        Function.READ_ALL_PROTECTION_ZONES: lambda request: base.zones.encode_all(encode_zone),
        Function.DELETE_PROTECTION_ZONE: _deleting(base.zones),
        Function.CREATE_ACTION: lambda request: actions.create(request.payload),
        Function.READ_ACTION: lambda request: actions.read(request.payload),
        Function.READ_ALL_ACTIONS: lambda request: actions.read_all(request.payload),
        Function.DELETE_ACTION: _deleting(actions.store),
    }


def _of_the_devices(base: Controller) -> dict[int, Answering]:
    devices = base.devices
    functions: dict[int, Answering] = {
        Function.GET_PRODUCT_CONFIGURATION: lambda request: devices.product(),
        Function.READ_ALL_DEVICES: lambda request: devices.read_all(),
        Function.GET_CONTROL_MODE: lambda request: p.encode_number(base.arm.modes[devices.joint(request.device)]),
        Function.SET_CONTROL_MODE: _done(
            lambda request: base.set_control_mode(devices.joint(request.device), p.decode_number(request.payload))
        ),
    }
    for function in OF_EACH_DEVICE:
        functions[function] = _reading(base, function)
    return functions


def _done(command: Callable[[Request], None]) -> Answering:
    """Return a function that carries out a command, and returns an empty message."""

    def call(request: Request) -> bytes:
        command(request)
        return b""

    return call


def _executing(base: Controller, kind: ActionKind) -> Answering:
    return _done(lambda request: base.execute_as(kind, request.payload))


def _deleting(store: Store[Any]) -> Answering:
    return _done(lambda request: store.delete(m.identifier_of(request.payload)))


def _subscribing(base: Controller, topic: int) -> Answering:
    return lambda request: base.topics.subscribe(topic, request.session.connection, request.session.number)


def _reading(base: Controller, function: int) -> Answering:
    return lambda request: base.devices.read(function, request.device)


def _zone(base: Controller, number: int) -> bytes:
    return encode_zone(number, base.zones.get(number))


def _forward(base: Controller, fields: m.Fields) -> bytes:
    degrees = m.decode_angles(fields)
    if len(degrees) != p.JOINTS:
        raise CallFailed(SubError.ACTUATOR_COUNT_MISMATCH, f"{len(degrees)} angles, not {p.JOINTS}")
    return m.floats(numbers_of(base.kinematics.pose(np.radians(degrees).tolist())))


def _inverse(base: Controller, fields: m.Fields) -> bytes:
    guess = base.planner.goal(base.arm.target, m.decode_angles(m.sub_message(fields, 2)))
    rad = base.kinematics.near(pose_of(m.decode_pose(m.sub_message(fields, 1))), guess)
    if rad is None:
        raise CallFailed(SubError.OUTSIDE_WORKSPACE, "no angles for this pose near the guess")
    return m.encode_angles((np.degrees(rad) % 360.0).tolist())


OF_EACH_DEVICE = (
    Function.GET_DEVICE_TYPE,
    Function.GET_FIRMWARE_VERSION,
    Function.GET_BOOTLOADER_VERSION,
    Function.GET_MODEL_NUMBER,
    Function.GET_PART_NUMBER,
    Function.GET_SERIAL_NUMBER,
    Function.GET_MAC_ADDRESS,
    Function.GET_PART_NUMBER_REVISION,
)

STOPS = frozenset((Call.STOP, Call.APPLY_EMERGENCY_STOP, Function.STOP_ACTION, Function.STOP_SEQUENCE))

SETPOINTS = frozenset(
    (
        Function.SEND_TWIST_COMMAND,
        Function.EXECUTE_ACTION,
        Function.EXECUTE_ACTION_FROM_REFERENCE,
        Function.PLAY_JOINT_TRAJECTORY,
        Function.PLAY_CARTESIAN_TRAJECTORY,
        Function.EXECUTE_WAYPOINT_TRAJECTORY,
        Function.PLAY_SEQUENCE,
        Function.SEND_GRIPPER_COMMAND,
        Function.REFRESH,
        Function.REFRESH_COMMAND,
    )
)

READS = frozenset(
    (
        Call.REFRESH_FEEDBACK,
        Call.GET_ARM_STATE,
        Call.GET_SERVOING_MODE,
        Call.GET_ACTUATOR_COUNT,
        Function.READ_SEQUENCE,
        Function.READ_ALL_SEQUENCES,
        Function.READ_PROTECTION_ZONE,
        Function.READ_ALL_PROTECTION_ZONES,
        Function.READ_ACTION,
        Function.READ_ALL_ACTIONS,
        Function.GET_MEASURED_CARTESIAN_POSE,
        Function.GET_MEASURED_JOINT_ANGLES,
        Function.GET_MEASURED_GRIPPER_MOVEMENT,
        Function.GET_ALL_JOINTS_SPEED_HARD_LIMITATION,
        Function.GET_TWIST_HARD_LIMITATION,
        Function.GET_PRODUCT_CONFIGURATION,
        Function.COMPUTE_FORWARD_KINEMATICS,
        Function.COMPUTE_INVERSE_KINEMATICS,
        Function.VALIDATE_WAYPOINT_LIST,
        Function.GET_CONTROL_MODE,
        Function.READ_ALL_DEVICES,
        *OF_EACH_DEVICE,
    )
)
