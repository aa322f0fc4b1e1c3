"""Walks of the RB-Y1: the calls to its services, and the kinds of commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.rby1 import protocol as rby1
from strands_actors.drivers.rby1.commands import Finish, JointPosition, encode_command, encode_duration
from strands_actors.drivers.rby1.protocol import JointOrder, Manager, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.rby1.robots import TABLES
from strands_actors.drivers.rby1.twin.calls import CALLS, COMMANDS
from strands_actors.drivers.rby1.twin.controller import Controller
from strands_actors.drivers.rby1.twin.journal import Level
from strands_actors.drivers.rby1.twin.requests import KINDS, Request
from strands_actors.drivers.rby1.twin.service import RBY1Service

from .grpc_call import GrpcCall
from .walk import Answer, Walk

OTHERS = (
    "GamepadService/UploadGamepadData",
    "JointOperationService/BrakeEngage",
    "JointOperationService/BrakeRelease",
    "JointOperationService/HomeOffsetReset",
    "JointOperationService/SetPresetPosition",
    "SerialService/GetSerialDeviceList",
    "SerialService/OpenSerialStream",
    "SystemService/ConnectWifi",
    "SystemService/DisconnectWifi",
    "SystemService/GetWifiStatus",
    "SystemService/ResetNetworkSetting",
    "SystemService/ScanWifi",
)

FIELDS = {
    "body": ((3, 3), (2, 3, 4, 5, 7, 8)),
    "torso": ((3, 3, 6, 4), (2, 3, 4, 5, 6, 7, 8, 9)),
    "arm": ((3, 3, 6, 2), (2, 3, 4, 5, 6, 7)),
    "head": ((3, 4), (2,)),
    "mobility": ((3, 2), (2, 3)),
    "whole_body": ((2,), (2, 3)),
    "robot": ((), (4,)),
}
"""Path of each component in the vendor's messages, and field numbers of its commands in the order of ``KINDS``."""

SECOND = encode_duration(1.0)
HOLD = pb.bytes_field(1, pb.bytes_field(1, SECOND))
CUTOFF = b"cartesian_command.cutoff_frequency"
SCALING = "default.velocity_limit_scaling"


def still() -> float:
    return 100.0


def on() -> RBY1Service:
    """Return a robot that keeps no log of its orders, so that a line in the log is not taken for their effect."""
    controller = Controller(TABLES.table("rby1"), still)
    controller.devices.journal.level = Level.CRITICAL
    return RBY1Service(controller)


def energised(service: RBY1Service) -> None:
    controller = service.controller
    assert controller.power(".*", True) and controller.servo(".*", JointOrder.SERVO_ON)
    controller.order_manager(ManagerOrder.ENABLE)


def powered(service: RBY1Service) -> None:
    assert service.controller.power(".*", True)


def moving(service: RBY1Service) -> None:
    energised(service)
    ask(service, Method.COMMAND, HEAD)


def logging(service: RBY1Service) -> None:
    journal = service.controller.devices.journal
    journal.level = Level.INFO
    journal.write(0, Level.INFO, "hello")


def faulty(service: RBY1Service) -> None:
    service.controller.fail(Manager.MAJOR_FAULT)
    faults = service.controller.devices.journal.faults
    faults["fault.csv"] = faults.popitem()[1]


def other_parameter(service: RBY1Service) -> None:
    service.controller.devices.parameters.set(SCALING, '{"value": 0.5}')


def passing_parameter(service: RBY1Service) -> None:
    service.controller.devices.parameters.set(SCALING, '{"value": 0.5, "write_db": false}')


def fixed_battery(service: RBY1Service) -> None:
    service.controller.devices.battery.fix(10.0)


def ask(service: RBY1Service, path: str, message: bytes) -> Answer:
    call: Any = GrpcCall(path)
    if not service.called(call):
        return Answer(False)
    service.message(call, 0, message)
    answer = b"".join(call.sent)
    accepted = (bool(answer) or call.is_open) and rby1.error_of(answer) == ""
    return Answer(accepted, answer if path in READS else b"")


