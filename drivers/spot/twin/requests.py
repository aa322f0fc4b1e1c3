"""The methods of Spot's services, and the commands to its body, that the simulated robot models."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message

METHODS: Modelled[str] = Modelled(
    "methods of its services",
    {
        "GetAuthToken": "logs in with any name and password except the password 'wrong'",
        "GetRobotId": "returns serial number and version",
        "ListServiceEntries": "returns the services",
        "GetServiceEntry": "returns one service",
        "TimeSyncUpdate": "estimates the difference between the clocks",
        "AcquireLease": "gives the lease of the body, unless another client has it",
        "TakeLease": "gives the lease of the body",
        "ReturnLease": "takes the lease back",
        "RetainLease": "checks the lease",
        "ListLeases": "returns the owner of the lease",
        "GetRobotState": "returns joints, pose, speed, battery, power, e-stops and the arm's state",
        "PowerCommand": f"switches the motors on or off; status {p.Power.INTERNAL_ERROR:d} for other requests",
        "PowerCommandFeedback": "returns whether the motors are on",
        "RobotCommand": "carries out the commands of the next table",
        "RobotCommandFeedback": "returns whether the robot stands or sits, and whether the arm has arrived",
        "ClearBehaviorFault": "status 2, not cleared: there are no such faults",
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
        "full_body_command.stop_request": "stops walking and the arm",
        "full_body_command.safe_power_off_request": "sits down and switches the motors off",
        "mobility_command.stop_request": "stops walking and the arm",
        "mobility_command.stand_request": "stands up",
        "mobility_command.sit_request": "sits down",
        "mobility_command.se2_velocity_request": "walks with a velocity until a time; stands up first",
        "arm_command.arm_joint_move_command": "moves the arm's joints to the last point, within their ranges",
        "arm_command.arm_stop_command": "stops the arm",
        "gripper_command.claw_gripper_command": "opens or closes the gripper to the last point",
    },
    "status 3, unsupported, and nothing is carried out",
)

_SETTINGS = "params"


def names_of(command: Message) -> Iterator[str]:
    """Yield the name of each command in a request, as in the table ``COMMANDS``."""
    parts = {"full_body_command": command.get("full_body_command"), **command.get("synchronized_command", {})}
    for part, content in parts.items():
        for name in content or ():
            if name != _SETTINGS:
                yield f"{part}.{name}"
