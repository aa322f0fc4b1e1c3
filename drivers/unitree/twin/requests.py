"""The requests to a Unitree robot's services, and the topics, that the simulated robot models."""

from __future__ import annotations

from functools import cache

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.robots import TABLES, Model, model_of
from strands_actors.drivers.unitree.walking.loco import LocoDialect
from strands_actors.drivers.unitree.walking.robots import dialect_of

from . import arm_actions, arm_sdk, obstacles
from .arm_sdk import SLOTS

NO_SUCH_MODE = 7004
"""Answer of the motion switcher to a mode that the robot has not, from the vendor's SDK."""

ASK_BALANCE = {rpc.SET_BALANCE_MODE: 7003, rpc.LOCO_SET_BALANCE_MODE: 8003}
"""Request that sets the balance mode -> request that reads it, from the vendor's SDK."""

_NOT_IMPLEMENTED = f"error {rpc.NOT_IMPLEMENTED}, not implemented"
_VERSION = {rpc.SERVER_VERSION: "returns the version of the service"}

_NO_READER = "silence: no other topic has a reader"
_LOW = {p.COMMAND_TOPIC: "commands the joints; ignored while an onboard mode is active"}
HUMANOIDS = frozenset(SLOTS)

TOPICS: Modelled[str] = Modelled(
    "topics that it subscribes to", _LOW, _NO_READER, frozenset(TABLES.robots) - HUMANOIDS
)

HUMANOID_TOPICS: Modelled[str] = Modelled(
    "topics that it subscribes to",
    {**_LOW, arm_sdk.TOPIC: "commands the arms and the waist, in proportion to a weight, while the robot balances"},
    _NO_READER,
    HUMANOIDS,
)

SWITCHER: Modelled[int] = Modelled(
    f"requests to {rpc.MOTION_SWITCHER}",
    {
        **_VERSION,
        rpc.CHECK_MODE: "returns the onboard mode",
        rpc.SELECT_MODE: f"activates the robot's onboard mode; error {NO_SUCH_MODE} for another one",
        rpc.RELEASE_MODE: "releases the onboard mode; the joints then obey rt/lowcmd",
    },
    _NOT_IMPLEMENTED,
)

ARM: Modelled[int] = Modelled(
    f"requests to {arm_actions.SERVICE}",
    {
        **_VERSION,
        arm_actions.EXECUTE: (
            "makes a gesture, and answers at its end; errors: "
            f"{arm_actions.OCCUPIED} rt/arm_sdk is occupied, {arm_actions.HOLDING} a gesture is held, "
            f"{arm_actions.NO_SUCH_ACTION} no such gesture, {arm_actions.WRONG_FSM} the robot does not balance"
        ),
        arm_actions.LIST: "returns the gestures",
    },
    _NOT_IMPLEMENTED,
    frozenset(("unitree_g1",)),
)

OBSTACLES: Modelled[int] = Modelled(
    f"requests to {obstacles.SERVICE}",
    {
        **_VERSION,
        obstacles.SWITCH_SET: "switches the avoidance: the robot then stops before objects of the scene",
        obstacles.SWITCH_GET: "returns the switch",
        obstacles.MOVE: "walks at a velocity, or to a place; ignored before the remote control is taken over",
        obstacles.USE_REMOTE: "takes the remote control over, or returns it",
    },
    _NOT_IMPLEMENTED,
    frozenset(("unitree_go2",)),
)

_SPORT = {
    **_VERSION,
    rpc.DAMP: "brakes every joint",
    rpc.BALANCE_STAND: "unlocks the joints of a robot that stands",
    rpc.STOP_MOVE: "stops walking",
    rpc.STAND_UP: "stands up with locked joints",
    rpc.STAND_DOWN: "lies down",
    rpc.RECOVERY_STAND: "gets up and balances",
    rpc.MOVE: "walks at a velocity for a second",
}
_SIT = {rpc.SIT: "sits down", rpc.RISE_SIT: "rises from sitting"}
_IGNORED = "A request that does not fit the present mode is ignored and answered with success, as by the robot"


def _loco(words: LocoDialect) -> dict[int, str]:
    effects = {
        **_VERSION,
        words.ask_mode: "returns the number of the state (FSM id)",
        ASK_BALANCE[words.set_balance]: "returns the balance mode",
        words.set_mode: f"changes the state; error {rpc.NO_SUCH_FSM} for a number without a state",
        words.set_balance: "stores the balance mode",
        words.set_velocity: "walks at a velocity for a time",
    }
    if words.ask_odometry:
        effects |= {order.api: "starts the odometry" for order in words.opening_orders}
        effects[words.ask_odometry] = "returns the pose, after the start of the odometry"
    return effects


@cache
def requests_of(model: Model) -> Modelled[int]:
    """Return the requests to a robot's walking service that are modelled."""
    walks = model.walks
    title, robots = f"requests to {model.service}", frozenset((model.name,))
    if walks is None:
        return Modelled(title, _VERSION, _NOT_IMPLEMENTED, robots)
    dialect = dialect_of(walks)
    sport = {**_SPORT, **(_SIT if walks.sits else {})}
    effects = _loco(dialect) if isinstance(dialect, LocoDialect) else sport
    return Modelled(title, effects, f"{_NOT_IMPLEMENTED}. {_IGNORED}", robots)


def modelled_by(model: Model, service: str) -> Modelled[int]:
    """Return the requests to a service of a robot that are modelled."""
    others = {rpc.MOTION_SWITCHER: SWITCHER, arm_actions.SERVICE: ARM, obstacles.SERVICE: OBSTACLES}
    return others.get(service) or requests_of(model)


_WALKING = (requests_of(model_of(robot)) for robot in TABLES.robots)
MODELLED = (TOPICS, HUMANOID_TOPICS, SWITCHER, *_WALKING, ARM, OBSTACLES)
