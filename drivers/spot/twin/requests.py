"""The methods of Spot's services, and the commands to its body, that the simulated robot models."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

METHODS: Modelled[str] = Modelled(
    "methods of its services",
    {
        "GetAuthToken": "logs in with the user and the password of its options, or with a valid token",
        "GetRobotId": "returns serial number and version",
        "ListServiceEntries": "returns the services",
        "GetServiceEntry": "returns one service",
        "RegisterService": "adds a service of the user's, which has a fault when it is not updated in time",
        "UpdateService": "replaces such a service",
        "UnregisterService": "removes such a service",
        "TimeSyncUpdate": "estimates the difference between the clocks",
        "AcquireLease": "gives the lease of the body, unless another client has it",
        "TakeLease": "gives the lease of the body",
        "ReturnLease": "takes the lease back",
        "RetainLease": "checks the lease",
        "ListLeases": "returns the owner of the lease",
        "GetRobotState": "returns joints, frames, speed, feet, battery, power, e-stops, faults and the arm",
        "GetRobotMetrics": "returns the distance walked, and for how long it moved and had power",
        "GetRobotHardwareConfiguration": "returns the links of the robot, without a URDF",
        "GetRobotLinkModel": "returns the model of one link: the name of its file, without contents",
        "PowerCommand": f"switches the motors on or off; status {p.Power.INTERNAL_ERROR:d} for other requests",
        "PowerCommandFeedback": "returns whether the motors are as commanded",
        "RobotCommand": "carries out the commands of the next table",
        "RobotCommandFeedback": "returns the progress of a command, part by part",
        "ListImageSources": "returns the cameras, with sizes, focal lengths and places",
        "GetImage": "returns pictures, or depth pictures, of a floor of tiles below a sky, as the camera sees it",
        "RecordOperatorComments": "keeps the comments",
        "ClearBehaviorFault": "clears a fault, unless broken hardware is its cause",
        "TriggerServiceFault": "adds a fault of a service of the user's",
        "ClearServiceFault": "removes such faults",
        "SetEstopConfig": "stores the endpoints",
        "GetEstopConfig": "returns the endpoints",
        "RegisterEstopEndpoint": "adds an endpoint, which stops the robot when it is silent",
        "DeregisterEstopEndpoint": "removes an endpoint",
        "GetEstopSystemStatus": "returns the level of each endpoint",
        "EstopCheckIn": "sets the level of an endpoint",
    },
    "gRPC status UNIMPLEMENTED",
)

COMMANDS: Modelled[str] = Modelled(
    "commands to its body",
    {
        "full_body_command.stop_request": "stops walking, body and arm",
        "full_body_command.safe_power_off_request": "sits down and switches the motors off",
        "mobility_command.stop_request": "stops walking and the body",
        "mobility_command.stand_request": "stands up, and carries the body as the parameters say",
        "mobility_command.sit_request": "sits down",
        "mobility_command.stance_request": "puts the feet to places, if they are near enough; stands up first",
        "mobility_command.follow_arm_request": "walks so that the body stays behind the hand's goal in the world",
        "mobility_command.se2_velocity_request": "walks with a velocity until a time; stands up first",
        "mobility_command.se2_trajectory_request": "walks along places until a time; stands up first",
        "arm_command.arm_joint_move_command": "moves the arm's joints through the points, within their ranges",
        "arm_command.arm_cartesian_command": "moves the hand along poses in a frame; forces: status 3, unsupported",
        "arm_command.arm_velocity_command": "moves the hand with a velocity until a time",
        "arm_command.arm_gaze_command": "turns the hand to places, and moves it along poses",
        "arm_command.named_arm_position_command": "moves the arm to stow, ready or carry",
        "arm_command.arm_stop_command": "stops the arm",
        "gripper_command.claw_gripper_command": "opens or closes the gripper through the points",
    },
    "status 3, unsupported, and nothing is carried out",
)
"""A robot without an arm accepts a command to its arm, and reports "incompatible hardware" in the feedback of that
part (``RobotCommandFeedbackStatus``, basic_command.proto)."""

NAMED_POSITIONS = {1: "carry_rad", 2: "ready_rad", 3: "home_rad"}
"""Row of ``robots.toml`` for each position of ``NamedArmPositionsCommand``: carry, ready and stow."""

_SETTINGS = "params"


def names_of(command: Message) -> Iterator[str]:
    """Yield the name of each command in a request, as in the table ``COMMANDS``."""
    parts = {"full_body_command": command.get("full_body_command"), **command.get("synchronized_command", {})}
    for part, content in parts.items():
        for name in content or ():
            if name != _SETTINGS:
                yield f"{part}.{name}"
