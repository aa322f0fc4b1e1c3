"""Walk Unitree's legged robots by their onboard controller: ``level="sport"``.

Connecting and ``resume()`` move nothing. ``stand_up()`` makes the robot stand up. ``move(vx, vy, wz)`` and
``send_action({"vx": 0.3})`` make it walk for 0.3 s. Repeat them to walk on.

The safe states, and when they are used:

``zero``  velocity zero, and the robot keeps its balance. After a setpoint that expired, or a writer that has ended
``stop``  the robot ends its motion, and its own controller keeps it on its feet. At ``stop()``, and after the end
          of one of our processes
``damp``  every joint brakes, and the robot sinks to the floor (the vendor's emergency stop). At an e-stop
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import meanings, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.drivers.unitree import refusals
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.options import IMU, OF_JOINTS, LegsOptions
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.kernel.messages import Refused

from .dialect import MOVE_S
from .gates import conditions, refuse_joints
from .loco import G1, H1
from .robots import base_of, dialect_of
from .services import services_of, verbs_of
from .sport import B2, GO2


class _Walking(Driver):
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.unitree.walking.wire:WalkingWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.unitree.walking.stop:WalkingStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.unitree.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(LegsOptions)
    SPELLINGS: ClassVar[Mapping[str, str]] = {"interface": "network_interface"}
    SIMULATION: ClassVar[str] = "it is simulated joint by joint. Walk on a twin: transport='twin', level='sport'"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        imu(**IMU),
        Sensor("battery", {"pct": "battery_pct"}),
        Sensor(
            "odom",
            {
                "xyz": "odometry_xyz_m",
                "theta": "odometry_heading_rad",
                "linear": "odometry_linear_m_s",
                "angular": "odometry_angular_rad_s",
            },
            words={"frame": "odom"},
        ),
    )
    BEFORE_MOTION: ClassVar[str] = "stand_up"
    JOINTS_SERVICES: ClassVar[Mapping[str, Service]] = OF_JOINTS
    """Services of the same robot at ``level="low"``."""

    config: UnitreeConfig
    unit = "m/s and rad/s"
    timing = Timing(
        control_hz=50.0,
        keepalive_s=0.1,
        stream_ttl_s=MOVE_S,
        oneshot_ttl_s=MOVE_S,
        state_ttl_s=0.3,
        open_s=16.0,
        handover_s=5.0,
        safe_s=2.0,
    )
    fallbacks: Mapping[Reason, SafeState] = {
        **fallbacks_for(late=SafeState.ZERO, otherwise=SafeState.STOP),
        Reason.ESTOP: SafeState.DAMP,
    }
    firmware_watchdog = (
        "The robot keeps a velocity for 1 s, then it stands by itself (a Go2 with software 1.1.6 or later). With "
        "older software, and on a B2 [assumed], it keeps the velocity for ever. This can be neither armed nor read "
        "back"
    )
    bound_s = 0.05

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        chosen = read_options(robot, LegsOptions, options)
        if chosen.simulator:
            raise ValueError(
                f"{robot}: Unitree's simulator (simulator=True) cannot walk by itself. Leave out level='sport'"
            )
        if chosen.on_exit != "zero_torque":
            raise ValueError(
                f"{robot}: on_exit has a meaning only with level='low'. Leave on_exit out: with level='sport' the "
                "robot stays on its feet after a stop"
            )
        return plain(chosen)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, LegsOptions, self.resolve(robot, options))
        self._model = model = model_of(robot)
        if model.walks is None or model.name not in self.SUPPORTED_ROBOTS:
            raise ValueError(f"{robot} cannot walk by level='sport'. Use one of {', '.join(self.SUPPORTED_ROBOTS)}")
        self.robot = model.name
        dialect = dialect_of(model.walks)
        self.config = UnitreeConfig(model, port, chosen.network_interface, chosen.domain or 0)
        self.declare(base_of(model.walks))
        self.conditions = conditions(dialect, chosen.battery_floor_pct)
        self.gates = (past_range(self.table),)
        self._dialect = dialect

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        return {**cls.JOINTS_SERVICES, **cls.SERVICES}

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        if service in self.JOINTS_SERVICES:
            return refusals.walks_only()
        return super().check_service(service, arguments)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return refuse_joints(self._model, action) or parse_twist(action, self.robot, self.table, self._index, state)

    def readings(self, observation: Observation) -> dict[str, Any]:
        sensors = observation.sensors
        mode, xyz, heading = (
            sensors.get(name) for name in ("sport_mode", "odometry_xyz_m", "odometry_heading_rad")
        )
        pct = sensors.get("battery_pct")
        return {
            "level": "sport",
            "mode": None if mode is None else self._dialect.name(round(mode[0])),
            "pose": None if xyz is None or heading is None else {"xyz": list(xyz), "heading_rad": heading[0]},
            "battery_pct": None if pct is None else pct[0],
        }


class Go2Walking(_Walking):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("unitree_go2",)
    SERVICES: ClassVar[Mapping[str, Service]] = services_of(GO2)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs_of(GO2)


class B2Walking(_Walking):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("b2",)
    SERVICES: ClassVar[Mapping[str, Service]] = services_of(B2)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs_of(B2)


class _Loco(_Walking):
    firmware_watchdog = (
        "Each velocity is sent with its duration of 0.3 s, and the robot ends it by itself, as its vendor states. "
        "This can be neither armed nor read back"
    )


class G1Walking(_Loco):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("unitree_g1",)
    SERVICES: ClassVar[Mapping[str, Service]] = services_of(G1)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs_of(G1)
    JOINTS_SERVICES: ClassVar[Mapping[str, Service]] = {}


class H1Walking(_Loco):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("unitree_h1",)
    SERVICES: ClassVar[Mapping[str, Service]] = services_of(H1)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs_of(H1)
