"""Drive Universal Robots e-Series and UR-Series arms, by ur-rtde or by our own control script.

If a program sends its next command too late, the robot holds: the servo motion ends, but the control script keeps
running, and its watchdog is still fed. After any other fault the arm is stopped and the control script ends. The
controller then holds the arm by itself. The arm's power stays on. Only the pendant or the e-stop switches it off.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Driver, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.loading import load
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATE, STATUS, STOP, ToolVerb
from strands_actors.contract.wire import Observation

from .arms import TABLES, Gripper, arm_of
from .config import ControlMethod, URConfig
from .gates import CONDITIONS, CONTROL_HZ, CONTROL_S, LOOKAHEAD_S, START_S, WATCHDOG_HZ, all_gates
from .protocol import RobotMode, SafetyMode, mode_name


class UROptions(DriverOptions, frozen=True):
    control_frequency: Annotated[
        float,
        option(
            "commands a second of the script, 10 to 500; each may step as far as the joint turns in one period",
            ge=1 / LOOKAHEAD_S,
            le=500,
        ),
    ] = CONTROL_HZ
    rtde_frequency: Annotated[
        Annotated[float, Meta(ge=25, le=500)] | None,
        option(
            "samples and registers a second that are exchanged with the controller, 25 to 500, for one that serves "
            "other RTDE clients too; None: 125 and 500"
        ),
    ] = None
    control: Annotated[
        ControlMethod | None,
        option(
            "how it is commanded: by ur-rtde, or by our own control script without it; None: by ur-rtde "
            "where that is installed"
        ),
    ] = None
    gripper: Annotated[
        Gripper | None,
        option(
            "the gripper on the flange, a robot of its own: poses are those of the point between its fingers, its "
            "links count in the tests of contacts, and a simulated arm has it, too; None: no gripper"
        ),
    ] = None
    model: Annotated[str | None, option("the robot's own name, to be sure that it is the arm that was meant")] = (
        None
    )


class UR(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.ur.wire:URWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.ur.stop_channel:URStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.ur.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        pose("tcp_pose_m_rad", frame="base", tcp_pose="tcp_pose_m_rad"),
        Sensor("wrench", {"wrench": "wrench_n_nm"}, words={"frame": "base"}),
    )
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(UROptions)
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("gripper",)

    unit = "radians"
    timing = Timing(
        control_hz=CONTROL_HZ,
        keepalive_s=CONTROL_S,
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
        arm_s=5.0,  # A real controller takes a second or two to start a program.
        # If the wire process ends during an upload, the script may still be in a buffer or in the network. The
        # dashboard's "stop" ends only a program that has already started. After START_S the script has started, or
        # it never will.
        late_s=START_S,
        silent_s=1.0,  # ur-rtde's constructors block the process: for 10 ms here, longer on a slow network.
    )
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    firmware_watchdog = (
        f"rtde_set_watchdog, {WATCHDOG_HZ:g} Hz: armed in the control script whenever the robot is armed; "
        f"{1e3 / WATCHDOG_HZ:g} ms after the last message of the wire process the controller stops the program. "
        "No register reports this: the sensor watchdog_hz shows whether it is armed"
    )
    bound_s = 0.1
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        read = read_options(robot, UROptions, options)
        if read.model is not None and read.model.lower() != robot:
            requested = read.model.lower()
            remedy = f"Use Robot({requested!r})" if requested in cls.SUPPORTED_ROBOTS else f"Give {robot!r}"
            raise ValueError(
                f"{robot}: model is {read.model!r}. {remedy}, or leave model out. "
                f"Models are {', '.join(cls.SUPPORTED_ROBOTS)}"
            )
        return plain(read)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        read = self.resolve(robot, options)
        self.period_s = 1 / read["control_frequency"]
        self._gripper: str = read["gripper"] or ""
        self.robot = TABLES.canonical(robot)
        self.config = URConfig(self.robot, port, self.timing.state_ttl_s, read["rtde_frequency"], read["control"])
        self.declare(Part(PartKind.ARM, arm_of(robot).axes))
        self.gates = all_gates(self.table, self.timing.state_ttl_s, self.period_s)

    def check_port(self) -> None:
        _ = self.config.host

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        # Imported here, since only the caller needs the links of the arm.
        from .twin.model import FLANGE, HOME_RAD, MOUNTED, model_table

        table = arm_table(model_table(arm_of(self.robot), self._gripper))
        if not self._gripper:
            return ArmModel(table, self.axes, FLANGE, home=HOME_RAD)
        link, tool_m = load(f"{MOUNTED}:LINK"), load(f"{MOUNTED}:tool_m")(self._gripper)
        return ArmModel(table, self.axes, link, tool_m, home=HOME_RAD)

    def link_rows(self) -> str:
        from .twin.model import model_table

        return str(model_table(arm_of(self.robot))["model_rows"])

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = {str(key).removesuffix(".pos") for key in action}
        targets = {joint: rad for joint, rad in self.as_json(values).items() if joint in named}
        return {"robot": self.robot, "joints": list(targets), "targets": targets, "control_period": self.period_s}

    def readings(self, observation: Observation) -> dict[str, Any]:
        sensors = observation.sensors
        result: dict[str, Any] = {"model": self.robot}
        for field, name in _READINGS.items():
            result[field] = list(sensors[name]) if name in sensors else None
        for field, modes in (("robot_mode", RobotMode), ("safety_mode", SafetyMode)):
            result[field] = _word(modes, round(sensors[field][0])) if field in sensors else None
        return result


def _word(modes: type[enum.IntEnum], number: int) -> str:
    """Return the name of a mode for programs, such as ``RUNNING``; ``unknown (9)`` if the number 9 has no name."""
    return modes(number).name if number in list(modes) else mode_name(modes, number)


_READINGS: Mapping[str, str] = {
    "tcp_pose": "tcp_pose_m_rad",
    "tcp_speed": "tcp_speed_m_s_rad_s",
    "wrench": "wrench_n_nm",
}
"""Fields of the reading and their sensors. The pose is metres, then a rotation vector; the wrench is newtons,
then newton metres, at the tool's centre in the axes of the base."""
