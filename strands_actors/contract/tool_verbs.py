"""What those who are not the robot's own program may ask of it: an agent, an MCP client, a command
from the mesh.

A driver declares its verbs as data (``Driver.TOOL_VERBS``). What a verb *does* is one of eight
things that every robot knows; what differs is its name, its inputs and the action they make. Verbs
that are commands are methods of the robot's handle, too, by the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

Does = Literal["status", "sensors", "state", "action", "move_to", "service", "torque", "stop"]

Schema = Mapping[str, Any]
"""JSON schema of one input."""


class ToolVerb(msgspec.Struct, frozen=True):
    """One verb. ``does``:

    ``status``   what ``get_status()`` says
    ``sensors``  positions, sensors and faults, with their age
    ``state``    positions and velocities, with their age
    ``action``   one command, as ``send_action()``: ``action``, and with it each input that is a number under its
                 own name, and the entries of each input that is an object
    ``move_to``  what ``move_to()`` does: input ``targets``, and ``seconds``
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
    lasts: str = ""
    """Of an ``action``: the input that says for how many seconds the command is sent again, before a
    zero. Without it the command is sent once, and lives as long as the driver says."""

    def command(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the command that an ``action`` with these inputs is."""
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

DURATION = "duration_s"
"""Input of a verb that holds a speed: for how many seconds."""


def held_move(says: str, speeds: Mapping[str, str], rest: Mapping[str, float]) -> ToolVerb:
    """Return the verb ``move`` of a base, which can hold its speeds.

    Args:
        says: How it moves, for a model that chooses.
        speeds: Axis to what its number means.
        rest: What each axis is told that the call does not name.
    """
    inputs: dict[str, Schema] = {
        axis: {"type": "number", "description": meaning} for axis, meaning in speeds.items()
    }
    inputs[DURATION] = {"type": "number", "description": "seconds to go on for, then stand; left out: one command"}
    return ToolVerb("move", "action", says, inputs, action=rest, lasts=DURATION)


MOVE_AT_ONCE = ToolVerb(
    "move_to",
    "action",
    "Move the named joints to their targets and hold there.",
    {"targets": {"type": "object", "description": "joint to target, in the robot's units"}},
    ("targets",),
)
"""For a driver that knows no more of its robot than that it takes targets."""

SET_TORQUE = ToolVerb(
    "set_torque",
    "torque",
    "Energise the motors where they are, or release them.",
    {"enabled": {"type": "boolean", "description": "false releases the motors: a raised arm falls"}},
    ("enabled",),
)
