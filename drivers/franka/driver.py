"""Drive Franka arms through FCI: panda (FER, FCI version 5), fr3 and fr3_v2 (FCI version 10).

A command names a target for all seven joints. A trajectory generator moves the arm to this target. It uses at most
the share ``speed_factor`` of the arm's speed, acceleration and jerk. Between motions nothing is sent, and the
controller holds the arm. After any fault the driver sends StopMove: the controller brakes the arm and holds it. The
joints are never without torque. With the option ``gripper`` the Franka Hand is one more axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATUS, STOP, ToolVerb
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.kit.hand import FORCE, FULL, MODEL_UNITS, HandKeys, hand_axis
from strands_actors.drivers.common.kit.hand_gates import gates_with_hand
from strands_actors.drivers.common.kit.hand_verbs import HAND_VERBS
from strands_actors.kernel.messages import Refused

from . import refusals
from .arms import FLANGE_M, HOME_RAD, JOINTS, arm_of, arms, model_table
from .config import FrankaConfig
from .gates import CONDITIONS, all_gates
from .generator import limits_of
from .grippers import HAND_ID, LAST_LINK, LINK, TOOL_M, TOP_PERCENT_S, Gripper, table_of
from .protocol import MISSED_TICKS, STATE_HZ


class Options(DriverOptions, frozen=True):
    speed_factor: Annotated[
        float, option("share of the arm's speed, acceleration and jerk that a motion may use", gt=0, le=1)
    ] = 0.2
    stream_rate_hz: Annotated[
        float,
        option("how many of the 1000 states a second are taken over, rounded to a whole stride", ge=10, le=200),
    ] = 30.0
    gripper: Annotated[
        Gripper | None, option("the Franka Hand on the flange, as one more axis in percent open; None: no hand")
    ] = None
    gripper_speed: Annotated[float, option("of an action that names none, 0 to 100 percent", ge=0, le=100)] = FULL
    gripper_force: Annotated[
        float, option("of a closing to 0 % that names none, 0 to 100 percent", ge=0, le=100)
    ] = FULL


OF_HAND: Mapping[str, Service] = {
    "home_gripper": Service(
        "let the hand close and open, to measure its stroke after its fingers were changed",
        within_s=10.0,
        moves=True,
    )
}
"""Further services of an arm with a hand."""


class Franka(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(arms())
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.franka.wire:FrankaWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.franka.stop_channel:FrankaStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.franka.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (pose("flange_m", frame="base"),)
    TORQUES: ClassVar[str] = "effort_nm"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (READ_SENSORS, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("gripper",)
    WHOLE_ACTIONS: ClassVar[bool] = True
    ROLLOUTS: ClassVar[str] = (
        "a Franka arm is moved by send_action: each target is a separate motion, planned from the arm's position"
    )
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "recover": Service("let the controller clear a reflex, so that the arm may be armed again", within_s=5.0)
    }

    config: FrankaConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    firmware_watchdog = (
        f"The watchdog is always on: after {MISSED_TICKS} ms of a motion without a command the controller stops "
        "the arm by itself (communication_constraints_violation) and holds it. If its client's connection ends, it "
        "does so at once. The sensor success_rate shows the share of commands that arrive"
    )
    bound_s = 0.1
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, Options, options))

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        return {**cls.SERVICES, **OF_HAND} if options.get("gripper") else cls.SERVICES

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        self.robot = robot
        self.arm = arm_of(robot)
        self.limits = limits_of(self.arm, chosen.speed_factor)
        stride = round(STATE_HZ / chosen.stream_rate_hz)
        self.timing = Timing(
            control_hz=STATE_HZ / stride,
            keepalive_s=0.05,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.15,
            safe_s=2.0,
            silent_s=0.5,  # The start of the 1 kHz process (``cycle``) blocks the wire process for a while.
        )
        self.config = FrankaConfig(
            self.robot,
            port,
            self.arm,
            self.limits,
            stride,
            chosen.speed_factor,
            self.timing.state_ttl_s,
            chosen.gripper or "",
        )
        rows = zip(self.arm.keys, self.limits.low, self.limits.high, self.limits.speed, strict=True)
        axes = tuple(
            Axis(key=key, unit="rad", low=low, high=high, speed=speed, id=number)
            for number, (key, low, high, speed) in enumerate(rows, 1)
        )
        self.gates = all_gates(axes, self.timing.state_ttl_s)
        self._hand: HandKeys | None = None
        if not chosen.gripper:
            self.declare(Part(PartKind.ARM, axes))
            return
        self.declare(Part(PartKind.ARM, axes), Part(PartKind.GRIPPER, (hand_axis(HAND_ID, TOP_PERCENT_S),)))
        self.unit = "radians (gripper: percent open)"
        vars(self)["TOOL_VERBS"] = (*HAND_VERBS, *self.TOOL_VERBS)
        vars(self)["SERVICES"] = self.services(options)
        self._hand = HandKeys(self.robot, self.table, chosen.gripper_speed, chosen.gripper_force)
        self.gates = gates_with_hand(self.gates, self.table)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        if self._hand is None:
            return super().parse(action, state)
        opening = action.get(HAND, action.get(f"{HAND}.pos"))
        if FORCE in action and opening is not None and opening != 0:
            return refusals.no_force(FORCE, opening)
        return self._hand.parse(action, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return super().as_json(values[: len(self.axes)])

    def model_units(self) -> tuple[tuple[float, float], ...]:
        units = super().model_units()
        return units if self._hand is None else (*units[:JOINTS], MODEL_UNITS)

    def link_rows(self) -> str:
        return str(model_table(self.arm)["model_rows"])

    def check_port(self) -> None:
        _ = self.config.host

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        table, joints = arm_table(table_of(self.arm, self.config.gripper)), self.axes[:JOINTS]
        if self.config.gripper:
            return ArmModel(table, joints, LINK, (0.0, 0.0, TOOL_M), home=HOME_RAD)
        return ArmModel(table, joints, LAST_LINK, (0.0, 0.0, FLANGE_M), home=HOME_RAD)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = {str(key).removesuffix(".pos") for key in action}
        targets = {axis: value for axis, value in self.as_json(values).items() if axis in named}
        return {
            "robot": self.robot,
            "joints": list(targets),
            "targets": targets,
            "speed_factor": self.config.speed_factor,
        }
