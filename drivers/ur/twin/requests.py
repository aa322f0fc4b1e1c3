"""The requests to a UR controller that the simulated controller models, for each of its ports."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.ur import protocol as p

from .commands import Command

DASHBOARD: Modelled[str] = Modelled(
    "lines of the dashboard",
    {
        "polyscopeversion": "returns the version",
        "version": "returns the version",
        "get serial number": "returns the serial number",
        "get robot model": "returns the model",
        "is in remote control": "returns whether the controller is in remote control",
        "robotmode": "returns the mode of the arm",
        "safetymode": "returns the safety mode",
        "safetystatus": "returns the safety mode",
        "running": "returns whether a program runs",
        "programstate": "returns the state of the program",
        "get loaded program": "returns the loaded program",
        "isprogramsaved": "returns the loaded program, which is always saved",
        "get operational mode": "returns the operational mode",
        "stop": "ends the program",
        "pause": "pauses the program",
        "play": "continues the paused program, or starts the loaded one, which moves nothing",
        "power on": "powers the arm",
        "brake release": "releases the brakes",
        "power off": "switches the arm off",
        "unlock protective stop": "ends a protective stop",
        "restart safety": "ends a safety fault; the arm is off afterwards",
        "close popup": "notes it in the log",
        "close safety popup": "notes it in the log",
        "clear operational mode": "forgets the operational mode",
        "quit": "closes the connection",
        "shutdown": "switches the arm off and closes the connection",
        "load": "loads a stored program; 'File not found' for another one",
        "popup": "notes the text in the log",
        "addtolog": "notes the text in the log",
        "set operational mode": "stores the mode: manual or automatic",
    },
    "could not understand, with the line",
)

PACKETS: Modelled[int] = Modelled(
    "packets of RTDE",
    {
        p.Kind.VERSION: "accepts version 2",
        p.Kind.CONTROLLER: "returns the version",
        p.Kind.OUTPUTS: "agrees on outputs; NOT_FOUND for an unknown one",
        p.Kind.INPUTS: "agrees on inputs; NOT_FOUND for an unknown one, IN_USE for one of another client",
        p.Kind.START: "begins to send outputs",
        p.Kind.PAUSE: "stops sending outputs",
        p.Kind.DATA: "writes inputs",
        p.Kind.TEXT: "notes the text in the log, and is not answered",
    },
    "a text message with the error",
)

_MOTIONS = "moves the arm"
_RETURNS = "returns a value of the arm"
_COMPUTES = "computes a value"

FUNCTIONS: Modelled[str] = Modelled(
    "URScript functions",
    {
        **dict.fromkeys(("movej", "movel", "movep", "servoc", "servoj", "speedj", "speedl"), _MOTIONS),
        **dict.fromkeys(("stopj", "stopl"), "stops the arm"),
        **dict.fromkeys(("freedrive_mode", "teach_mode"), "frees the arm along all axes"),
        **dict.fromkeys(("end_freedrive_mode", "end_teach_mode"), "holds the arm"),
        "protective_stop": "stops the arm protectively",
        "sleep": "waits",
        "sync": "waits for the next cycle",
        "set_tcp": "stores the tool's frame",
        **dict.fromkeys(
            ("set_payload", "set_payload_mass", "set_payload_cog", "set_target_payload"), "stores the payload"
        ),
        "set_gravity": "stores the direction of gravity",
        **dict.fromkeys(
            ("set_standard_digital_out", "set_configurable_digital_out", "set_tool_digital_out", "set_digital_out"),
            "switches an output",
        ),
        **dict.fromkeys(("get_standard_digital_out", "get_digital_out"), "returns an output"),
        "get_standard_digital_in": "returns False: nothing is connected",
        **dict.fromkeys(("set_standard_analog_out", "set_analog_out"), "sets an output"),
        "set_tool_voltage": "sets the voltage of the tool",
        **dict.fromkeys(
            ("read_input_integer_register", "read_input_float_register", "read_input_boolean_register"),
            "returns a register of a client",
        ),
        **dict.fromkeys(
            ("write_output_integer_register", "write_output_float_register", "write_output_boolean_register"),
            "writes a register for clients",
        ),
        "rtde_set_watchdog": "stops the program if a client's register does not come",
        **dict.fromkeys(("textmsg", "popup"), "notes the text in the log; an error for a blocking popup"),
        **dict.fromkeys(
            (
                "get_actual_joint_positions",
                "get_target_joint_positions",
                "get_actual_joint_speeds",
                "get_actual_tcp_pose",
                "get_target_tcp_pose",
                "get_tcp_offset",
                "is_steady",
                "is_within_safety_limits",
                "get_steptime",
            ),
            _RETURNS,
        ),
        **dict.fromkeys(
            (
                "get_forward_kin",
                "get_inverse_kin",
                "pose_trans",
                "pose_inv",
                "pose_add",
                "d2r",
                "r2d",
                "sin",
                "cos",
                "sqrt",
                "norm",
            ),
            _COMPUTES,
        ),
        "signal_async_progress": "reports the progress of a path, in ur-rtde's script",
    },
    "the program ends with an error in the controller's log",
)

COMMANDS: Modelled[int] = Modelled(
    "commands to ur-rtde's control script",
    {
        Command.NONE: "waits for the next command",
        Command.KICK_WATCHDOG: "shows that the client runs",
        **dict.fromkeys(
            (Command.MOVE_J, Command.MOVE_J_IK, Command.MOVE_L, Command.MOVE_L_FK, Command.MOVE_PATH), _MOTIONS
        ),
        **dict.fromkeys((Command.SPEED_J, Command.SPEED_L, Command.JOG_START), _MOTIONS),
        **dict.fromkeys((Command.SERVO_J, Command.SERVO_C, Command.SERVO_L), _MOTIONS),
        **dict.fromkeys((Command.TEACH_MODE, Command.FREEDRIVE), "frees the arm along all axes"),
        **dict.fromkeys((Command.END_TEACH_MODE, Command.END_FREEDRIVE), "holds the arm"),
        **dict.fromkeys(
            (Command.SERVO_STOP, Command.SPEED_STOP, Command.STOP_J, Command.STOP_L, Command.JOG_STOP),
            "stops the arm",
        ),
        Command.PROTECTIVE_STOP: "stops the arm protectively",
        Command.STOP_SCRIPT: "ends the script",
        Command.SET_WATCHDOG: "stops the script if the client is silent",
        Command.FORCE_MODE: "moves the tool along compliant axes, where nothing resists; only type 2",
        Command.END_FORCE_MODE: "ends force mode and stops the arm",
        Command.FORCE_MODE_DAMPING: "slows force mode down",
        Command.FORCE_MODE_GAIN: "speeds force mode up",
        **dict.fromkeys(
            (Command.TOOL_CONTACT, Command.READ_CONTACT_DETECTION, Command.STOP_CONTACT_DETECTION),
            "returns that the tool touches nothing",
        ),
        Command.START_CONTACT_DETECTION: "looks for a contact, of which there is none",
        Command.MOVE_UNTIL_CONTACT: "moves the arm to the end of its reach, as it touches nothing",
        Command.ZERO_FT_SENSOR: "sets the force sensor, which shows zero, to zero",
        Command.GET_FREEDRIVE_STATUS: "returns that no singularity is near",
        **dict.fromkeys((Command.SET_PAYLOAD, Command.SET_TARGET_PAYLOAD), "stores the payload"),
        Command.SET_TCP: "stores the tool's frame",
        Command.SET_GRAVITY: "stores the direction of gravity",
        **dict.fromkeys(
            (Command.GET_TCP_OFFSET, Command.GET_FLANGE_POSE, Command.GET_JOINT_TORQUES, Command.IS_STEADY),
            _RETURNS,
        ),
        Command.GET_STEP_TIME: "returns 2 ms",
        **dict.fromkeys(
            (
                Command.POSE_TRANS,
                Command.GET_FORWARD_KINEMATICS,
                Command.GET_FORWARD_KINEMATICS_OF,
                Command.GET_INVERSE_KINEMATICS,
                Command.GET_INVERSE_KINEMATICS_NEAR,
                Command.HAS_INVERSE_KINEMATICS,
                Command.HAS_INVERSE_KINEMATICS_NEAR,
                Command.IS_POSE_WITHIN_LIMITS,
                Command.ARE_JOINTS_WITHIN_LIMITS,
            ),
            _COMPUTES,
        ),
    },
    "the script ends with an error in the controller's log",
)

MODELLED = (DASHBOARD, FUNCTIONS, PACKETS, COMMANDS)
