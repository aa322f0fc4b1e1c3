"""Tables for SAF-021: which verbs can energise or move a robot after a stop, and how a trial notices it.

``ROWS`` has the verbs that are tried on twins (``test_late_arming.py``). ``NO_ROW`` has the other verbs of
every wire, each with the reason why nothing of it can take effect after a stop. A test checks that each verb
of each wire is in one of the two tables (``tests/house/test_late_rows.py``).

To add a robot, add a ``Row``. The verb is ``resume``, ``connect_eagerly`` or the name of a service.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from strands_actors.drivers.unitree import rpc
from strands_actors.testing.wirelog import WireLog

QUICK = 1
"""Moments of a row in the ordinary suite. The single moment is the middle of the verb, or it is while the request
waits (``queue_s``)."""
MANY, FEW, ONCE = (int(os.environ.get("STRANDS_ACTORS_MOMENTS", usual)) for usual in ("40", "4", "1"))
"""Moments in the long suite for each victim: of a UR, of other robots, and of requests that travel as those of
another row do. ``STRANDS_ACTORS_MOMENTS=40`` tries 40 moments of every row."""

QUEUE_S = 0.1
"""Delay of the requests of most robots. With a longer one, a robot would count as silent during a stop."""


class Seen(Protocol):
    """A trial, with its observations of the robot."""

    log: WireLog

    @property
    def held_by_wire(self) -> bool: ...

    def kinds(self, *kinds: str) -> list[str]: ...


Check = Callable[[Seen], bool]


@dataclass(frozen=True)
class Row:
    robot: str
    """Name of the robot, or ``robot:level``."""
    verb: str
    before: tuple[str, ...] = ()
    """Services that must run before the verb."""
    arguments: Mapping[str, object] = field(default_factory=dict)
    """Arguments of the services, by name. A service gets those that it has."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of the twin."""
    keywords: Mapping[str, object] = field(default_factory=dict)
    """Keyword arguments of the robot."""
    energised: Check = lambda trial: trial.held_by_wire
    """Returns whether the robot is energised or commanded although it should not be."""
    begun: Check | None = None
    """Returns whether the verb had an effect. None: the robot must be energised."""
    queue_s: float = 0.0
    """Time by which the robot delays requests of the wire process. It carries out others at once. The first
    moment is then while the first request waits."""
    fresh: bool = False
    """True if the twin's power is cut before each trial, because a stop leaves the robot ready to move, or
    because the twin's simulation has powered the motors."""
    moments: int = MANY
    quick: tuple[str, ...] = ()
    """Victims in the ordinary suite."""

    def __str__(self) -> str:
        words = (f"{name}={value}" if isinstance(value, bool) else value for name, value in self.keywords.items())
        return "-".join((self.robot, self.verb, *self.options, *map(str, words)))


ENERGISING = ("enable", "setpoint")


def energised_last(trial: Seen) -> bool:
    """Return whether the host's last energising or safe frame is an energising one.

    This serves robots that stay energised after a stop.
    """
    kinds = trial.kinds("safe", *ENERGISING)
    return bool(kinds) and kinds[-1] in ENERGISING


def wrote(kind: str) -> Check:
    return lambda trial: bool(trial.log.host(kind))


def requested(text: bytes) -> dict[str, Check]:
    """Return the checks of a verb whose request contains a text. The log has no kind for it."""

    def requests(trial: Seen) -> list[bool]:
        """Return for each request and each safe frame, in the order of the wire, whether it is a request."""
        frames = (entry for entry in trial.log.entries() if entry.sender == "host")
        return [text in entry.data for entry in frames if text in entry.data or entry.kind == "safe"]

    return {"energised": lambda trial: requests(trial)[-1:] == [True], "begun": lambda trial: any(requests(trial))}


def called(api: int) -> dict[str, Check]:
    """Return the checks of a request to a service of a Unitree, which has a number in its second word."""
    return requested(struct.pack("<q", api))


def few(robot: str, verb: str, **more: Any) -> Row:
    return Row(robot, verb, moments=FEW, **more)


def once(robot: str, verb: str, **more: Any) -> Row:
    """Return a row for a request that travels as that of another row does."""
    return Row(robot, verb, moments=ONCE, **more)


_ENABLED: dict[str, Any] = {"energised": energised_last, "begun": wrote("enable")}
_MOVED: dict[str, Any] = {"energised": energised_last, "begun": wrote("setpoint")}
_HELD: dict[str, Any] = {"energised": energised_last, "begun": wrote("safe")}
"""Arming a robot of these energises nothing. It sends a hold or a zero command."""
_UNARMED: dict[str, Any] = {"keywords": {"arm": False}, "fresh": True}
"""A stop leaves such a robot ready to move, so that only its first ``resume`` sends requests."""
_SPORT = "unitree_go2:sport"
_DUCK: dict[str, Any] = {"queue_s": QUEUE_S, "before": ("enable",)}

