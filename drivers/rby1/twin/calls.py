"""The calls to the robot's services that the simulated robot models."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.rby1.protocol import Method

CALLS: Modelled[str] = Modelled(
    "calls to its services",
    {
        Method.PING: "returns an empty answer",
        Method.GET_ROBOT_INFO: "returns joints, supplies and parts",
        Method.GET_ROBOT_MODEL: "returns the URDF",
        Method.GET_ROBOT_STATE: "returns joints, supplies, battery and the control manager",
        Method.STATE_STREAM: "sends such states at a rate",
        Method.GET_MANAGER_STATE: "returns the state of the control manager",
        Method.POWER: "switches supplies on or off; status 2 for other orders",
        Method.JOINT: "switches servos on, or engages brakes; status 2 for other orders",
        Method.SERVO_ON: "switches servos on; status 2 without the supply of the motors",
        Method.SERVO_OFF: "switches servos off",
        Method.MANAGER: "enables or disables the control manager or removes its fault; returns its state",
        Method.CANCEL: "ends the motion; the robot holds",
        Method.WAIT_READY: "returns whether the control manager is enabled",
        Method.COMMAND: "moves torso, arms and head to joint positions, or stops; other kinds of commands end with "
        "INITIALIZED_FAILED",
        Method.COMMAND_STREAM: "accepts such commands in a stream",
    },
    "gRPC status UNIMPLEMENTED",
)

MODELLED = (CALLS,)
