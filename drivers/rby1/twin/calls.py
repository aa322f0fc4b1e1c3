"""The calls to the robot's services, and the kinds of commands, that the simulated robot models."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.rby1.protocol import Method

CALLS: Modelled[str] = Modelled(
    "calls to its services",
    {
        Method.PING: "returns the robot's time",
        Method.GET_ROBOT_INFO: "returns joints, supplies and parts",
        Method.GET_ROBOT_MODEL: "returns the URDF",
        Method.IMPORT_ROBOT_MODEL: "stores a URDF with the robot's joints under a name",
        Method.GET_ROBOT_STATE: "returns joints, base, supplies, tool flanges, battery and the control manager",
        Method.STATE_STREAM: "sends such states at a rate",
        Method.RESET_ODOMETRY: "sets the pose of the odometry",
        Method.GET_MANAGER_STATE: "returns the state of the control manager",
        Method.POWER: "switches supplies on or off; status 2 for other orders",
        Method.JOINT: "switches servos on, engages or releases brakes; status 2 for other orders",
        Method.SERVO_ON: "switches servos on; status 2 without the supply of the motors",
        Method.SERVO_OFF: "switches servos off",
        Method.GET_GAINS: "returns the position gains of a joint, or of the joints of a part",
        Method.SET_GAINS: "sets position gains, which make a joint stiffer or weaker; status 2 while the control "
        "manager is enabled",
        Method.FLANGE_POWER: "sets the voltage of a tool flange",
        Method.FLANGE_OUTPUT: "sets the digital outputs of a tool flange",
        Method.MANAGER: "enables or disables the control manager or removes its fault; returns its state",
        Method.CANCEL: "ends the motion; the robot holds",
        Method.GET_TIME_SCALE: "returns the time scale",
        Method.SET_TIME_SCALE: "slows all motions down",
        Method.WAIT_READY: "returns whether the control manager is enabled",
        Method.COMMAND: "carries out a command; a kind that is not modelled ends with INITIALIZED_FAILED",
        Method.COMMAND_STREAM: "accepts such commands in a stream, and returns the feedback to each",
        Method.GET_PARAMETERS: "returns names and types of the parameters",
        Method.GET_PARAMETER: "returns a parameter",
        Method.SET_PARAMETER: "sets a parameter within its range",
        Method.RESET_PARAMETER: "sets a parameter to its stored value",
        Method.RESET_PARAMETERS: "sets all parameters to their stored values",
        Method.FACTORY_PARAMETER: "sets a parameter to its default",
        Method.FACTORY_PARAMETERS: "sets all parameters to their defaults",
        Method.DEFAULT_PARAMETER: "sets a parameter to its default",
        Method.DEFAULT_PARAMETERS: "sets all parameters to their defaults",
        Method.LED: "sets the colour of the LED",
        Method.GET_TIME: "returns the robot's time and time zone",
        Method.SET_TIME: "sets the robot's time and time zone",
        Method.BATTERY_LEVEL: "fixes the level of the battery",
        Method.BATTERY_CONFIG: "sets how the level follows from the voltage",
        Method.RESET_BATTERY: "resets that",
        Method.LAST_LOG: "returns the newest lines of the log",
        Method.LOG_STREAM: "sends new lines of the log at a rate",
        Method.LOG_LEVEL: "sets the least level of lines in the log",
        Method.FAULT_LOGS: "returns the names of the fault logs",
        Method.DOWNLOAD: "returns a fault log",
    },
    "gRPC status UNIMPLEMENTED",
)

_MOVE = "moves the joints to positions, within their ranges, speeds and the given limits"
_REACH = "moves links to poses; ends with UNEXPECTED_STATE near a singular position"
_SPRING = "moves the joints to positions as springs"
_FLOAT = "lets the joints give way to any force, without weight"
_LINK = "pulls a link to a pose with a spring"
_OPTIMUM = "moves the joints to the least cost"

COMMANDS: Modelled[str] = Modelled(
    "kinds of commands",
    {
        "whole_body.stop_command": "ends the motion",
        "body.joint_position_command": _MOVE,
        "body.optimal_control_command": _OPTIMUM,
        "body.gravity_compensation_command": _FLOAT,
        "body.cartesian_command": _REACH,
        "body.joint_impedance_control_command": _SPRING,
        "body.cartesian_impedance_control_command": f"{_REACH}; the joints are springs",
        "torso.joint_position_command": _MOVE,
        "torso.gravity_compensation_command": _FLOAT,
        "torso.cartesian_command": _REACH,
        "torso.impedance_control_command": _LINK,
        "torso.optimal_control_command": _OPTIMUM,
        "torso.joint_impedance_control_command": _SPRING,
        "torso.cartesian_impedance_control_command": f"{_REACH}; the joints are springs",
        "torso.joint_group_position_command": "moves the named joints",
        "arm.joint_position_command": _MOVE,
        "arm.gravity_compensation_command": _FLOAT,
        "arm.cartesian_command": _REACH,
        "arm.impedance_control_command": _LINK,
        "arm.joint_impedance_control_command": _SPRING,
        "arm.cartesian_impedance_control_command": f"{_REACH}; the joints are springs",
        "head.joint_position_command": _MOVE,
        "mobility.joint_velocity_command": "turns the wheels",
        "mobility.se2_velocity_command": "moves the base",
        "robot.jog_command": "moves one joint by a step",
    },
    "feedback with the finish code INITIALIZED_FAILED",
)

MODELLED = (CALLS, COMMANDS)