ROWS = [
    # A stop ends the running program while the upload is still loading. The upload starts after it.
    Row("ur5e", "resume", options={"program_load_s": 0.5}, quick=("caller", "root and wire")),
    few("ur5e", "resume", options={"program_load_s": 0.5}, keywords={"control": "script"}, quick=("wire",)),
    Row("ur5e", "resume"),
    Row("ur5e", "connect_eagerly"),
    few("ur5e", "connect_eagerly", keywords={"control": "script"}),
    few("so101", "resume"),
    few("so101", "connect_eagerly"),
    few("koch", "resume"),
    few("koch", "connect_eagerly"),
    few("openarm", "resume", **_ENABLED),
    few("openarm", "connect_eagerly", **_ENABLED),
    few("xarm7", "resume", queue_s=0.05, quick=("wire",)),
    few("xarm7", "connect_eagerly"),
    few("robotiq_2f85", "resume", queue_s=0.05, **_ENABLED, **_UNARMED),
    few("robotiq_2f85", "resume", options={"serial": True}, **_ENABLED, **_UNARMED),
    few("robotiq_2f85", "connect_eagerly", fresh=True, **_ENABLED),
    few("rby1", "resume", queue_s=QUEUE_S, **_ENABLED, **_UNARMED),
    few("rby1", "connect_eagerly", fresh=True, **_ENABLED),
    few("kinova_gen3", "resume", queue_s=0.02, **_ENABLED),
    few("kinova_gen3", "connect_eagerly", **_ENABLED),
    few("spot", "stand", queue_s=0.05, fresh=True),
    few("spot", "set_twist", before=("stand",), arguments={"vx": 0.2}, queue_s=0.05, fresh=True, **_MOVED),
    few("spot", "resume", queue_s=0.05, fresh=True, begun=wrote("other")),
    few("spot", "connect_eagerly", fresh=True, begun=wrote("config")),
    few("reachy_mini", "wake", queue_s=QUEUE_S, **_MOVED),
    once("reachy_mini", "sleep", queue_s=QUEUE_S, **_MOVED),
    once("reachy_mini", "express", arguments={"move": "yes1"}, queue_s=QUEUE_S, **_MOVED),
    once("reachy_mini", "turn_to_sound", queue_s=QUEUE_S, **_MOVED),
    few("reachy_mini", "track_face", queue_s=QUEUE_S, **_MOVED),
    few("reachy_mini", "motors", queue_s=QUEUE_S, **requested(b"/set_mode/enabled")),
    few("booster_t1", "enable_upper_body", queue_s=QUEUE_S, quick=("wire",)),
    few("booster_t1", "move", arguments={"vx": 0.2}, queue_s=QUEUE_S, **_MOVED),
    once("booster_t1", "rotate_head", arguments={"yaw": 0.2}, queue_s=QUEUE_S, **_MOVED),
    few("booster_t1", "change_mode", arguments={"mode": "prepare"}, queue_s=QUEUE_S, **requested(b'"mode"')),
    few("unitree_go2", "release_sport_mode", queue_s=QUEUE_S, fresh=True, **called(rpc.RELEASE_MODE)),
    few(_SPORT, "stand_up", before=("lie_down",), queue_s=QUEUE_S, **called(rpc.STAND_UP)),
    once(_SPORT, "lie_down", queue_s=QUEUE_S, fresh=True, **called(rpc.STAND_DOWN)),
    once(_SPORT, "recover", before=("lie_down",), queue_s=QUEUE_S, **called(rpc.RECOVERY_STAND)),
    once(_SPORT, "sit", queue_s=QUEUE_S, fresh=True, **called(rpc.SIT)),
    once(_SPORT, "rise", before=("sit",), queue_s=QUEUE_S, fresh=True, **called(rpc.RISE_SIT)),
    few("unitree_g1:sport", "squat", queue_s=QUEUE_S, fresh=True, **called(rpc.SET_FSM_ID)),
    once("unitree_g1:sport", "stand_up", before=("squat",), queue_s=QUEUE_S, fresh=True, **called(rpc.SET_FSM_ID)),
    once("unitree_g1:sport", "sit", queue_s=QUEUE_S, fresh=True, **called(rpc.SET_FSM_ID)),
    few("crazyflie", "takeoff", queue_s=0.05, fresh=True),
    few("microduck", "enable", queue_s=QUEUE_S, fresh=True, **requested(b"robot.enable")),
    few("microduck", "resume", **_HELD),
    few("microduck", "connect_eagerly", **_HELD),
    once("microduck", "disable", **_DUCK, **requested(b"robot.enable")),
    few("microduck", "init", queue_s=QUEUE_S, arguments={"confirm": True}, **requested(b"robot.init")),
    once("microduck", "reboot_motors", queue_s=QUEUE_S, arguments={"confirm": True}, **requested(b"rebootMotors")),
    few("microduck", "do", arguments={"skill": "kick_left"}, fresh=True, **_DUCK, **_MOVED),
    once("microduck", "sit", fresh=True, **_DUCK, **_MOVED),
    once("microduck", "look_at", arguments={"x": 1.0, "y": 0.2}, **_DUCK, **_MOVED),
    once("microduck", "theremin", **_DUCK, **_MOVED),
    once("microduck", "set_mode", queue_s=QUEUE_S, arguments={"mode": "roller"}, **requested(b"robot.setMode")),
    once("microduck", "load_policy", queue_s=QUEUE_S, arguments={"slot": "walk"}, **requested(b"robot.loadPolicy")),
    once("microduck", "reload_policies", queue_s=QUEUE_S, **requested(b"robot.reloadPolicies")),
    few("panda", "connect_eagerly", energised=energised_last, begun=wrote("config")),
    # Answers energise nothing. The arm holds its position while a session commands it.
    few("kuka_iiwa", "resume", **_HELD),
    few("kuka_iiwa", "connect_eagerly", quick=("root",), **_HELD),
    few("stretch3", "resume", **_HELD),
    few("stretch3", "connect_eagerly", **_HELD),
    few("yahboom_m3pro", "resume", **_HELD),
    few("yahboom_m3pro", "connect_eagerly", **_HELD),
    few("earthrover", "resume", **_HELD),
    few("earthrover", "connect_eagerly", **_HELD),
]

