"""Drive a Rainbow Robotics RB-Y1, model A: torso, two arms and head, through its gRPC server. No
SDK.

In every safe state but ``off`` the robot holds its position: ``CancelControl`` ends the motion, and
the robot's controller holds the arms where they are. If a command is late, the robot holds until
the next command. After a stop, commands are accepted only after ``resume()``. The power stays on,
except with ``on_estop="power_off"``: an e-stop then removes it (``off``), which drops the arms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract import tool_verbs
from strands_actors.contract.driver import Driver, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor

from .config import LATE_S, RBY1Config
from .gates import CONDITIONS, all_gates
from .robots import TABLES, parts_of

HOLD_S = 0.3
"""How long the controller holds a target that is not repeated. The vendor's examples use 1 s and
more; the shortest time that a robot accepts was never tried on a real one."""


class Options(DriverOptions, frozen=True):
    control_frequency: Annotated[
        float,
        option("targets a second, 10 to 100; a joint may step as far as it turns in one period", ge=10, le=100),
    ] = 50.0
    priority: Annotated[
        int, option("of our commands: of two programs the robot obeys the higher one, 1 to 100", ge=1, le=100)
    ] = 1
    on_estop: Annotated[
        Literal["stop", "power_off"],
        option("what an e-stop does: hold the robot, or take the motors' power, which drops the arms"),
    ] = "stop"


class RBY1(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.rby1.wire:RBY1Wire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.rby1.stop_channel:RBY1StopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.rby1.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor("battery", {"pct": "battery_pct", "voltage": "battery_v"}),
        Sensor("odom", {"xy": "odometry_xy_m", "heading": "odometry_heading_rad"}),
    )
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "reset_fault_control_manager": Service(
            "Clear a fault of the control manager, once its cause is gone. Nothing moves before resume().", 3.0
        )
    }
    TOOL_VERBS: ClassVar[tuple[tool_verbs.ToolVerb, ...]] = (
        tool_verbs.SENSORS,
        tool_verbs.STATE,
        tool_verbs.STATUS,
        tool_verbs.MOVE_TO,
        tool_verbs.STOP,
    )
    GUARDED: ClassVar[tuple[str, ...]] = (tool_verbs.MOVE_TO.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)

    config: RBY1Config
    unit = "radians"
    firmware_watchdog = (
        f"control_hold_time, {HOLD_S * 1e3:g} ms in every command: without another command for this time, or "
        "without its stream, the controller ends the command and holds the robot where it is. No register reports "
        "whether it is armed"
    )
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, Options, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        period_s = 1.0 / chosen.control_frequency
        self.robot = TABLES.canonical(robot)
        self.declare(*parts_of(TABLES.table(robot)))
        self.timing = Timing(
            control_hz=chosen.control_frequency,
            keepalive_s=HOLD_S / 3,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.15,
            arm_s=20.0,
            late_s=LATE_S,
            safe_s=3.0,
        )
        self.fallbacks: Mapping[Reason, SafeState] = {
            **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP),
            Reason.ESTOP: SafeState.OFF if chosen.on_estop == "power_off" else SafeState.STOP,
        }
        self.config = RBY1Config(
            robot=self.robot,
            port=port,
            axes=self.axes,
            ids=self.ids,
            priority=chosen.priority,
            period_s=period_s,
            hold_s=HOLD_S,
            silent_s=0.3,
        )
        self.gates = all_gates(self.table, self.timing.state_ttl_s, period_s)

    def link_rows(self) -> str:
        return str(TABLES.table(self.robot)["model_rows"])

    def check_port(self) -> None:
        self.config.address()

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"robot": self.robot, "joints": {axis: target[axis] for axis in self.axes if axis in named}}
