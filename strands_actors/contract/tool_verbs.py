"""The verbs of a robot for agents, MCP clients and commands from the mesh.

A driver declares its verbs as data (``Driver.TOOL_VERBS``). Each verb does one of nine things that every robot can
do (see ``ToolVerb``). Robots differ in the names, inputs and actions of their verbs. Verbs that are commands are
also methods of the robot's handle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

Does = Literal["status", "sensors", "state", "pose", "action", "move_to", "service", "torque", "stop"]

Schema = Mapping[str, Any]
"""JSON schema of one input."""


class ToolVerb(msgspec.Struct, frozen=True):
    """One verb of a robot.

    ``does`` is one of these:

    ``status``   the result of ``get_status()``
    ``sensors``  positions, sensors and faults, with their age
    ``state``    positions and velocities, with their age
    ``pose``     the pose of the tool, as ``get_pose()`` returns it
    ``action``   one command to the axes, as ``send_action()`` sends it. It consists of the fixed values in
                 ``action``, of each number among the inputs, and of the entries of each object among the inputs
    ``move_to``  ``move_to()`` with the inputs ``targets`` and ``seconds``, or with those of a pose
    ``service``  the driver's service of that name, with the inputs as its arguments
    ``torque``   input ``enabled``: true energises at the measured position, false is a stop
    ``stop``     ``stop()``; it ignores all inputs
    """

    name: str
    does: Does
    description: str  # a sentence that describes the verb, for the model that chooses a verb
    inputs: Mapping[str, Schema] = {}
    required: tuple[str, ...] = ()
    action: Mapping[str, float] = {}
    lasts: str = ""
    """The input of an ``action`` with the seconds for which the command is re-sent, before a zero.
    Without it the command is sent once, with the lifetime of the driver."""

    def command(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the action that the verb commands for these inputs."""
        made: dict[str, Any] = dict(self.action)
        for name, value in inputs.items():
            if name != self.lasts:
                made |= value if isinstance(value, Mapping) else {name: value}
        return made


STATUS = ToolVerb("status", "status", "Connection, state, last refusal.")
SENSORS = ToolVerb("sensors", "sensors", "Measured positions, sensors and faults.")
STATE = ToolVerb("state", "state", "Measured positions and velocities.")
STOP = ToolVerb("stop", "stop", "Stop at once; nothing moves again until it is energised.")

MOVE_TO = ToolVerb(
    "move_to",
    "move_to",
    "Move the named joints to their targets in so many seconds, and hold there.",
    {
        "targets": {"type": "object", "description": "joint to target, in the robot's units"},
        "seconds": {"type": "number", "description": "how long it takes; left out: 2"},
    },
    ("targets",),
)

POSE_INPUTS = ("xyz", "rpy", "quat")
"""The inputs of ``move_to`` of which at least one makes it a motion to a pose."""

_NUMBERS: Schema = {"type": "array", "items": {"type": "number"}}

GET_POSE = ToolVerb("get_pose", "pose", "Pose of the tool in the base's frame: xyz in m, rpy in degrees, quat.")

MOVE_TO_POSE = ToolVerb(
    "move_to",
    "move_to",
    "Move the named joints to their targets in so many seconds, or the tool to a pose, and hold there.",
    {
        **MOVE_TO.inputs,
        "xyz": {
            **_NUMBERS,
            "description": "position of the tool in m; left out: it stays. x: ahead, y: left, z: up",
        },
        "rpy": {**_NUMBERS, "description": "roll, pitch, yaw of the tool in degrees; left out: as it is"},
        "quat": {**_NUMBERS, "description": "the orientation as w, x, y, z, in place of rpy"},
        "frame": {"type": "string", "description": "base, or tool: relative to the tool's pose; left out: base"},
        "speed": {"type": "number", "description": "top speed of the tool in m/s; left out: 0.1"},
        "linear": {"type": "boolean", "description": "false: joints move straight, the tool does not"},
        "keep_out": {
            "type": "array",
            "items": {"type": "object", "properties": {"center": _NUMBERS, "size": _NUMBERS}},
            "description": "boxes that the arm may not enter: center and size, x y z in m, in the base's frame",
        },
    },
)
"""The verb ``move_to`` of an arm whose driver has a model of it (``Driver.arm_model``)."""

DURATION = "duration_s"
"""The input with the seconds of a held speed."""


def held_move(description: str, speeds: Mapping[str, str], rest: Mapping[str, float]) -> ToolVerb:
    """Return the verb ``move`` of a mobile base that can keep its speeds.

    Args:
        description: A sentence that describes the verb, for the model that chooses a verb.
        speeds: The meaning of each axis' number.
        rest: The value of each axis that a call does not name.
    """
    inputs: dict[str, Schema] = {
        axis: {"type": "number", "description": meaning} for axis, meaning in speeds.items()
    }
    inputs[DURATION] = {"type": "number", "description": "seconds to go on for, then stand; left out: one command"}
    return ToolVerb("move", "action", description, inputs, action=rest, lasts=DURATION)


MOVE_AT_ONCE = ToolVerb(
    "move_to",
    "action",
    "Move the named joints to their targets and hold there.",
    {"targets": {"type": "object", "description": "joint to target, in the robot's units"}},
    ("targets",),
)
"""The verb of a driver that only knows that its robot accepts targets."""

SET_TORQUE = ToolVerb(
    "set_torque",
    "torque",
    "Energise the motors where they are, or release them.",
    {"enabled": {"type": "boolean", "description": "false releases the motors: a raised arm falls"}},
    ("enabled",),
)
