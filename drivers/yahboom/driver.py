"""Declare the Yahboom ROSMASTER M3 Pro: a mecanum base with an arm of five servos and a gripper,
over rosbridge or ROS 2.

Every stop leads to the same safe state: the base stands, and the arm keeps its last goal. A command
expires after 300 ms, and the firmware of the base stops the wheels by itself after about as long.
After an expired command another may follow. After a stop, commands are accepted only after
``resume()``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Part, PartKind, finite
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.loading import load
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu
from strands_actors.contract.shown import shown
from strands_actors.contract.tool_verbs import DURATION, MOVE_TO, STATUS, STOP, ToolVerb, held_move
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S
from strands_actors.drivers.common.ports.ros2_graph import check_router
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import LINKS, ROS2, ROSBRIDGE, YahboomConfig
from .gates import ARM_MS, DRIVES, TIME, all_gates, parse
from .messages import CMD_VEL
from .robots import ARM_JOINTS, BASE, TABLES, Servo, base_axes, servo_axes, table_of

BY_ROS2 = "transport='ros2'"
_DEGREES = {
    "type": "array",
    "items": {"type": "number"},
    "minItems": ARM_JOINTS + 1,
    "maxItems": ARM_JOINTS + 1,
    "description": "servo angles in degrees: arm1 to arm5, then the gripper (30 closed, 180 open)",
}
_RAD = {"type": "number", "description": "radians"}
_TIME = {TIME: {"type": "number", "description": "milliseconds the motion may take, 1 to 30000"}}
_SET_GRIPPER, _SET_ARM_DEGREES = "set_gripper", "set_arm_degrees"


class YahboomOptions(DriverOptions, frozen=True):
    timeout_s: Annotated[
        float, option("seconds within which rosbridge must answer and odometry must come", gt=0, le=60)
    ] = 5.0
    joint_signs: Annotated[
        tuple[float, ...],
        option("1.0 or -1.0 for each of arm1 to arm5: which way it turns", min_length=5, max_length=5),
    ] = (1.0, 1.0, 1.0, 1.0, 1.0)
    move_time_ms: Annotated[
        int, option("milliseconds of an arm motion, if the action names no time", ge=1, le=30_000)
    ] = 1500
    transport: Annotated[
        Literal["rosbridge", "ros2"],
        option("how the robot's topics are reached: by rosbridge's WebSocket, or as a node of its ROS 2 graph"),
    ] = "rosbridge"
    humble: Annotated[
        bool, option("with transport='ros2': the graph is ROS 2 Humble, which has no type hashes")
    ] = False


class YahboomM3Pro(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    TRANSPORTS: ClassVar[tuple[str, ...]] = (ROSBRIDGE, ROS2, "twin")
    EXPERIMENTAL: ClassVar[Mapping[str, str]] = {
        BY_ROS2: "this was never run on a real robot, only with a node on a graph of rmw_zenoh's wire"
    }
    WIRE: ClassVar[str] = "strands_actors.drivers.yahboom.wire:YahboomWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.yahboom.stop:YahboomStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.yahboom.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(YahboomOptions)
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor(
            "odom",
            {
                "x": "odometry_xy_m[0]",
                "y": "odometry_xy_m[1]",
                "theta": "odometry_yaw_rad",
                "xy": "odometry_xy_m",
                "yaw": "odometry_yaw_rad",
                "linear": "odometry_linear_m_s",
                "angular": "odometry_angular_rad_s",
            },
            words={"frame": "odom"},
        ),
        imu(rpy="rpy_rad", gyro="gyro_rad_s", accel="acceleration_m_s2", quaternion="orientation_wxyz"),
        Sensor("lidar/summary", {"nearest_scan0": "scan0_nearest_m", "nearest_scan1": "scan1_nearest_m"}),
    )
    ROLLOUTS: ClassVar[str] = (
        "this robot cannot run policies, because it does not report its arm's position. "
        "Call send_action() at any rate"
    )
    GUARDED: ClassVar[tuple[str, ...]] = BASE
    TOPICS: ClassVar[Mapping[str, str]] = dict.fromkeys(BASE, CMD_VEL)

    unit = "radians; base: m/s and rad/s"
    timing = Timing(
        control_hz=10.0,
        # Repeat commands, because the firmware stops the base after 200 to 500 ms without one.
        keepalive_s=0.1,
        stream_ttl_s=LIFETIME_S,
        oneshot_ttl_s=LIFETIME_S,
        state_ttl_s=0.5,
        safe_s=2.0,
    )
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.ZERO)
    firmware_watchdog = (
        "The base stops 200 to 500 ms after the last command [assumed: 0.3 s]. This can be neither armed nor read "
        "back. The arm finishes its last motion and holds it"
    )

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        read = read_options(robot, YahboomOptions, options)
        if any(abs(sign) != 1.0 for sign in read.joint_signs):
            raise ValueError(f"{robot}: joint_signs is {read.joint_signs!r}. Give {ARM_JOINTS} of 1.0 or -1.0")
        return plain(read)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        read = read_options(robot, YahboomOptions, self.resolve(robot, options))
        self.robot = TABLES.canonical(robot)
        table = table_of(robot)
        servos = self._servos = table.servos_by(read.joint_signs)
        arm, gripper = servo_axes(servos)[:ARM_JOINTS], servo_axes(servos)[ARM_JOINTS:]
        self.declare(
            Part(PartKind.BASE, base_axes(table)), Part(PartKind.ARM, arm), Part(PartKind.GRIPPER, gripper)
        )
        self.caveats = (self.experimental(BY_ROS2),) if read.transport == ROS2 else ()
        self._time_ms = read.move_time_ms
        self.config = YahboomConfig(
            self.robot, port, read.transport, read.timeout_s, self.axes, self.ids, servos, read.humble
        )
        timing = type(self).timing
        self.timing = msgspec.structs.replace(timing, open_s=read.timeout_s + timing.handover_s + 1.0)
        self.gates = all_gates(self.table, servos, timing.state_ttl_s)
        home = {servo.key: servo.radians(degrees) for servo, degrees in zip(servos, table.home_deg, strict=True)}
        # The home pose is given in servo degrees. Its radians depend on the option ``joint_signs``.
        vars(self)["TOOL_VERBS"] = _verbs(home)

    def check_port(self) -> None:
        if self.config.transport == ROSBRIDGE:
            self.config.address()
        else:
            check_router(self.config.port)

    def preload(self) -> None:
        super().preload()
        load(LINKS[self.config.transport])

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.table, self._index, state, self._time_ms)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the values by axis name, without unknown values. Most of these robots do not
        report the positions of their arm."""
        return {key: value for key, value in super().as_json(values[: len(self.axes)]).items() if value == value}

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        """Translate commands that give servo angles in degrees, as scripts for strands-robots do."""
        servos = self._servos
        timed = {TIME: inputs[TIME]} if TIME in inputs else {}
        if verb.name == _SET_GRIPPER:
            gripper = servos[ARM_JOINTS]
            degrees = gripper.high_deg if inputs["open"] else gripper.low_deg
            return {gripper.key: gripper.radians(degrees), **timed}
        if verb.name == _SET_ARM_DEGREES:
            if refused := _refuse_degrees(servos, inputs["joints"]):
                return refused
            pose = zip(servos, inputs["joints"], strict=True)
            return {**{servo.key: servo.radians(float(degrees)) for servo, degrees in pose}, **timed}
        return super().action_of(verb, inputs)

    def timed(self, targets: Mapping[str, Any], seconds: float, observation: Observation) -> dict[str, Any]:
        return {**targets, TIME: max(1, round(1e3 * seconds))}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        shown_target: dict[str, Any] = {}
        if values[ARM_MS]:
            arm = values[len(BASE) : len(self.axes)]
            shown_target["arm_deg"] = [
                servo.whole_degrees(rad) for servo, rad in zip(self._servos, arm, strict=True)
            ]
            shown_target["time_ms"] = round(values[ARM_MS])
        if values[DRIVES]:
            shown_target["twist"] = dict(zip(BASE, values, strict=False))
        return shown_target


