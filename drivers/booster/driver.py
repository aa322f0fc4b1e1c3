"""Declare the Booster T1: its arms, its services, the checks of its commands (gates) and its safe
states.

The driver talks DDS itself, because calls of the vendor's SDK take seconds to fail.

The robot's own controller always balances the legs. ``enable_upper_body()`` gives the arms to this
program, which then commands them joint by joint. ``move(vx, vy, vyaw)`` walks for 0.3 s and then
stops, because the robot would keep its last twist for ever. ``rotate_head(pitch, yaw)`` turns the
head.

    a setpoint is late   the robot stands and holds its arms
    any stop             the robot stands and its own controller gets the arms back
    e-stop               damping mode: the robot sinks to the floor
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec.structs import replace

from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.motor_targets import Parser
from strands_actors.drivers.common.ports.addresses import check_peer
from strands_actors.drivers.common.ports.network_interfaces import NetworkInterface
from strands_actors.kernel.messages import Refused

from .config import CONTROL_HZ, CONTROL_S, LATE_S, TWIST_S, BoosterConfig
from .gates import MODES, STATE_TTL_S, conditions, gates, refuse_arguments, refuse_others
from .protocol import CommandType
from .robots import BASE, TABLES, model_of

_NAME = re.compile("[A-Za-z0-9_]{1,64}")

GOAL_RAD = 0.1
"""Distance below which a joint counts as on its way to its last goal, or as hanging from it by its
weight [assumed]. The next target then starts at that goal. Otherwise the joint would sink a little with
every ``move``."""


class BoosterOptions(DriverOptions, frozen=True):
    domain_id: Annotated[int, option("DDS domain of the robot, 0 to 232", ge=0, le=232)] = 0
    robot_name: Annotated[
        str | None, option("the robot's own name, where it has one: part of its topics; letters, digits, _")
    ] = None
    cmd_type: Annotated[
        Literal["parallel", "serial"], option("order of the ankles' motors in commands and states")
    ] = "parallel"
    network_interface: NetworkInterface = ""


class _Found(BoosterOptions, frozen=True):
    """Options of a T1, with the robot's address that was found on the network."""

    address: str = msgspec.field(default="", name="found")


class BoosterDriver(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    WIRE: ClassVar[str] = "strands_actors.drivers.booster.wire:BoosterWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.booster.stop_channel:BoosterStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.booster.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(BoosterOptions)
    ROLLOUTS: ClassVar[str] = (
        "a T1 runs no policies. Move it by send_action(), up to 100 times a second, after enable_upper_body()"
    )
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor("imu", {"rpy": "rpy_rad", "gyro": "gyro_rad_s", "accel": "acceleration_m_s2"}),
        Sensor("odom", {"xy": "odometry_xy_m", "heading": "odometry_heading_rad"}),
        Sensor("battery", {"pct": "battery_pct", "voltage": "battery_v"}),
    )
    SERVICES: ClassVar[Mapping[str, Service]] = {
        # Each of these services counts as a motion. A target from before the service is therefore not sent again
        # after it.
        "enable_upper_body": Service(
            "hand the arms over to this program; after each stop, and each change of mode, once more. With "
            "on=False as disable_upper_body",
            within_s=2.0,
            arguments={"on": True},
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
        "disable_upper_body": Service(
            "give the arms back to the robot's own controller",
            within_s=2.0,
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
        "move": Service(
            f"walk so fast for {TWIST_S:g} s, m/s and rad/s in the robot's own frame, then stand",
            within_s=2.0,
            arguments=dict.fromkeys(BASE, 0.0),
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
        "rotate_head": Service(
            "turn the head there, radians",
            within_s=2.0,
            arguments={"pitch": 0.0, "yaw": 0.0},
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
        "change_mode": Service(
            f"change to {', '.join(MODES)}; in damping mode the robot sinks to the floor",
            within_s=2.0,
            arguments={"mode": "walking"},
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
    }
    BEFORE_MOTION: ClassVar[str] = "enable_upper_body"

    config: BoosterConfig
    unit = "radians"
    timing = Timing(
        control_hz=CONTROL_HZ,
        # Just below a control period: a setpoint is repeated only if the next one is late.
        keepalive_s=0.9 * CONTROL_S,
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=STATE_TTL_S,
        open_s=16.0,
        handover_s=5.0,
        safe_s=2.0,
    )
    fallbacks: Mapping[Reason, SafeState] = {
        **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP),
        Reason.ESTOP: SafeState.DAMP,
    }
    firmware_watchdog = (
        "The firmware has no watchdog that can be armed: the robot holds its arms and keeps its last twist, so it "
        "walks on"
    )
    bound_s = 0.1
    """From a death to the safe frame. The base stops first, and is asked whether it has."""

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        chosen = read_options(robot, BoosterOptions, options)
        if chosen.robot_name is not None and not _NAME.fullmatch(chosen.robot_name):
            raise ValueError(f"{robot}: robot_name is {chosen.robot_name!r}. Give 1 to 64 letters, digits or _")
        return plain(chosen)

    @classmethod
    async def complete(cls, robot: str, port: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Find the robot on the network if no port was given. All processes then use the same
        address."""
        chosen = read_options(robot, _Found, options)
        if port or chosen.address:
            return dict(options)
        from .discovery import find_robot

        address = await find_robot(chosen.domain_id, chosen.network_interface, chosen.robot_name or "")
        return {**options, "found": address}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, _Found, options)
        self._model = model = model_of(robot)
        self.robot = model.name
        self.config = BoosterConfig(
            model=model,
            host=port or chosen.address,
            interface=chosen.network_interface,
            domain=chosen.domain_id,
            name=chosen.robot_name or "",
            command_type=CommandType[chosen.cmd_type.upper()],
        )
        self.declare(Part(PartKind.ARM, model.table[:4], "left"), Part(PartKind.ARM, model.table[4:], "right"))
        self.conditions = conditions()
        self.gates = gates(model)
        self._parser = Parser(model)

    def check_port(self) -> None:
        # Without a configured address, the robot is searched for on the network. There is no address to check
        # then.
        if self.config.host:
            check_peer(self.config.host)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Parse an action into a target for all arm joints. A joint that the action does not name
        keeps its last goal. If it has no goal in force, it gets its position in ``first_target``."""
        observation = replace(state.observation, position=self.first_target(state.observation))
        return refuse_others(self._model, action) or self._parser.parse(
            action, replace(state, observation=observation)
        )

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return for each arm joint its last goal if it is within ``GOAL_RAD`` of the measured
        position, else that position."""
        goal = observation.sensors.get("goal_rad", (math.nan,) * len(self.axes))
        return tuple(
            goal_rad if abs(goal_rad - position) <= GOAL_RAD else position
            for goal_rad, position in zip(goal, observation.position, strict=True)
        )

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        return super().check_service(service, arguments) or refuse_arguments(self._model, service, arguments)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the joint positions of a target by joint name. The target's velocities, torques
        and gains are left out."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = self._parser.named(action)
        return {
            "robot": self.robot,
            "joints": [self.axes[index] for index in named],
            "slots": [self.ids[index] for index in named],
            "targets": {self.axes[index]: values[index] for index in named},
            "unit": self.unit,
        }
