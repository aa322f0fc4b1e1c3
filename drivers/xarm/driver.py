"""Drive a UFACTORY xArm 7 through the controller's own TCP protocol, without the vendor's SDK.

If the writer is late, the arm holds: it gets its last target again and stays in servo mode. For every other reason
the arm is stopped (state 4). In that state the controller keeps the arm in its position, drops its targets and
accepts no new ones. ``resume()`` sets up servo mode again. Brakes and power do not change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATE, STATUS, STOP, ToolVerb
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.hand import FORCE, MODEL_UNITS, HandKeys, hand_axis
from strands_actors.drivers.common.kit.hand_gates import gates_with_hand
from strands_actors.drivers.common.kit.hand_verbs import HAND_VERBS
from strands_actors.drivers.common.kit.refusals import no_hand_setting
from strands_actors.kernel.messages import Refused

from .arms import AXES, TABLES, arm_of, axes_of, mirrored, model_table
from .config import LATE_S, XArmConfig
from .gates import CONDITIONS, all_gates
from .grippers import FLANGE, HAND_ID, LINK, TOOL_M, TOP_PERCENT_S, Gripper


class XArmOptions(DriverOptions, frozen=True):
    control_frequency: Annotated[
        float,
        option("setpoints a second, 10 to 250; a joint may step as far as it turns in one period", ge=10, le=250),
    ] = 100.0
    gripper: Annotated[
        Gripper | None,
        option("the vendor's gripper on the flange, one more axis; xarm_vacuum takes below 50 % as on; None: none"),
    ] = None
    gripper_speed: Annotated[
        float, option("of an action that names none, 0 slowest to 100 fastest, in percent", ge=0, le=100)
    ] = 100.0


class XArm(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.xarm.wire:XArmWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.xarm.stop_channel:XArmStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.xarm.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (pose("tcp_xyz_m", rpy="tcp_rpy_rad", frame="base"),)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(XArmOptions)
    TORQUES: ClassVar[str] = "torque_nm"
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("gripper",)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (READ_SENSORS, STATE, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)

    config: XArmConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    firmware_watchdog = (
        "The firmware has no watchdog: in servo mode the controller drives to the last target at full speed and "
        "holds it"
    )
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, XArmOptions, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        read = read_options(robot, XArmOptions, options)
        hz = read.control_frequency
        self.robot = TABLES.canonical(robot)
        self.arm = arm_of(robot)
        self.gripper: str = read.gripper or ""
        self.config = XArmConfig(self.robot, port, self.arm, gripper=self.gripper)
        parts = [Part(PartKind.ARM, axes_of(self.arm))]
        if self.gripper:
            parts.append(Part(PartKind.GRIPPER, (hand_axis(HAND_ID, TOP_PERCENT_S[self.gripper]),)))
        self.declare(*parts)
        if self.gripper:
            vars(self)["TOOL_VERBS"] = (*HAND_VERBS, *self.TOOL_VERBS)
        self._hand = HandKeys(self.robot, self.table, speed=read.gripper_speed) if self.gripper else None
        self.timing = Timing(
            control_hz=hz,
            # Re-sending is not required. It repeats a target that the controller has missed.
            keepalive_s=0.1,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.1,
            arm_s=10.0,
            late_s=LATE_S,
            tick_s=min(0.01, 1 / hz),
        )
        arm_gates = all_gates(self.arm, axes_of(self.arm), 1 / hz, self.timing.state_ttl_s)
        self.gates = gates_with_hand(arm_gates, self.table) if self.gripper else arm_gates

    def link_rows(self) -> str:
        return str(model_table(self.robot, arm_of(self.robot).usual)["model_rows"])

    def model_units(self) -> tuple[tuple[float, float], ...]:
        units = super().model_units()
        return (*units[:-1], MODEL_UNITS) if self.gripper else units

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        if self._hand is None:
            return super().parse(action, state)
        if FORCE in action:
            return no_hand_setting(FORCE)
        return self._hand.parse(action, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return super().as_json(values[: len(self.axes)])

    def check_port(self) -> None:
        self.config.address()

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        low, high = sensors.get("range_low_rad", ()), sensors.get("range_high_rad", ())
        reported = tuple(zip(low, high, strict=True))
        arm_type = self.arm.type_of_ranges(reported) if reported else self.arm.usual
        home = mirrored(arm_type, self.arm.home_rad)
        table = arm_table(model_table(self.robot, arm_type, self.gripper))
        link, tool = (LINK, (0.0, 0.0, TOOL_M[self.gripper])) if self.gripper else (FLANGE, (0.0, 0.0, 0.0))
        return ArmModel(table, AXES, link, tool, home=home, ranges=reported or arm_type.range_rad)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"robot": self.robot, "joints": {axis: target[axis] for axis in self.axes if axis in named}}
