"""Walks of the robots behind gRPC."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.rby1 import protocol as rby1
from strands_actors.drivers.rby1.commands import Command, JointPosition, encode_command
from strands_actors.drivers.rby1.protocol import JointOrder, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.rby1.robots import TABLES as RBY1_TABLES
from strands_actors.drivers.rby1.twin.calls import CALLS as RBY1
from strands_actors.drivers.rby1.twin.controller import Controller
from strands_actors.drivers.rby1.twin.service import RBY1Service
from strands_actors.drivers.spot import protocol as spot
from strands_actors.drivers.spot.messages import encode, table
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.commands import CLOCK
from strands_actors.drivers.spot.twin.feedback import Progress
from strands_actors.drivers.spot.twin.requests import COMMANDS, METHODS

from .walk import Answer, Walk


def still() -> float:
    return 100.0


class GrpcCall:
    """A client's call, as the twin's service sees it."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.is_open = self.has_room = True
        self.sent: list[bytes] = []

    def log_received(self, t_ns: int, kind: str, message: bytes, safe_state: str | None = None) -> None: ...

    def send(self, message: bytes) -> None:
        self.sent.append(message)

    answer = send

    def end(self, status: object = None, text: str = "") -> None:
        self.is_open = False


# -- Spot

OTHER_SERVICES = (
    "AutoReturnService/ConfigureAutoReturn",
    "ChoreographyService/ExecuteChoreography",
    "DataBufferService/RecordTextMessages",
    "docking.DockingService/DockingCommand",
    "door.DoorService/OpenDoor",
    "FaultService/TriggerServiceFault",
    "GraphNavService/NavigateTo",
    "GripperCameraParamService/SetParams",
    "ImageService/GetImage",
    "KeepaliveService/CheckIn",
    "LocalGridService/GetLocalGrids",
    "ManipulationApiService/ManipulationApi",
    "PowerService/FanPowerCommand",
    "PowerService/ResetSafetyStop",
    "RobotCommandService/GripperCommand",
    "RobotStateService/GetRobotMetrics",
    "SpotCheckService/SpotCheckCommand",
    "WorldObjectService/MutateWorldObjects",
)


def awake() -> SpotTwin:
    """Return a Spot that stands, with a lease, an e-stop endpoint and its motors on."""
    twin = SpotTwin("spot", still, wall_ns=lambda: 10**18)
    lease = twin.answer("AcquireLease", {"header": {"client_name": "test"}, "resource": spot.LEASE_RESOURCE})
    assert lease[0]["status"] == spot.OK
    endpoint = {"role": spot.ESTOP_ROLE, "timeout": {"seconds": 1000}}
    config = twin.estop.set_config({"endpoints": [endpoint]}, "", False)["active_config"]
    end = twin.estop.register(endpoint, config["unique_id"])["new_endpoint"]
    for _ in range(2):
        challenge = twin.estop._endpoints[end["unique_id"]].challenge
        response = spot.challenge_response(challenge)
        twin.estop.check_in({"endpoint": end, "challenge": challenge, "response": response, "stop_level": 4})
    twin.mechanism.power_on(at_once=True)
    return twin


def lease_of(twin: SpotTwin) -> Mapping[str, Any]:
    lease: Mapping[str, Any] = twin.leases.listed()["lease"]
    return lease


def ask_spot(twin: SpotTwin, path: str, request: Mapping[str, Any]) -> Answer:
    by_name = {method.name: method.path for method in spot.METHODS.values()}
    call: Any = GrpcCall(by_name.get(path, path))
    if not twin.called(call):
        return Answer(False)
    whole = dict(request) | ({"lease": lease_of(twin)} if request.get("lease") else {})
    twin.message(call, 0, encode(spot.METHODS[path].request if path in spot.METHODS else _request(path), whole))
    return Answer(True, call.sent[0] if path.startswith(("Get", "List", "TimeSync", "Robot", "Retain")) else b"")


def _request(name: str) -> str:
    return next(method.request for method in spot.METHODS.values() if method.name == name)