_NOTHING_SENT = "Arming sends nothing. It only checks the robot's reports."
_AS_A_SETPOINT = "It is a setpoint. It has a deadline (SAF-001) and is not written after a stop (SAF-002)."
_LEGS = "Arming energises nothing and sends nothing. The robot's own controller holds it up."
_OTHER_NAME = "It is another name of the service {}, and the same request."

NO_ROW: Mapping[str, Mapping[str, str]] = {
    "franka": {
        "resume": "Arming sends nothing. The controller holds the arm, and the first setpoint begins a motion.",
        "recover": "A recovery lets the controller leave its reflex. It energises nothing and begins no motion.",
        "home_gripper": "The hand's stop follows on the same connection, and so also ends a homing that waits.",
    },
    "rby1": {
        "reset_fault_control_manager": "The control manager becomes idle. Only resume() enables it.",
    },
    "reachy": {
        "resume": _NOTHING_SENT,
        "connect_eagerly": _NOTHING_SENT,
        "wake_up": _OTHER_NAME.format("wake"),
        "goto_sleep": _OTHER_NAME.format("sleep"),
        "play_move": _OTHER_NAME.format("express"),
    },
    "crazyflie": {
        "resume": "Arming only asks the drone's supervisor. The service takeoff starts the motors.",
        "connect_eagerly": "Arming only asks the drone's supervisor. The service takeoff starts the motors.",
        "set_twist": _AS_A_SETPOINT,
        "land": "A stop in the air lands, too. So a late landing does what the stop does.",
        "emergency_stop": "It is a stop itself.",
    },
    "microduck": {
        "stand": "It is the same request as sit: one skill toggles between both.",
        "relax": "It takes the torque away, as the safe state limp does.",
    },
    "stretch": {"set_twist": _AS_A_SETPOINT},
    "booster": {
        "resume": "Arming only asks for the mode. The robot's own controller holds it up.",
        "connect_eagerly": "Arming only asks for the mode. The robot's own controller holds it up.",
        "disable_upper_body": "It gives the arms back to the robot's controller, as a stop does.",
    },
    "unitree_g1": {"resume": _LEGS, "connect_eagerly": _LEGS},
    "unitree": {"resume": _LEGS, "connect_eagerly": _LEGS},
    "unitree_g1:sport": {
        "resume": _LEGS,
        "connect_eagerly": _LEGS,
        "balance": "It is the second request of stand_up.",
        "damp": "It brakes every joint, as an e-stop does.",
        "select_sport_mode": "A twin begins with the onboard controller on. Tried in virtual time.",
    },
    "unitree:sport": {
        "resume": _LEGS,
        "connect_eagerly": _LEGS,
        "balance": "It is the second request of stand_up.",
        "damp": "It brakes every joint, as an e-stop does.",
        "select_sport_mode": "A twin begins with the onboard controller on. Tried in virtual time.",
    },
}
"""Wire to verb to the reason why the verb has no row. A wire is a name in ``drivers.WIRES``, or such a name
with the level of its other driver classes."""