def _refuse_degrees(servos: Sequence[Servo], joints: Sequence[Any]) -> Refused | None:
    """Return a refusal if these are not valid angles in degrees for all servos; None if they are
    valid."""
    ranges = ", ".join(f"{servo.key} {servo.low_deg}..{servo.high_deg}" for servo in servos)
    if len(joints) != len(servos):
        return refusals.wrong_angle_count(len(joints), len(servos), ranges)
    for servo, value in zip(servos, joints, strict=True):
        degrees = finite(value)
        if degrees is None or not servo.low_deg <= degrees <= servo.high_deg:
            range_deg = servo.low_deg, servo.high_deg
            return refusals.past_angle_range(servo.key, shown(value), range_deg, len(servos), ranges)
    return None


def _verbs(home: Mapping[str, float]) -> tuple[ToolVerb, ...]:
    arm = [key for key in home if key != "gripper"]
    speeds = {
        "linear.x": "m/s forward",
        "linear.y": "m/s to the left",
        "angular.z": "rad/s to the left",
    }
    return (
        READ_SENSORS,
        STATUS,
        ToolVerb("arm", "action", "Move the named joints of the arm.", {**dict.fromkeys(arm, _RAD), **_TIME}),
        ToolVerb(
            "gripper",
            "action",
            "Move the gripper: 0 is open, -1.54 closed.",
            {"gripper": _RAD, **_TIME},
            ("gripper",),
        ),
        ToolVerb(
            _SET_GRIPPER,
            "action",
            "Open or close the gripper.",
            {"open": {"type": "boolean", "description": "true opens it, false closes it"}, **_TIME},
            ("open",),
        ),
        ToolVerb(
            _SET_ARM_DEGREES,
            "action",
            "Move all six servos to angles in degrees.",
            {"joints": _DEGREES, **_TIME},
            ("joints",),
        ),
        ToolVerb("home", "action", "Move the arm to its home pose, the gripper open.", _TIME, action=home),
        held_move(
            f"Drive for {DURATION}, or for 0.3 s, then stand. A zero stops at once.",
            speeds,
            dict.fromkeys(BASE, 0.0),
        ),
        MOVE_TO,
        STOP,
    )