def spot_commands() -> list[str]:
    parts = {"full_body_command": "FullBody", "mobility_command": "Mobility", "arm_command": "Arm"}
    parts["gripper_command"] = "Gripper"
    return [f"{part}.{name}" for part, kind in parts.items() for name in table(kind) if name != "params"]


def ask_command(twin: SpotTwin, name: str, content: Mapping[str, Any]) -> Answer:
    part, _, key = name.partition(".")
    command: dict[str, Any] = {part: {key: dict(content)}}
    if part != "full_body_command":
        command = {"synchronized_command": command}
    request = {"command": command, "lease": lease_of(twin), "clock_identifier": CLOCK}
    reply, _ = twin.answer("RobotCommand", request)
    # The list of accepted commands is no effect of a command.
    twin.commands._progress = Progress(twin.mechanism)
    return Answer(reply.get("status") == spot.Command.OK)


def walking(twin: SpotTwin) -> None:
    ask_command(twin, "mobility_command.stand_request", {})
    ask_command(twin, "mobility_command.se2_velocity_request", VELOCITY)


def reaching(twin: SpotTwin) -> None:
    ask_command(twin, "arm_command.arm_joint_move_command", ARM)


VELOCITY = {
    "end_time": spot.stamp(10**18 + round(124.5 * 10**9)),
    "velocity": {"linear": {"x": 0.3}},
    "se2_frame_name": "body",
}
TRAJECTORY = {
    "end_time": VELOCITY["end_time"],
    "trajectory": {"points": [{"pose": {"position": {"x": 0.3}}}]},
    "se2_frame_name": "odom",
}
ARM = {"trajectory": {"points": [{"position": {"sh0": {"value": 0.3}}}]}}
READY = {"position": 2}


# -- RB-Y1

RBY1_OTHERS = (
    "ControlManagerService/SetTimeScale",
    "JointOperationService/BrakeEngage",
    "JointOperationService/BrakeRelease",
    "JointOperationService/HomeOffsetReset",
    "LEDService/SetLEDColor",
    "LogService/GetLastLog",
    "ParameterService/SetParameter",
    "PowerService/ToolFlangePowerCommand",
    "RobotInfoService/ImportRobotModel",
    "RobotStateService/ResetOdometry",
    "SystemService/SetSystemTime",
    "SystemService/WifiConnect",
    "ToolFlangeService/SetToolFlangeOutputVoltage",
)


def rby1_on() -> RBY1Service:
    controller = Controller(RBY1_TABLES.table("rby1"), still)
    return RBY1Service(controller)


def energised(service: RBY1Service) -> None:
    controller = service.controller
    assert controller.power(".*", True) and controller.servo(".*", JointOrder.SERVO_ON)
    controller.order_manager(ManagerOrder.ENABLE)


def powered(service: RBY1Service) -> None:
    assert service.controller.power(".*", True)


def moving(service: RBY1Service) -> None:
    energised(service)
    ask_rby1(service, Method.COMMAND, HEAD)


def ask_rby1(service: RBY1Service, path: str, message: bytes) -> Answer:
    call: Any = GrpcCall(path)
    if not service.called(call):
        return Answer(False)
    service.message(call, 0, message)
    reads = path in (*READS, Method.PING)
    return Answer(True, b"".join(call.sent) if reads else b"")


READS = (
    Method.GET_ROBOT_INFO,
    Method.GET_ROBOT_MODEL,
    Method.GET_ROBOT_STATE,
    Method.GET_MANAGER_STATE,
    Method.WAIT_READY,
)
HEAD = encode_command({"head": JointPosition((0.1, 0.1), 1.0, 1.0)}, 1)


