"""What those who are not the robot's own program may ask of it: an agent, an MCP client, a command
from the mesh.

A driver declares its verbs as data (``Driver.TOOL_VERBS``). What a verb *does* is one of seven
things that every robot knows; what differs is its name, its inputs and the action they make.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

Does = Literal["status", "sensors", "state", "action", "service", "torque", "stop"]

Schema = Mapping[str, Any]
"""JSON schema of one input."""


class ToolVerb(msgspec.Struct, frozen=True):
    """One verb. ``does``:

    ``status``   what ``get_status()`` says
    ``sensors``  positions, sensors and faults, with their age
    ``state``    positions and velocities, with their age
    ``action``   one command, as ``send_action()``: ``action``, and with it each input that is a number under its
                 own name, and the entries of each input that is an object
    ``service``  the driver's service of that name, with the inputs as its arguments
    ``torque``   input ``enabled``: true energises at the measured position, false is a stop
    ``stop``     what ``stop()`` does; takes any input and minds none
    """

    name: str
    does: Does
    says: str  # a sentence by which a model chooses
    inputs: Mapping[str, Schema] = {}
    required: tuple[str, ...] = ()
    action: Mapping[str, float] = {}


STATUS = ToolVerb("status", "status", "Connection, state, last refusal.")
SENSORS = ToolVerb("sensors", "sensors", "Measured positions, sensors and faults.")
STATE = ToolVerb("state", "state", "Measured positions and velocities.")
STOP = ToolVerb("stop", "stop", "Stop at once; nothing moves again until it is energised.")

MOVE_TO = ToolVerb(
    "move_to",
    "action",
    "Move the named joints to their targets and hold there.",
    {"targets": {"type": "object", "description": "joint to target, in the robot's units"}},
    ("targets",),
)

SET_TORQUE = ToolVerb(
    "set_torque",
    "torque",
    "Energise the motors where they are, or release them.",
    {"enabled": {"type": "boolean", "description": "false releases the motors: a raised arm falls"}},
    ("enabled",),
)
