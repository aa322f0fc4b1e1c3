"""Drive Kinova Gen3 arms through Kortex: kinova_gen3, with seven joints.

The base accepts joint speeds, and a commanded speed never expires. The wire process (the only writer to the robot)
therefore sends new speeds in every control period while a command is valid. When the command expires, it sends
``Stop``. The supervising process (root) has a separate connection on which it can send ``Stop``, too
(``stop_channel``). It is open before the arm is energised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from msgspec import structs

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Axis, Part, PartKind, parse_action
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.loading import load
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options, secrets_of
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATE, STATUS, STOP, ToolVerb
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.kit.hand import FORCE, MODEL_UNITS, SPEED, HandKeys, hand_axis
from strands_actors.drivers.common.kit.hand_gates import gates_with_hand
from strands_actors.drivers.common.kit.hand_verbs import HAND_VERBS
from strands_actors.drivers.common.kit.refusals import no_hand_setting
from strands_actors.kernel.messages import Refused

from .config import KinovaConfig
from .gates import CONDITIONS, all_gates, needed_speeds
from .hand import HAND_ID, HAND_PERCENT_S
from .robots import INTERFACE_M, LAST_LINK, MOUNTED, TABLES, Gripper, model_table

SILENT_PERIODS = 3
"""Number of periods without a new speed, or without new feedback, after which the arm is stopped."""


class Options(DriverOptions, frozen=True):
    username: Annotated[str, option("user of the base", min_length=1)] = "admin"
    password: Annotated[str, option("the user's password; it is kept out of recordings", secret=True)] = "admin"
    control_frequency: Annotated[float, option("joint speeds sent per second, 10 to 100", ge=10, le=100)] = 40.0
    gripper: Annotated[
        Gripper | None, option("the gripper on the interface, which the base serves, as one more axis; None: none")
    ] = None


class Kinova(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.kinova.wire:KinovaWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.kinova.stop_channel:KinovaStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.kinova.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (pose("tool_position_m", frame="base", tcp_position="tool_position_m"),)
    TORQUES: ClassVar[str] = "torque_nm"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("gripper",)
    SECRETS: ClassVar[frozenset[str]] = secrets_of(Options)

    config: KinovaConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    firmware_watchdog = (
        "The firmware has no watchdog: joint speeds never expire, and neither the end of a connection nor that of "
        "a session promises a stop. If wire and root end at once, the arm goes on until its own limits stop it"
    )
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, Options, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        table = TABLES.table(robot)
        self.robot = TABLES.canonical(robot)
        fastest_rad_s = float(table["gate_rad_s"])
        period_s = 1.0 / chosen.control_frequency
        silent_s = SILENT_PERIODS * period_s
        self.timing = Timing(
            control_hz=chosen.control_frequency,
            keepalive_s=period_s / 2,  # Shorter than a control period, so that speeds are sent in each period.
            stream_ttl_s=silent_s,
            oneshot_ttl_s=None,
            state_ttl_s=silent_s,
            arm_s=3.0,
            tick_s=period_s / 2,  # The control period must be a whole number of ticks.
            heartbeat_ttl_s=silent_s,
        )
        joints = tuple(_axes(table, fastest_rad_s))
        self.gripper: str = chosen.gripper or ""
        hand = (Part(PartKind.GRIPPER, (hand_axis(HAND_ID, HAND_PERCENT_S),)),) if self.gripper else ()
        self.declare(Part(PartKind.ARM, joints), *hand)
        if self.gripper:
            vars(self)["TOOL_VERBS"] = (*HAND_VERBS, *self.TOOL_VERBS)
        self._hand = HandKeys(self.robot, self.table) if self.gripper else None
        self._joints = len(joints)
        self.config = KinovaConfig(
            robot=self.robot,
            port=port,
            login=(chosen.username, chosen.password),
            axes=self.axes[: self._joints],
            fastest_rad_s=fastest_rad_s,
            period_s=period_s,
            silent_s=silent_s,
            gripper=self.gripper,
        )
        gates = all_gates(joints, self.timing.state_ttl_s, period_s)
        self.gates = gates_with_hand(gates, self.table) if self.gripper else gates

    def model_units(self) -> tuple[tuple[float, float], ...]:
        units = super().model_units()
        return (*units[:-1], MODEL_UNITS) if self.gripper else units

    def link_rows(self) -> str:
        return str(TABLES.table(self.robot)["model_rows"])

    def check_port(self) -> None:
        self.config.address()

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of each joint (rad), followed by the speed that each joint needs for it (rad/s).

        Between both are the three numbers of a gripper: its opening, speed and force.
        """
        if self._hand is not None:
            for key in (SPEED, FORCE):
                if key in action:
                    return no_hand_setting(key)
            kept = structs.replace(state, target=state.target[: len(self.table) + 2])
            candidate = self._hand.parse(action, kept)
            if isinstance(candidate, Refused):
                return candidate
            speeds = self._needed_speeds(candidate.values, state)
            return Candidate((*candidate.values, *speeds), candidate.named)
        parsed = parse_action(action, self.robot, self.table, self._index, state.target[: len(self.table)])
        if isinstance(parsed, Refused):
            return parsed
        target, named = parsed
        return Candidate((*target, *self._needed_speeds(target, state)), named)

    def _needed_speeds(self, target: Sequence[float], state: GateState) -> tuple[float, ...]:
        return needed_speeds(target[: self._joints], state, self.config.period_s)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return super().as_json(values[: len(self.axes)])

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        table = TABLES.table(self.robot)
        joints, home = self.config.axes, tuple(table["home_rad"])
        if self.gripper:
            link, tool_m = load(f"{MOUNTED}:LINK"), load(f"{MOUNTED}:tool_m")(self.gripper)
            return ArmModel(arm_table(model_table(self.robot, self.gripper)), joints, link, tool_m, home=home)
        # The tool points along the negative axis z of the last link.
        place, turn = (0.0, 0.0, -INTERFACE_M), (0.0, 1.0, 0.0, 0.0)
        return ArmModel(arm_table(table), joints, LAST_LINK, place, turn, home=home)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """Return the accepted joint speeds in rad/s, for the caller's answer.

        The arm begins with these speeds and slows down before its target.
        """
        named = {str(key).removesuffix(".pos") for key in action}
        speeds = dict(zip(self.config.axes, values[-self._joints :], strict=True))
        answer: dict[str, Any] = {
            "robot": self.robot,
            "joints": [axis for axis in self.axes if axis in named],
            "joint_speeds": {axis: speed for axis, speed in speeds.items() if axis in named},
        }
        return {**answer, HAND: values[self._joints]} if HAND in named else answer


def _axes(table: Mapping[str, Any], fastest_rad_s: float) -> list[Axis]:
    endless = (-math.inf, math.inf)
    return [
        Axis(key=joint["key"], unit="rad", low=low, high=high, speed=fastest_rad_s, id=number)
        for number, joint in enumerate(table["joints"], 1)
        for low, high in (joint.get("range_rad", endless),)
    ]