def other_commands() -> Iterator[tuple[str, Command]]:
    """Yield the commands of all kinds but joint positions, by the fields of the vendor's messages."""

    def within(*numbers: int) -> Command:
        data = b"\x08\x01"
        for number in reversed(numbers):
            data = pb.bytes_field(number, data)
        return Command.decode(pb.bytes_field(2, data))

    yield "real time control", within(2, 3)
    yield "jog", within(4)
    yield "mobility", within(3, 2)
    for number in (3, 4, 5, 7, 8):
        yield f"body {number}", within(3, 3, number)
    for part in (2, 3, 4):
        for number in range(3, 8):
            yield f"part {part} {number}", within(3, 3, 6, part, number)
    yield "head", within(3, 4, 3)


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    named = {"header": {"client_name": "test"}}
    lease = {**named, "lease": True}
    endpoint = {"role": spot.ESTOP_ROLE, "timeout": {"seconds": 10}}
    yield Walk(
        "spot",
        METHODS,
        [*METHODS.effects, *(f"/bosdyn.api.{name}" for name in OTHER_SERVICES)],
        awake,
        ask_spot,
        {
            **dict.fromkeys(METHODS.effects, named),
            "GetAuthToken": {**named, "username": "twin", "password": "twin"},
            "GetServiceEntry": {**named, "service_name": "lease"},
            "AcquireLease": {**named, "resource": spot.LEASE_RESOURCE},
            "TakeLease": {"header": {"client_name": "other"}, "resource": spot.LEASE_RESOURCE},
            "ReturnLease": lease,
            "RetainLease": lease,
            "PowerCommand": {**lease, "request": spot.POWER_OFF},
            "RobotCommand": {**lease, "command": spot.SAFE_POWER_OFF},
            "SetEstopConfig": {**named, "config": {"endpoints": [endpoint]}, "target_config_id": "config-1"},
            "RegisterEstopEndpoint": {**named, "new_endpoint": endpoint, "target_config_id": "config-1"},
            "DeregisterEstopEndpoint": {**named, "target_endpoint": {"unique_id": "endpoint-1-0"}},
            "EstopCheckIn": {
                **named,
                "endpoint": {"unique_id": "endpoint-1-0"},
                "challenge": 1014,
                "response": spot.challenge_response(1014),
                "stop_level": 1,
            },
        },
        ({},),
        {
            "AcquireLease": lambda twin: twin.leases.give_back(lease_of(twin)),
            "SetEstopConfig": lambda twin: twin.mechanism.cut(),
            "DeregisterEstopEndpoint": lambda twin: twin.mechanism.cut(),
        },
        # A login changes nothing, and there is no fault to clear (see the table).
        frozenset(("GetAuthToken", "ClearBehaviorFault", "PowerCommandFeedback", "AcquireLease")),
    )
    yield Walk(
        "spot commands",
        COMMANDS,
        spot_commands(),
        awake,
        ask_command,
        {
            **{name: {} for name in COMMANDS.effects},
            "full_body_command.safe_power_off_request": {"unsafe_action": 1},
            "mobility_command.se2_velocity_request": VELOCITY,
            "mobility_command.se2_trajectory_request": TRAJECTORY,
            "arm_command.named_arm_position_command": READY,
            "arm_command.arm_joint_move_command": ARM,
            "gripper_command.claw_gripper_command": {"trajectory": {"points": [{"point": -1.0}]}},
        },
        ({},),
        {
            "full_body_command.stop_request": walking,
            "mobility_command.stop_request": walking,
            "mobility_command.sit_request": walking,
            "arm_command.arm_stop_command": reaching,
        },
    )
    yield Walk(
        "rby1",
        RBY1,
        [*Method, *(f"/rb.api.{name}" for name in RBY1_OTHERS)],
        rby1_on,
        ask_rby1,
        {
            **dict.fromkeys(Method, b""),
            Method.STATE_STREAM: rby1.encode_rate(10.0),
            Method.POWER: rby1.encode_order(".*", PowerOrder.ON),
            Method.JOINT: rby1.encode_order(".*", JointOrder.SERVO_ON),
            Method.SERVO_ON: rby1.encode_order(".*", 0),
            Method.SERVO_OFF: rby1.encode_order(".*", 0),
            Method.MANAGER: rby1.encode_manager_order(ManagerOrder.DISABLE),
            Method.COMMAND: HEAD,
            Method.COMMAND_STREAM: HEAD,
        },
        (b"",),
        {
            Method.JOINT: powered,
            Method.SERVO_ON: powered,
            Method.SERVO_OFF: energised,
            Method.MANAGER: energised,
            Method.CANCEL: moving,
            Method.COMMAND: energised,
            Method.COMMAND_STREAM: energised,
        },
    )
