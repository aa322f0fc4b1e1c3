"""Declare a robot that is a node of a ROS 2 graph.

It is an arm with ``joint_states`` and ``follow_joint_trajectory``, a base with ``odom`` and ``cmd_vel``, or both.

The user's table has its topics, joints and limits. The node keeps its motors energised by itself, so no stop takes
power away: an arm holds its position, and a base stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.tool_verbs import MOVE_TO, STATUS, STOP, ToolVerb
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S, parse_twist
from strands_actors.drivers.common.ports.ros2_graph import check_router
from strands_actors.kernel.messages import Refused

from .config import Ros2Config
from .gates import LEAD_S, all_gates
from .table import BASE, Table, read_table

ODOMETRY = Sensor(
    "odom",
    {
        "xy": "odometry_xy_m",
        "x": "odometry_xy_m[0]",
        "y": "odometry_xy_m[1]",
        "yaw": "odometry_yaw_rad",
        "theta": "odometry_yaw_rad",
        "linear": "odometry_linear_m_s",
        "angular": "odometry_angular_rad_s",
    },
    words={"frame": "odom"},
)


class Ros2Options(DriverOptions, frozen=True):
    table: Annotated[dict[str, Any], option("the robot's topics, joints and limits, or a TOML file with them")] = (
        msgspec.field(default_factory=dict)
    )
    domain: Annotated[int, option("the ROS domain", ge=0, le=232)] = 0
    humble: Annotated[bool, option("the graph is ROS 2 Humble, which has no type hashes")] = False
    timeout_s: Annotated[float, option("seconds within which the node must appear and report", gt=0, le=60)] = 5.0


class Ros2Driver(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ()
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    PORT_LIKE: ClassVar[str] = "tcp/192.0.2.10:7447"
    DISTINGUISHED_BY: ClassVar[tuple[str, ...]] = ("domain", "table")
    TRANSPORTS: ClassVar[tuple[str, ...]] = ()
    WIRE: ClassVar[str] = "strands_actors.drivers.ros2.wire:Ros2Wire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.ros2.stop:Ros2StopChannel"
    SIMULATION: ClassVar[str] = "a node of a ROS 2 graph has its own simulation. Start that, and use mode='real'"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Ros2Options)
    SENSORS: ClassVar[tuple[Sensor, ...]] = (ODOMETRY,)
    GUARDED: ClassVar[tuple[str, ...]] = BASE
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (READ_SENSORS, STATUS, MOVE_TO, STOP)

    unit = "radians, metres; base: m/s and rad/s"

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        try:
            table = read_table(options.get("table"))
        except ValueError as error:
            raise ValueError(f"{robot}: {error}") from None
        return plain(read_options(robot, Ros2Options, {**options, "table": table}))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        read = read_options(robot, Ros2Options, options)
        table = msgspec.convert(read.table, Table)
        self.robot = robot
        base = tuple(
            Axis(
                key=key,
                unit="rad/s" if key == "angular.z" else "m/s",
                low=-table.base[key],  # type: ignore[index]  # a key of BASE
                high=table.base[key],  # type: ignore[index]
                mode=AxisMode.VELOCITY,
                id=number,
            )
            for number, key in enumerate(table.base_keys, 1)
        )
        joints = tuple(
            Axis(key=key, unit=row.unit, low=row.low, high=row.high, speed=row.speed, id=number)
            for number, (key, row) in enumerate(table.joints.items(), len(base) + 1)
        )
        parts = ((PartKind.BASE, base), (PartKind.ARM, joints))
        self.declare(*(Part(kind, axes) for kind, axes in parts if axes))
        self.config = Ros2Config(robot, port, read.domain, read.humble, read.timeout_s, self.axes, self.ids, table)
        timing = Timing(
            control_hz=20.0,
            keepalive_s=0.1,
            stream_ttl_s=LIFETIME_S,
            oneshot_ttl_s=LIFETIME_S if base else None,
            state_ttl_s=0.5,
            safe_s=2.0,
        )
        self.timing = msgspec.structs.replace(timing, open_s=read.timeout_s + timing.handover_s + 1.0)
        stopped = SafeState.ZERO if base else SafeState.STOP
        self.fallbacks = fallbacks_for(late=SafeState.HOLD if joints else stopped, otherwise=stopped)
        self.gates = all_gates(self.table, timing.state_ttl_s)
        self.firmware_watchdog = _watchdog(table)
        self.caveats = (
            f"{robot} is a node of a ROS 2 graph, which this package does not control. {self.firmware_watchdog}. "
            "Other nodes may command it at any time, and a stop passes the graph's router",
        )

    def check_port(self) -> None:
        check_router(self.config.port)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse_twist(action, self.robot, self.table, self._index, state)


def _watchdog(table: Table) -> str:
    """Return what stops the robot when all processes of this package have ended."""
    texts = []
    if table.base and table.node_timeout_s is None:
        texts.append("Whether its node stops the base without twists is not known")
    elif table.base:
        texts.append(
            f"Only its node stops the base, by its table {table.node_timeout_s:g} s after the last twist (untested)"
        )
    if table.joints:
        texts.append(f"The node carries out the last goal of the arm, which takes at most {LEAD_S:g} s, and holds")
    return ". ".join(texts)
