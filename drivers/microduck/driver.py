"""Declare Pollen Robotics' Microduck. Its own daemon, robotd, is reached by JSON-RPC over a unix socket, on
this machine or through ssh.

The duck walks by its own policy. It accepts intents such as "walk at this speed", and no joint targets. Every
stop leads to the same safe state: the duck stands, its twist is zero, torque stays on, and head, body and mouth
keep their position. A command to walk lasts for its duration, and another may follow. After a stop, commands
are accepted only after ``resume()``. Connecting and ``resume()`` switch no motor on; ``enable()`` does.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import verbs
from .config import USER, MicroduckConfig, endpoint_of_environment, parse_port
from .gates import CONDITIONS, DURATION, MOVES, USUAL_S, all_gates, parse
from .protocol import API_VERSION
from .refusals import INTENTS
from .robots import HEAD, HEAD_AT, MOUTH, OPEN, POSE, POSE_AT, TABLES, TWIST, axes_of, modes_of


class MicroduckOptions(DriverOptions, frozen=True):
    api_version: Annotated[
        int,
        option(
            "version of robotd's protocol that this driver announces; another one of robotd is a warning",
            ge=1,
            le=1000,
        ),
    ] = API_VERSION
    timeout: Annotated[
        float, option("seconds within which robotd must shake hands, and answer one request", gt=0, le=60)
    ] = 5.0
    subscribe_hz: Annotated[
        Annotated[int, msgspec.Meta(ge=10, le=50)] | None,
        option("states a second that robotd is asked for, 10 to 50; None: each tick"),
    ] = None


class Microduck(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    PORT_LIKE: ClassVar[str] = "ssh://192.0.2.10"
    WIRE: ClassVar[str] = "strands_actors.drivers.microduck.wire:MicroduckWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.microduck.stop:MicroduckStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.microduck.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(MicroduckOptions)
    ROLLOUTS: ClassVar[str] = f"it walks with its onboard policy, and robotd takes no joint targets. Use {INTENTS}"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor(
            "odom",
            {
                "xy": "odometry_xy_m",
                "yaw": "odometry_yaw_rad",
                "linear": "odometry_linear_m_s",
                "angular": "odometry_angular_rad_s",
            },
        ),
        Sensor("imu", {"rpy": "rpy_rad", "gyro": "gyro_rad_s", "quaternion": "orientation_wxyz"}),
        Sensor("battery", {"pct": "battery_pct", "voltage": "battery_v"}),
    )
    SERVICES: ClassVar[Mapping[str, Service]] = verbs.SERVICES
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs.tool_verbs()
    BEFORE_MOTION: ClassVar[str] = "enable"

    unit = "m/s (vyaw: rad/s), head, roll and pitch: rad, z: m, open: 0..1"
    timing = Timing(
        control_hz=20.0,
        # So long that no keepalive is sent: ``Wire.feed`` repeats a twist, and no other command may be repeated.
        keepalive_s=3600.0,
        stream_ttl_s=0.3,
        # A single command does not expire: head, body and mouth keep their goals, and a twist has its duration.
        oneshot_ttl_s=None,
        state_ttl_s=0.5,
        safe_s=2.0,
    )
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.ZERO, otherwise=SafeState.STOP)
    firmware_watchdog = (
        "robotd sets the twist to zero 0.5 s after the last one [assumed: it cannot be read back]. Head, body and "
        "mouth keep their last targets, torque stays on, and a skill plays to its end"
    )
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        smuggled = ("endpoint", "user")
        read = read_options(
            robot, MicroduckOptions, {key: value for key, value in options.items() if key not in smuggled}
        )
        endpoint = options.get("endpoint") or endpoint_of_environment(os.environ)
        user = options.get("user") or os.environ.get("DUCK_BOARD_USER") or USER
        try:
            parse_port(endpoint, user)
        except ValueError as error:
            raise ValueError(f"{robot}: MICRODUCK_SOCKET or MICRODUCK_HOST is invalid: {error}") from None
        return {**plain(read), "endpoint": endpoint, "user": user}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = self.resolve(robot, options)
        self.robot = TABLES.canonical(robot)
        table, axes, modes = TABLES.table(robot), axes_of(robot), modes_of(robot)
        self.declare(
            Part(PartKind.BASE, axes[: len(TWIST)]),
            Part(PartKind.HEAD, axes[HEAD_AT]),
            Part(PartKind.LEGS, axes[POSE_AT], "body"),
            Part(PartKind.HEAD, axes[OPEN:], "mouth"),
        )
        timeout_s = float(resolved["timeout"])
        self.config = MicroduckConfig(
            robot=self.robot,
            port=port or resolved["endpoint"],
            user=resolved["user"],
            axes=self.axes,
            ids=self.ids,
            modes=tuple(modes),
            skills=tuple(table["skills"]),
            api_version=resolved["api_version"],
            timeout_s=timeout_s,
            subscribe_hz=resolved["subscribe_hz"],
        )
        timing = type(self).timing
        by_ssh = self.config.port.startswith("ssh://")
        # The root opens its own ssh connection, which takes time, too.
        handover_s = timing.handover_s + (timeout_s if by_ssh else 0.0)
        self.timing = msgspec.structs.replace(timing, handover_s=handover_s, open_s=timeout_s + handover_s + 1.0)
        self.gates = all_gates(self.table, modes, timing.state_ttl_s)
        self._motors, self._slots = tuple(table["ids"]), tuple(table["slots"])
        vars(self)["SERVICES"] = verbs.services_for(timeout_s)

    def check_port(self) -> None:
        parse_port(self.config.port, self.config.user)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.table, self._index, state)

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return the targets from which an action starts. The head starts at robotd's goal, because its
        measured position sags below the goal."""
        row = super().first_target(observation)
        head = observation.sensors.get("head_target_rad") or row[HEAD_AT]
        return (*row[: HEAD_AT.start], *head, *row[HEAD_AT.stop :])

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        return refusal or verbs.check_arguments(service, arguments, self._motors, self.config.modes, self._slots)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the values of a target by axis name, without the flags at its end."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = {str(key).removesuffix(".pos") for key in action}
        intents = {"move": TWIST, "head": HEAD, "pose": POSE, "mouth": MOUTH}
        row = self.as_json(values)
        sent = {name: {key: row[key] for key in keys} for name, keys in intents.items() if named & set(keys)}
        lasts = {DURATION: float(action.get(DURATION, USUAL_S))} if values[MOVES] else {}
        return {"robot": self.robot, "sent": sent, **lasts}
