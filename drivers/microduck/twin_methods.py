"""The methods of the simulated robotd: their parameters, the versions that have them, and their effects."""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p


class Param(NamedTuple):
    """One parameter of a simulated method: its type, and whether it is required."""

    value_type: type
    needed: bool = False


_F, _B, _S, _L = Param(float), Param(bool), Param(str), Param(list)
_N = Param(int)

METHODS: dict[str, dict[str, Param]] = {
    p.HELLO: {"api_version": Param(int, True)},
    p.MOVE: {"vx": _F, "vy": _F, "vyaw": _F},
    p.HEAD: {"neck_pitch": _F, "head_pitch": _F, "head_yaw": _F, "head_roll": _F},
    p.POSE: {"z": _F, "roll": _F, "pitch": _F, "active": _B},
    p.MOUTH: {"open": _F},
    p.LOOK: {"x": _F, "y": _F, "z": _F, "neck_pitch": _F},
    p.STOP: {},
    p.ENABLE: {"on": _B, "toggle": _B},
    p.INIT: {},
    p.RELAX: {},
    p.REBOOT_MOTORS: {"ids": _L},
    p.DO: {"skill": Param(str, True)},
    p.SOUND: {"tag": Param(str, True), "hold": _B},
    p.THEREMIN: {"active": Param(bool, True)},
    p.GET_MODE: {},
    p.SET_MODE: {"mode": _S},
    p.HEALTH: {},
    p.MODEL: {},
    p.POLICIES: {},
    p.LOAD_POLICY: {"slot": _S, "path": _S},
    p.RELOAD_POLICIES: {},
    p.SUBSCRIBE: {"hz": _N},
    "robot.modelApi": {},
    "robot.remoteSessionActive": {},
}
SINCE = {p.POLICIES: 18, p.LOAD_POLICY: 18, p.RELOAD_POLICIES: 19, p.MODEL: 24, p.REBOOT_MOTORS: 31}
"""First version with a method. The one of ``rebootMotors`` is [assumed]."""


CALLS: Modelled[str] = Modelled(
    "methods of robotd",
    {
        p.HELLO: "returns the versions",
        p.MOVE: "walks with a velocity",
        p.HEAD: "turns the head",
        p.POSE: "moves the trunk",
        p.MOUTH: "opens the beak",
        p.LOOK: "turns the head to a point",
        p.STOP: "stops walking",
        p.ENABLE: "lets a policy drive the duck, or ends that",
        p.INIT: "switches the motors on",
        p.RELAX: "switches the motors off",
        p.REBOOT_MOTORS: "switches the motors off",
        p.DO: "plays a skill; not accepted for an unknown one",
        p.SOUND: "keeps the tag, which nobody hears; an error for an unknown tag",
        p.THEREMIN: "shows the theremin in the state",
        p.GET_MODE: "returns the drive mode",
        p.SET_MODE: "sets the drive mode; not accepted for an unknown one",
        p.HEALTH: "returns battery, motors and loop",
        p.MODEL: "returns the joints",
        p.POLICIES: "returns the policies",
        p.LOAD_POLICY: "puts a policy into a slot; not accepted for an unknown slot",
        p.RELOAD_POLICIES: "puts the first policies back into the slots",
        p.SUBSCRIBE: "sends states at a rate",
        "robot.modelApi": "returns the version of the model",
        "robot.remoteSessionActive": "returns that there is no remote session",
    },
    "the JSON-RPC error METHOD_NOT_FOUND; INVALID_PARAMS for an unknown field",
)
