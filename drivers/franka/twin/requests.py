"""The requests to a Franka controller that the simulated controller models."""

from __future__ import annotations

import struct

from strands_actors.drivers.common.twin.modelled import Modelled

NOT_POSSIBLE, INVALID_ARGUMENT = b"\1", b"\2"
"""Status in the reply to a request that is rejected: it is not possible, or its argument is invalid."""

SETTINGS: dict[str, dict[str, int]] = {
    "load": {"m_load": 1, "F_x_Cload": 3, "I_load": 9},
    "ee_to_k": {"EE_T_K": 16},
    "ne_to_ee": {"NE_T_EE": 16},
    "collision": {"": 52},
}
"""Request that stores a setting -> the numbers in it: the field of the state that shows them, and their count. The
thresholds of contact are in no field."""


def numbers_of(name: str, payload: bytes) -> tuple[float, ...] | None:
    """Return the numbers in a request that stores a setting. None if there are too few or too many."""
    layout = struct.Struct(f"<{sum(SETTINGS[name].values())}d")
    return layout.unpack(payload) if len(payload) == layout.size else None


REQUESTS: Modelled[str] = Modelled(
    "requests on TCP",
    {
        "connect": "compares the versions, and sends states from then on",
        "move": "begins a motion by joint positions, joint velocities or torques; status 'invalid argument' for "
        "Cartesian ones",
        "stop": "ends the motion",
        "recover": "ends a reflex",
        "model": "returns the model",
        "load": "stores the payload; the state shows it",
        "ee_to_k": "stores the stiffness frame; the state shows it",
        "ne_to_ee": "stores the frame of the end effector; the state shows it",
        "collision": "stores the thresholds of contact; this arm meets nothing, so they are never exceeded",
    },
    "status 1, command not possible; an unknown number closes the connection",
)

MODELLED = (REQUESTS,)
