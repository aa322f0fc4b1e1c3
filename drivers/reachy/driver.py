"""Drive a Pollen Robotics Reachy Mini, Lite or Wireless, through the REST and WebSocket service of its daemon.

Every stop except an e-stop makes the robot hold. This ends the running move of any client, face tracking and
wobbling, and the motors hold the head where it is. An e-stop removes the torque: the head drops.

Small steps are sent as targets, larger ones as moves with a duration, so that the robot never jumps. Connecting
and ``resume()`` neither move the robot nor give torque. ``motors(mode="enabled")`` gives torque.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu, pose
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import verbs
from .config import ReachyConfig, parse_speech_url
from .gates import CONDITIONS, DURATION, LOOK, all_gates, parse
from .protocol import API_PORT, BODY, MEDIA_PORT
from .robots import TABLES, axes_of

PLACES = ("localhost", "reachy-mini.local")
"""Addresses to try for a daemon when neither ``port`` nor ``REACHY_HOST`` is given."""


class ReachyOptions(DriverOptions, frozen=True):
    api_port: Annotated[
        int, option("port of the daemon's service, where the address names none", ge=1, le=65535)
    ] = API_PORT
    media_port: Annotated[int, option("port at which camera and microphone are streamed", ge=1, le=65535)] = (
        MEDIA_PORT
    )
    tts_url: Annotated[
        str | None,
        option("http address of a service that makes a WAV file of a text, for say()"),
    ] = None


class Reachy(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    WIRE: ClassVar[str] = "strands_actors.drivers.reachy.wire:ReachyWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.reachy.stop:ReachyStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.reachy.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(ReachyOptions)
    ROLLOUTS: ClassVar[str] = "its daemon plays moves by itself and takes no stream of a policy"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        imu(
            rpy="imu_rpy_rad",
            gyro="gyroscope_rad_s",
            accel="accelerometer_m_s2",
            quaternion="quaternion_wxyz",
            orientation="quaternion_wxyz",
        ),
        pose("head_xyz_m", rpy="head_rpy_rad", frame="base", quat="quaternion_wxyz"),
        Sensor("battery", {"pct": "battery_pct"}),
    )
    CAMERAS: ClassVar[Mapping[str, str]] = {"head": "strands_actors.drivers.reachy.cameras:open_camera"}
    SERVICES: ClassVar[Mapping[str, Service]] = verbs.SERVICES
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = verbs.TOOL_VERBS

    unit = "degrees (head_x, head_y, head_z: millimetres)"
    timing = Timing(
        control_hz=50.0,
        # So long that no keepalive is sent: the daemon keeps its last target, and a move that is sent again begins
        # anew.
        keepalive_s=3600.0,
        stream_ttl_s=0.3,
        oneshot_ttl_s=None,
        state_ttl_s=0.5,
        call_s=0.8,
        open_s=13.0,  # 10 s of these are for reading the daemon's status
        safe_s=2.0,
    )
    fallbacks: Mapping[Reason, SafeState] = {
        **dict.fromkeys(Reason, SafeState.HOLD),
        Reason.ESTOP: SafeState.LIMP,
    }
    firmware_watchdog = (
        "The firmware has no watchdog: the daemon ends the move that it plays (10 s at most of ours), and holds "
        "the last target with torque on. Face tracking goes on"
    )
    # A WebSocket needs two round trips, and the computer on which the daemon runs is slow [assumed].
    bound_s = 0.2
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        own_options = {name: value for name, value in options.items() if name != "places"}
        read = read_options(robot, ReachyOptions, own_options)
        if read.tts_url is not None:
            try:
                parse_speech_url(read.tts_url)
            except ValueError as error:
                raise ValueError(f"{robot}: {error}") from None
        host, number = os.environ.get("REACHY_HOST", ""), os.environ.get("REACHY_PORT", "")
        if number and not number.isdecimal():
            raise ValueError(f"{robot}: REACHY_PORT is {number!r}. Give a port number")
        hosts = (host,) if host else PLACES
        places = [
            f"[{entry}]:{number or read.api_port}" if ":" in entry else f"{entry}:{number or read.api_port}"
            for entry in hosts
        ]
        return {**plain(read), "places": options.get("places", places)}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = self.resolve(robot, options)
        self.robot = TABLES.canonical(robot)
        axes, yaw_deg = axes_of(robot), float(TABLES.table(robot)["yaw_deg"])
        self.declare(
            Part(PartKind.HEAD, axes[:BODY]),
            Part(PartKind.BASE, axes[BODY : BODY + 1]),
            Part(PartKind.HEAD, axes[BODY + 1 :], "antennas"),
        )
        self.config = ReachyConfig(
            robot=self.robot,
            port=port,
            places=tuple(resolved["places"]),
            axes=self.axes,
            ids=self.ids,
            yaw_deg=yaw_deg,
            api_port=resolved["api_port"],
            media_port=resolved["media_port"],
            tts_url=resolved["tts_url"] or "",
        )
        self.gates = all_gates(self.table, self.timing.state_ttl_s, yaw_deg)

    def check_port(self) -> None:
        self.config.addresses()

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        return verbs.plain_goto(inputs) if verb.name == "goto" else super().action_of(verb, inputs)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.table, self._index, state)

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        return refusal or verbs.check_arguments(service, arguments, self.config.tts_url)

    def timed(self, targets: Mapping[str, Any], seconds: float, observation: Observation) -> dict[str, Any]:
        return {**targets, DURATION: seconds}

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the values of a target by axis name, without the duration of the move at its end."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = {str(key).removesuffix(".pos") for key in action}
        if named & set(LOOK):
            named |= {"head_pitch", "head_yaw"}
        sent = {key: value for key, value in self.as_json(values).items() if key in named}
        return {"sent": {**sent, "duration": round(values[len(self.axes)], 3)}, "robot": self.robot}

    def model_units(self) -> tuple[tuple[float, float], ...]:
        degree, millimetre = 57.29577951308232, 1e3
        return tuple((0.0, millimetre if axis.unit == "mm" else degree) for axis in self.table)