def ask_command(service: RBY1Service, name: str, content: bytes) -> Answer:
    """Send one command. All its fields are those of the vendor's messages."""
    component, _, _ = name.partition(".")
    path, numbers = FIELDS[component]
    kinds = [kind for kind in KINDS if kind.startswith(f"{component}.")]
    for number in reversed((2, *path, numbers[kinds.index(name)])):
        content = pb.bytes_field(number, content)
    finish = service.controller.command(_Client(), Request.decode(content))
    service.controller.advance(0.0)
    return Answer(finish in (None, Finish.OK))


class _Client:
    def finished(self, reason: Finish) -> None: ...


READS = (
    Method.PING,
    Method.GET_ROBOT_INFO,
    Method.GET_ROBOT_MODEL,
    Method.GET_ROBOT_STATE,
    Method.GET_MANAGER_STATE,
    Method.WAIT_READY,
    Method.GET_PARAMETERS,
    Method.GET_PARAMETER,
    Method.GET_GAINS,
    Method.GET_TIME_SCALE,
    Method.GET_TIME,
    Method.LAST_LOG,
    Method.FAULT_LOGS,
    Method.DOWNLOAD,
)
HEAD = encode_command({"head": JointPosition((0.1, 0.1), 1.0, 1.0)}, 1)


def named(name: bytes, more: bytes = b"") -> bytes:
    return pb.bytes_field(2, name) + more


def wrapped(number: int, value: float) -> bytes:
    return pb.bytes_field(number, pb.double_field(1, value))


def joints(count: int, more: bytes = b"") -> bytes:
    return HOLD + pb.bytes_field(2, SECOND) + pb.double_fields(3, (0.0,) * count, packed=True) + more


def spring(count: int) -> bytes:
    return joints(count, pb.double_fields(6, (50.0,) * count, packed=True))


def link(side: bytes, first: int) -> bytes:
    """Encode names and pose of a link as it stands, roughly."""
    position = pb.double_field(1, 0.3) + pb.double_field(2, 0.0) + pb.double_field(3, 0.9)
    return (
        pb.bytes_field(first, b"base")
        + pb.bytes_field(first + 1, side)
        + pb.bytes_field(first + 2, pb.bytes_field(1, position))
    )


def reach(side: bytes, more: bytes = b"") -> bytes:
    return HOLD + pb.bytes_field(2, SECOND) + pb.bytes_field(3, link(side, 1)) + more


def pull(side: bytes) -> bytes:
    stiff = b"".join(pb.double_field(axis, 100.0) for axis in (1, 2, 3))
    return HOLD + link(side, 3) + pb.bytes_field(6, stiff) + pb.bytes_field(7, stiff)


def optimum(side: bytes) -> bytes:
    weights = pb.double_field(4, 1.0) + pb.double_field(5, 1.0)
    return HOLD + pb.bytes_field(2, link(side, 1) + weights)


FREE = HOLD + pb.varint_field(2, 1)
VELOCITY = pb.bytes_field(3, pb.bytes_field(1, pb.double_field(1, 0.1)))

REQUESTS: Mapping[str, bytes] = {
    "whole_body.stop_command": b"",
    "body.joint_position_command": joints(20),
    "body.optimal_control_command": optimum(b"ee_right"),
    "body.gravity_compensation_command": FREE,
    "body.cartesian_command": reach(b"ee_right"),
    "body.joint_impedance_control_command": spring(20),
    "body.cartesian_impedance_control_command": reach(b"ee_right", pb.double_fields(8, (50.0,) * 20, packed=True)),
    "torso.joint_position_command": joints(6),
    "torso.gravity_compensation_command": FREE,
    "torso.cartesian_command": reach(b"link_torso_5"),
    "torso.impedance_control_command": pull(b"link_torso_5"),
    "torso.optimal_control_command": optimum(b"link_torso_5"),
    "torso.joint_impedance_control_command": spring(6),
    "torso.cartesian_impedance_control_command": reach(
        b"link_torso_5", pb.double_fields(8, (50.0,) * 6, packed=True)
    ),
    "torso.joint_group_position_command": HOLD
    + pb.bytes_field(2, b"torso_1")
    + pb.double_fields(4, (0.1,), packed=True),
    "arm.joint_position_command": joints(7),
    "arm.gravity_compensation_command": FREE,
    "arm.cartesian_command": reach(b"ee_right"),
    "arm.impedance_control_command": pull(b"ee_right"),
    "arm.joint_impedance_control_command": spring(7),
    "arm.cartesian_impedance_control_command": reach(b"ee_right", pb.double_fields(8, (50.0,) * 7, packed=True)),
    "head.joint_position_command": joints(2),
    "mobility.joint_velocity_command": HOLD + pb.double_fields(3, (1.0, 1.0), packed=True),
    "mobility.se2_velocity_command": HOLD + VELOCITY,
    "robot.jog_command": HOLD + named(b"head_0") + pb.double_field(6, 0.1),
}


