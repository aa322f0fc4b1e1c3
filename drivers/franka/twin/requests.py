"""The requests to a Franka controller that the simulated controller models."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from strands_actors.drivers.common.twin.modelled import Modelled

from .path import is_transformation

SUCCESS, NOT_POSSIBLE, INVALID_ARGUMENT = b"\0", b"\1", b"\2"
"""Status in the reply to a request: carried out, not possible in this mode, or its argument is invalid."""

SETTINGS: dict[str, dict[str, int]] = {
    "load": {"m_load": 1, "F_x_Cload": 3, "I_load": 9},
    "ee_to_k": {"EE_T_K": 16},
    "ne_to_ee": {"NE_T_EE": 16},
    "collision": {"": 52},
    "joint_impedance": {"": 7},
    "cartesian_impedance": {"": 6},
}
"""Request that stores a setting -> the numbers in it: the field of the state that shows them, and their count. The
thresholds of contact and the stiffness are in no field."""

STIFFNESS: Mapping[str, tuple[tuple[float, float], ...]] = {
    "joint_impedance": ((0.0, 14250.0),) * 7,
    "cartesian_impedance": ((10.0, 3000.0),) * 3 + ((1.0, 300.0),) * 3,
}
"""Range of each stiffness, in Nm/rad or N/m, from the vendor's description of ``franka::Robot``."""


def numbers_of(name: str, payload: bytes) -> tuple[float, ...] | None:
    """Return the numbers in a request that stores a setting. None if they are invalid, too few or too many."""
    layout = struct.Struct(f"<{sum(SETTINGS[name].values())}d")
    if len(payload) != layout.size:
        return None
    numbers = layout.unpack(payload)
    return numbers if all(map(math.isfinite, numbers)) and _fits(name, numbers) else None


def _fits(name: str, numbers: Sequence[float]) -> bool:
    match name:
        case "ee_to_k" | "ne_to_ee":
            return is_transformation(numbers)
        case "load":
            return numbers[0] >= 0.0
        case "joint_impedance" | "cartesian_impedance":
            ranges = STIFFNESS[name]
            return all(low <= number <= high for number, (low, high) in zip(numbers, ranges, strict=True))
    return min(numbers) >= 0.0  # Thresholds of contact.


REQUESTS: Modelled[str] = Modelled(
    "requests on TCP",
    {
        "connect": "compares the versions, and sends states to the client's UDP port from then on",
        "move": "begins a motion, as in the table of motions",
        "stop": "ends the motion",
        "recover": "ends a reflex",
        "model": "returns the model",
        "load": "stores the payload; the state shows it",
        "ee_to_k": "stores the stiffness frame; the state shows it",
        "ne_to_ee": "stores the frame of the end effector, whose pose the state then shows",
        "collision": "stores the thresholds of contact; this arm meets nothing, so they are never exceeded",
        "joint_impedance": "sets the stiffness of the joints in motions under joint impedance",
        "cartesian_impedance": "sets about the stiffness of the end effector in motions under Cartesian impedance",
    },
    "status 1, command not possible; an unknown number closes the connection",
)

MOTIONS: Modelled[str] = Modelled(
    "motions, by controller and motion generator",
    {
        "joint_impedance joint_position": "moves the joints to positions",
        "joint_impedance joint_velocity": "moves the joints at speeds",
        "joint_impedance cartesian_position": "moves the end effector along poses; the state shows the joints",
        "joint_impedance cartesian_velocity": "moves the end effector at a velocity",
        "cartesian_impedance joint_position": "as under joint impedance, with the end effector's stiffness",
        "cartesian_impedance joint_velocity": "as under joint impedance, with the end effector's stiffness",
        "cartesian_impedance cartesian_position": "as under joint impedance, with the end effector's stiffness",
        "cartesian_impedance cartesian_velocity": "as under joint impedance, with the end effector's stiffness",
        "external joint_position": "applies torques; the state shows the commanded joints",
        "external joint_velocity": "applies torques; the state shows the commanded joints",
        "external cartesian_position": "applies torques; the state shows the joints of the commanded pose",
        "external cartesian_velocity": "applies torques; the state shows the joints of the commanded pose",
        "external none": "applies torques",
    },
    "invalid argument; not possible for the asynchronous motions of FCI 10, whose targets come at no rate",
)

TIME: Modelled[str] = Modelled(
    "time during a motion",
    {
        "a command within 1 ms": "is in time, as on a real controller",
        "no command within 1 ms": "counts as missed, and the controller goes on at constant acceleration",
        "20 missed commands in a row": "reflex communication_constraints_violation",
    },
    "While all processors of this computer are busy, the twin waits up to 10 ms for a command (options "
    "tick_wait_ms and stretches), and its log has the number of stretched milliseconds of each motion",
)

MODELLED = (REQUESTS, MOTIONS, TIME)
