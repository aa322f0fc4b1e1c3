"""Walks of the robots behind gRPC."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from strands_actors.drivers.spot import protocol as spot
from strands_actors.drivers.spot.messages import encode, table
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.commands import CLOCK
from strands_actors.drivers.spot.twin.faults import Cause
from strands_actors.drivers.spot.twin.feedback import Progress
from strands_actors.drivers.spot.twin.requests import COMMANDS, METHODS

from . import rby1
from .grpc_call import GrpcCall
from .walk import Answer, Walk


def still() -> float:
    return 100.0


# -- Spot

OTHER_SERVICES = (
    "AutoReturnService/ConfigureAutoReturn",
    "ChoreographyService/ExecuteChoreography",
    "DataBufferService/RecordTextMessages",
    "docking.DockingService/DockingCommand",
    "door.DoorService/OpenDoor",
    "GraphNavService/NavigateTo",
    "GripperCameraParamService/SetParams",
    "InverseKinematicsService/InverseKinematics",
    "KeepaliveService/CheckIn",
    "LocalGridService/GetLocalGrids",
    "ManipulationApiService/ManipulationApi",
    "PowerService/FanPowerCommand",
    "PowerService/ResetSafetyStop",
    "RobotCommandService/GripperCommand",
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
HAND = {
    "root_frame_name": "body",
    "pose_trajectory_in_task": {"points": [{"pose": {"position": {"x": 0.75, "z": 0.25}}}]},
}
UPWARDS = {"end_time": VELOCITY["end_time"], "cylindrical_velocity": {"linear_velocity": {"z": 0.5}}}
GAZE = {"frame1_name": "odom", "target_trajectory_in_frame1": {"points": [{"point": {"x": 3.0}}]}}
FEET = {"fl": (0.3, 0.2), "fr": (0.3, -0.2), "hl": (-0.3, 0.2), "hr": (-0.3, -0.2)}
STANCE = {
    "end_time": VELOCITY["end_time"],
    "stance": {
        "se2_frame_name": "odom",
        "foot_positions": [{"key": foot, "value": {"x": x, "y": y}} for foot, (x, y) in FEET.items()],
    },
}
ARM = {"trajectory": {"points": [{"position": {"sh0": {"value": 0.3}}}]}}
READY = {"position": 2}
SERVICE_FAULT: Mapping[str, Any] = {"fault_id": {"fault_name": "cold", "service_name": "camera"}}


def register_mine(twin: SpotTwin) -> None:
    twin.directory.register({"service_entry": {"name": "mine"}}, is_new=True)


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
            "RegisterService": {**named, "service_entry": {"name": "mine"}},
            "UpdateService": {**named, "service_entry": {"name": "mine", "type": "other"}},
            "UnregisterService": {**named, "service_name": "mine"},
            "GetImage": {**named, "image_requests": [{"image_source_name": "back_depth"}]},
            "RecordOperatorComments": {**named, "operator_comments": [{"message": "hello"}]},
            "ClearBehaviorFault": {**lease, "behavior_fault_id": 1},
            "TriggerServiceFault": {**named, "fault": SERVICE_FAULT},
            "ClearServiceFault": {**named, "fault_id": SERVICE_FAULT["fault_id"]},
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
            **dict.fromkeys(("UpdateService", "UnregisterService"), register_mine),
            "ClearBehaviorFault": lambda twin: twin.robot_faults.begin(Cause.FALL),
            "ClearServiceFault": lambda twin: twin.robot_faults.trigger_service_fault(SERVICE_FAULT),
            "SetEstopConfig": lambda twin: twin.mechanism.cut(),
            "DeregisterEstopEndpoint": lambda twin: twin.mechanism.cut(),
        },
        # A login changes nothing.
        frozenset(("GetAuthToken", "PowerCommandFeedback", "AcquireLease")),
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
            "mobility_command.stance_request": STANCE,
            "arm_command.arm_cartesian_command": HAND,
            "arm_command.arm_velocity_command": UPWARDS,
            "arm_command.arm_gaze_command": GAZE,
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
    yield from rby1.walks()