def ready() -> RBY1Service:
    service = on()
    energised(service)
    return service


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    model = on().controller.devices.urdf.encode()
    yield Walk(
        "rby1",
        CALLS,
        [*Method, *(f"/rb.api.{name}" for name in OTHERS)],
        on,
        ask,
        {
            **dict.fromkeys(Method, b""),
            Method.STATE_STREAM: rby1.encode_rate(10.0),
            Method.LOG_STREAM: rby1.encode_rate(10.0),
            Method.POWER: rby1.encode_order(".*", PowerOrder.ON),
            Method.JOINT: rby1.encode_order(".*", JointOrder.SERVO_ON),
            Method.SERVO_ON: rby1.encode_order(".*", 0),
            Method.SERVO_OFF: rby1.encode_order(".*", 0),
            Method.MANAGER: rby1.encode_manager_order(ManagerOrder.DISABLE),
            Method.COMMAND: HEAD,
            Method.COMMAND_STREAM: HEAD,
            Method.IMPORT_ROBOT_MODEL: named(b"mine", pb.bytes_field(3, model)),
            Method.RESET_ODOMETRY: named(pb.double_field(2, 1.0)),
            Method.GET_GAINS: named(b"torso_0"),
            Method.SET_GAINS: named(b"torso_0", pb.bytes_field(3, pb.varint_field(1, 50))),
            Method.FLANGE_POWER: named(b"right", pb.varint_field(3, 3)),
            Method.FLANGE_OUTPUT: named(b"left", pb.bytes_field(3, pb.varint_field(2, 1))),
            Method.SET_TIME_SCALE: pb.double_field(2, 0.5),
            Method.GET_PARAMETER: named(CUTOFF),
            Method.SET_PARAMETER: named(CUTOFF, pb.bytes_field(3, b'{"value": 5}')),
            Method.RESET_PARAMETER: named(SCALING.encode()),
            Method.FACTORY_PARAMETER: named(SCALING.encode()),
            Method.DEFAULT_PARAMETER: named(SCALING.encode()),
            Method.LED: named(pb.varint_field(1, 200)),
            Method.SET_TIME: named(pb.varint_field(1, 10**9), pb.bytes_field(3, b"UTC")),
            Method.BATTERY_LEVEL: pb.double_field(2, 50.0),
            Method.BATTERY_CONFIG: pb.double_field(2, 45.0)
            + pb.double_field(3, 58.0)
            + pb.double_fields(4, (1.0, 0.5, 0.0, 0.0), packed=True),
            Method.LAST_LOG: pb.varint_field(2, 5),
            Method.LOG_LEVEL: pb.varint_field(2, Level.ERROR),
            Method.DOWNLOAD: named(b"fault.csv"),
        },
        (b"",),
        {
            Method.JOINT: powered,
            Method.SERVO_ON: powered,
            Method.SERVO_OFF: energised,
            Method.GET_GAINS: powered,
            Method.SET_GAINS: powered,
            Method.FLANGE_POWER: powered,
            Method.FLANGE_OUTPUT: powered,
            Method.MANAGER: energised,
            Method.CANCEL: moving,
            Method.COMMAND: energised,
            Method.COMMAND_STREAM: energised,
            Method.RESET_PARAMETER: passing_parameter,
            Method.RESET_PARAMETERS: passing_parameter,
            Method.FACTORY_PARAMETER: other_parameter,
            Method.FACTORY_PARAMETERS: other_parameter,
            Method.DEFAULT_PARAMETER: other_parameter,
            Method.DEFAULT_PARAMETERS: other_parameter,
            Method.RESET_BATTERY: fixed_battery,
            Method.LAST_LOG: logging,
            Method.FAULT_LOGS: faulty,
            Method.DOWNLOAD: faulty,
        },
    )
    yield Walk(
        "rby1 commands",
        COMMANDS,
        KINDS,
        ready,
        ask_command,
        REQUESTS,
        (b"",),
        {"whole_body.stop_command": moving},
    )
