"""Universal Robots e-Series and UR-Series arms, through ur-rtde.

Safe, for a late writer, is to hold: servoing ends, the control script stays and is fed. For everything else the
arm is stopped and its program ended; the controller holds the arm without it. The power stays on: taking it off
is the pendant's, or the e-stop's on the wall.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from strands_actors.contract.driver import (
    HOLDING_REASONS,
    Candidate,
    Driver,
    GateState,
    Reason,
    StopChannel,
    Timing,
)
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.tool_verbs import STATE, STATUS, STOP, ToolVerb
from strands_actors.drivers.common.tcp_port import parse_address
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from .arms import JOINTS, arm_of, arms
from .gates import CONDITIONS, CONTROL_HZ, CONTROL_S, LOOKAHEAD_S, WATCHDOG_HZ, all_gates, parse
from .protocol import RTDE_PORT

if TYPE_CHECKING:
    from .wire import URWire


class UROptions(DriverOptions, frozen=True):
    control_frequency: Annotated[
        float,
        option(
            "commands a second of the script, 10 to 500; each may step as far as the joint turns in one period",
            ge=1 / LOOKAHEAD_S,
            le=500,
        ),
    ] = CONTROL_HZ
    model: Annotated[str | None, option("the robot's own name, to be sure that it is the arm that was meant")] = (
        None
    )


class UR(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(arms())
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = "strands_actors.drivers.ur.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (Sensor("pose", {"tcp_pose": "tcp_pose_m_rad"}),)
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, STOP)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(UROptions)

    axes = JOINTS
    ids = tuple(range(len(JOINTS)))
    unit = "radians"
    timing = Timing(
        control_hz=CONTROL_HZ,
        keepalive_s=CONTROL_S,
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
        arm_s=5.0,  # a real controller takes a second or two to start a program
        silent_s=1.0,  # ur-rtde's constructors keep the lock: 10 ms here, network and load come on top
    )
    fallbacks: Mapping[Reason, str] = {reason: "hold" if reason in HOLDING_REASONS else "stop" for reason in Reason}
    firmware_watchdog = (
        f"rtde_set_watchdog, {WATCHDOG_HZ:g} Hz: armed in the control script whenever the robot is armed; "
        f"{1e3 / WATCHDOG_HZ:g} ms without a word from the wire process and the controller stops the program. "
        "no register tells: whether it is armed is sensor watchdog_hz"
    )
    bound_s = 0.1
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        read = read_options(robot, UROptions, options)
        if read.model is not None and read.model.lower() != robot:
            raise ValueError(
                f"{robot}: model is {read.model!r}. Use Robot({read.model.lower()!r}), or leave it out"
            )
        return plain(read)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.period_s = 1 / self.resolve(robot, options)["control_frequency"]
        self.robot = robot
        self.port = port
        self.arm = arm_of(robot)
        self.gates = all_gates(self.arm, self.timing.state_ttl_s, self.period_s)

    @property
    def host(self) -> str:
        """Raise ``ValueError`` for a ``port`` that is no address, or names a port: those are fixed."""
        host, port = parse_address(self.port, RTDE_PORT)
        if port != RTDE_PORT:
            raise ValueError(f"port is {self.port!r}. Give the controller's address alone: its ports are fixed")
        return host

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, state)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {
            "robot": self.robot,
            "joints": [joint for joint in JOINTS if joint in named],
            "targets": {joint: target[joint] for joint in JOINTS if joint in named},
            "control_period": self.period_s,
        }

    def open_wire(self, clock: Clock) -> URWire:
        from .wire import URWire

        return URWire(self, clock)

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        from .plain import PlainPath

        return PlainPath(self.host)
