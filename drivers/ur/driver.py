"""Drive Universal Robots e-Series and UR-Series arms, by ur-rtde or by our own control script.

If a program sends its next command too late, the robot holds: the servo motion ends, but the control script keeps
running, and its watchdog is still fed. After any other fault the arm is stopped and the control script ends. The
controller then holds the arm by itself. The arm's power stays on. Only the pendant or the e-stop switches it off.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta, structs

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.loading import load
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATE, STATUS, STOP, ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.hand import AXIS, FORCE, FULL, MODEL_UNITS, SPEED, HandKeys, hand_axis
from strands_actors.kernel.messages import Refused

from .arms import ACTIVATION_S, GRIPPER_GATES, GRIPPER_ID, GRIPPERS, JOINTS, MOUNTED, TABLES, URCAP, Gripper, arm_of
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
            "the gripper on the flange, driven by the text port of its URCap: the axis gripper, in percent open. "
            "Poses are those of the point between its fingers, and its links count in the tests of contacts; "
            "None: no gripper"
        ),
    ] = None
    gripper_driven: Annotated[
        bool,
        option("True or False: False if the gripper is a robot of its own, and the arm only carries it"),
    ] = True
    gripper_speed: Annotated[float, option("of an action that names none, 0 to 100 percent", ge=0, le=100)] = FULL
    gripper_force: Annotated[float, option("of an action that names none, 0 to 100 percent", ge=0, le=100)] = FULL
    gripper_activate: Annotated[
        bool,
        option(
            "True or False: whether arming may activate a gripper that is not; that moves its fingers through "
            "their whole stroke"
        ),
    ] = True
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
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("gripper", "gripper_driven")

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
        drives = bool(self._gripper) and read["gripper_driven"]
        self.config = URConfig(
            self.robot,
            port,
            self.timing.state_ttl_s,
            read["rtde_frequency"],
            read["control"],
            drives,
            read["gripper_activate"],
        )
        arm = arm_of(robot).axes
        self._hand_keys: HandKeys | None = None
        if drives:
            fingers = hand_axis(GRIPPER_ID, load(f"{GRIPPERS}:speed_percent_s")(self._gripper))
            self.declare(Part(PartKind.ARM, arm), Part(PartKind.GRIPPER, (fingers,)))
            self.unit = "radians (gripper: percent open)"
            self._hand_keys = HandKeys(self.robot, self.table, read["gripper_speed"], read["gripper_force"])
            self.timing = structs.replace(self.timing, arm_s=self.timing.arm_s + ACTIVATION_S)
        else:
            self.declare(Part(PartKind.ARM, arm))
        self.gates = all_gates(self.table, self.timing.state_ttl_s, self.period_s)
        if drives:
            self.gates += load(f"{GRIPPER_GATES}:mounted_gates")(GRIPPER_ID)

    def preload(self) -> None:
        super().preload()
        if self.config.drives_gripper:
            load(f"{URCAP}:stop_gripper")

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return super().parse(action, state) if self._hand_keys is None else self._hand_keys.parse(action, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return super().as_json(values[: len(self.axes)])

    def model_units(self) -> tuple[tuple[float, float], ...]:
        units = super().model_units()
        return units if self._hand_keys is None else (*units[:GRIPPER_ID], MODEL_UNITS)

    def check_port(self) -> None:
        _ = self.config.host

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        # Imported here, since only the caller needs the links of the arm.
        from .twin.model import FLANGE, HOME_RAD, model_table

        table = arm_table(model_table(arm_of(self.robot), self._gripper))
        if not self._gripper:
            return ArmModel(table, JOINTS, FLANGE, home=HOME_RAD)
        link, tool_m = load(f"{MOUNTED}:LINK"), load(f"{MOUNTED}:tool_m")(self._gripper)
        return ArmModel(table, JOINTS, link, tool_m, home=HOME_RAD)

    def link_rows(self) -> str:
        from .twin.model import model_table

        return str(model_table(arm_of(self.robot))["model_rows"])

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = {str(key).removesuffix(".pos") for key in action}
        targets = {joint: rad for joint, rad in self.as_json(values).items() if joint in named}
        answer = {"robot": self.robot, "joints": list(targets), "targets": targets, "control_period": self.period_s}
        return answer | (dict(zip((SPEED, FORCE), values[-2:], strict=True)) if AXIS in named else {})

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
