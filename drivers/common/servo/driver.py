"""The base of all drivers for robots of position servos on a serial bus. It declares everything that does not
depend on the protocol and the firmware."""

from __future__ import annotations

import importlib
import shlex
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Part, PartKind, finite
from strands_actors.contract.driver import Driver, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.tool_verbs import (
    GET_POSE,
    MOVE_TO,
    MOVE_TO_POSE,
    SENSORS,
    SET_TORQUE,
    STATUS,
    STOP,
    ToolVerb,
)
from strands_actors.drivers.common.kit import calibration as lerobot
from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.drivers.common.kit.robot_tables import RobotTables
from strands_actors.drivers.common.ports.addresses import check_device

from .axes import COUNTS_PER_RADIAN, MIDDLE, axes_of
from .config import ServoConfig
from .gates import MAX_JUMP_DEG, NO_MAX_JUMP_DEG, all_gates
from .lowering import LoweringConfig
from .resting import (
    CONFIRM_S,
    LOWER_S,
    LOWERINGS_S,
    WITHOUT_HURRY,
    OnExit,
    on_exit_of,
    rest_counts,
    rest_file,
    rest_of,
)

TIMEOUT_S = 0.5
TIMEOUTS_S = (0.1, 10.0)
"""Shortest and longest timeout."""
LAST_ID = 252
"""Largest id of a servo. Both protocols reserve the ids above for broadcasts and errors."""

NO_CALIBRATION = "none: the travel of its model"


class ServoOptions(DriverOptions, frozen=True):
    """The keyword arguments of a servo driver. ``resolve`` checks their values, because the valid ones depend on
    the robot's servos."""

    calibration: Annotated[
        str | dict[str, Any] | None,
        option(
            "path of a lerobot calibration file, or its content; None: lerobot's file of this id, "
            "else the travel of its model",
            is_path=True,
        ),
    ] = None
    baud: Annotated[int | None, option("bits per second of the bus; None: the usual speed of its servos")] = None
    motor_ids: Annotated[
        tuple[int, ...] | None,
        option("ids of the servos, one per joint and in their order, where they are not the usual ones"),
    ] = None
    timeout: Annotated[
        float | None,
        option(
            f"seconds the whole bus may be silent before it counts as lost, at most {TIMEOUTS_S[1]:g}; "
            f"None: {TIMEOUT_S:g}"
        ),
    ] = None
    max_jump: Annotated[
        float | None,
        option(
            "degrees that one command may send a joint from where it is, at full speed; "
            f"None: {MAX_JUMP_DEG:g}; {NO_MAX_JUMP_DEG:g}: any. move_to() is not bounded by it"
        ),
    ] = None

    on_exit: Annotated[
        str | None,
        option(
            "what stop(), cleanup() and the end of your program do to the robot: lower (bring an arm down, then "
            "torque off), limp (torque off at once: an arm falls) or hold (leave it energised where it is); None: "
            "lower for an arm that can be lowered, else limp"
        ),
    ] = None
    rest: Annotated[
        str | dict[str, float] | None,
        option(
            "pose to which the arm is lowered, by joint in its unit, or the path of a file with it; None: the "
            "taught pose of this id, else the torque falls until the arm gives way",
            is_path=True,
        ),
    ] = None
    lower_s: Annotated[
        float | None,
        option(
            "seconds that lowering may take; the torque is switched off then, wherever the arm is; "
            f"None: {LOWER_S:g}"
        ),
    ] = None


class ServoDriver(Driver):
    """Base of the drivers of servo buses.

    This class provides options, axes, checks of commands, calibration, and a warning if the robot is not
    calibrated. A subclass sets the class variables that have no value here: the robots' tables, baud rates, rules
    for calibrations, and codes of faults. It also provides the classes that ``Driver`` requires for talking to the
    robot and for stopping it.
    """

    PORT_KIND: ClassVar[Literal["serial", "address"]] = "serial"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATUS, SENSORS, MOVE_TO, SET_TORQUE, STOP)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(ServoOptions)
    SPELLINGS: ClassVar[Mapping[str, str]] = {"baud_rate": "baud", "max_relative_target": "max_jump"}
    TABLES: ClassVar[RobotTables]
    BAUD_RATES: ClassVar[tuple[int, ...]]
    DEFAULT_BAUD: ClassVar[int]
    MAX_OFFSET: ClassVar[int]
    """The largest value that the homing offset register can hold."""
    HOST_INVERTS: ClassVar[bool]
    """True if the host applies drive mode 1 of a calibration (lerobot's rule for this servo)."""
    LEROBOT_TYPES: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """lerobot's present folder names for a robot, in addition to the robot's name and aliases."""
    SETUP: ClassVar[str]
    """``module:class`` that gives servos their ids and their calibration (``setup.py``)."""
    CALIBRATIONS: ClassVar[str] = lerobot.ROBOTS
    """lerobot's folder of these calibrations."""
    FAULT_CODES: ClassVar[Mapping[str, MotorCode]]
    """The code of the refusal, by the word that a motor reports."""

    config: ServoConfig
    unit = "degrees (gripper: percent open)"
    timing = Timing(
        control_hz=30.0,
        # A sync write is never acknowledged. Repeating it replaces a lost frame.
        keepalive_s=0.05,
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
    )
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP)

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        accepted = (*cls.OPTIONS, "tool_name", "calibration_source", "calibrated_ids")
        if unknown := [name for name in options if name not in accepted]:
            raise TypeError(f"{robot}: unknown option {', '.join(unknown)}. Use {', '.join(cls.OPTIONS)}")
        name = cls.TABLES.canonical(robot)
        baud = cls.DEFAULT_BAUD if options.get("baud") is None else options["baud"]
        if isinstance(baud, bool) or baud not in cls.BAUD_RATES:
            raise ValueError(f"{robot}: baud is {baud!r}. Use one of {', '.join(map(str, cls.BAUD_RATES))}")
        ids = cls._ids(name, options.get("motor_ids"))
        motors, source = cls._calibration(name, options, ids)
        on_exit = on_exit_of(robot, options.get("on_exit"), cls.is_lowered(name))
        return {
            "baud": int(baud),
            "motor_ids": list(ids.values()),
            "timeout": _seconds(robot, "timeout", options.get("timeout"), TIMEOUT_S, TIMEOUTS_S),
            "max_jump": _max_jump_deg(robot, options.get("max_jump")),
            "on_exit": str(on_exit),
            "rest": cls._rest(name, on_exit, options),
            "lower_s": _seconds(robot, "lower_s", options.get("lower_s"), LOWER_S, LOWERINGS_S),
            "calibration": motors and {key: _plain(motor) for key, motor in motors.items()},
            "calibration_source": source,
            "tool_name": options.get("tool_name"),
            "calibrated_ids": [] if motors else lerobot.ids(cls.lerobot_types(name), category=cls.CALIBRATIONS),
        }

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = options if "calibration_source" in options else self.resolve(robot, options)
        motors = resolved.get("calibration")
        self.robot = self.TABLES.canonical(robot)
        calibration = motors and {key: lerobot.MotorCalibration(**fields) for key, fields in motors.items()}
        if "tool" in self.TABLES.robots[self.robot]:
            vars(self)["TOOL_VERBS"] = (STATUS, SENSORS, GET_POSE, MOVE_TO_POSE, SET_TORQUE, STOP)
        table, ids = self.TABLES.robots[self.robot]["joints"], resolved["motor_ids"]
        joints = [{**joint, "id": motor_id} for joint, motor_id in zip(table, ids, strict=True)]
        self.joints = axes_of(joints, calibration, self.HOST_INVERTS)
        self.config = ServoConfig(
            robot=self.robot,
            port=port,
            baud=int(resolved.get("baud") or self.DEFAULT_BAUD),
            joints=self.joints,
            calibration=calibration,
            calibration_source=resolved["calibration_source"],
            timeout_s=resolved["timeout"],
            modes={joint["key"]: joint["mode"] for joint in joints if "mode" in joint},
            lowering=self._lowering(resolved),
        )
        groups = groupby((axis.declared for axis in self.joints), key=lambda axis: axis.unit)
        part_kinds = {"percent": PartKind.GRIPPER}
        self.declare(*(Part(part_kinds.get(unit, PartKind.ARM), tuple(group)) for unit, group in groups))
        if calibration is None:
            calibrated_ids = ", ".join(resolved.get("calibrated_ids", ()))
            hint = (
                f"Give one of the ids that are calibrated ({calibrated_ids}), or run" if calibrated_ids else "Run"
            )
            name = resolved.get("tool_name") or self.robot
            own_id = "" if name == self.robot else f" --id {shlex.quote(str(name))}"
            self.caveats = (
                f"{self.robot} is not calibrated: its limits are those of its model, and 0 degrees is the middle "
                f"of each servo. {hint} `strands-actors calibrate {self.robot} --port {port or 'P'}{own_id}`",
            )
        self.gates = all_gates(self.joints, self.timing.state_ttl_s, self.FAULT_CODES, resolved["max_jump"])

    def _lowering(self, resolved: Mapping[str, Any]) -> LoweringConfig | None:
        """Return how the arm is lowered, and declare what that changes; None for a robot that is not lowered."""
        on_exit = OnExit(resolved["on_exit"])
        self.fallbacks = {**self.fallbacks, **dict.fromkeys(WITHOUT_HURRY, on_exit.safe_state)}
        if on_exit is not OnExit.LOWER:
            return None
        seconds, rest = resolved["lower_s"], resolved["rest"]
        self.timing = msgspec.structs.replace(self.timing, safe_s=seconds + CONFIRM_S)
        table = self.TABLES.robots[self.robot]
        return LoweringConfig(
            seconds=seconds,
            rest=None if rest is None else rest_counts(self.robot, rest, self.joints),
            model={name: table[name] for name in ("model_rows", "base") if name in table},
        )

    @classmethod
    def is_lowered(cls, robot: str) -> bool:
        return bool(cls.TABLES.table(robot).get("lowers"))

    @classmethod
    def rest_file(cls, robot: str, robot_id: str) -> Path:
        """Return the path of the taught rest pose of one robot. Raise ``ValueError`` for an id that is no name."""
        return rest_file(cls.lerobot_types(cls.TABLES.canonical(robot)), robot_id)

    @classmethod
    def _rest(cls, robot: str, on_exit: OnExit, options: Mapping[str, Any]) -> dict[str, float] | None:
        given, tool_name = options.get("rest"), options.get("tool_name")
        if on_exit is not OnExit.LOWER:
            if given is not None:
                raise ValueError(f'{robot}: rest needs on_exit="lower". Leave one of them out')
            return None
        taught = cls.rest_file(robot, str(tool_name)) if tool_name else None
        return rest_of(robot, given, [joint["key"] for joint in cls.TABLES.table(robot)["joints"]], taught)

    def check_port(self) -> None:
        check_device(self.config.port)

    def preload(self) -> None:
        super().preload()
        # The supervising process may have to open the port itself, and must not import modules then.
        importlib.import_module("serial")

    def model_units(self) -> tuple[tuple[float, float], ...]:
        return tuple((axis.value(MIDDLE), COUNTS_PER_RADIAN / axis.scale) for axis in self.joints)

    def link_rows(self) -> str:
        return str(self.TABLES.table(self.robot).get("model_rows", ""))

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel | None:
        table = self.TABLES.robots[self.robot]
        if "tool" not in table:
            return None
        joints = tuple(joint["key"] for joint in table["joints"] if joint["unit"] != "percent")
        tool = table["tool"]
        return ArmModel(arm_table(table), joints, tool["link"], tuple(tool["xyz"]), tuple(tool["quat"]))

    def travel(self) -> dict[str, tuple[float, float]]:
        return {axis.key: axis.limits for axis in self.joints} if self.config.calibration else {}

    @classmethod
    def _ids(cls, robot: str, motor_ids: object) -> dict[str, int]:
        """Return the id of each joint's servo, by joint."""
        usual = {joint["key"]: joint["id"] for joint in cls.TABLES.robots[robot]["joints"]}
        if motor_ids is None or motor_ids == () or motor_ids == []:
            return usual
        ids = list(motor_ids) if isinstance(motor_ids, list | tuple) else []
        are_ids = all(type(each) is int and 0 <= each <= LAST_ID for each in ids)
        if len(ids) != len(usual) or not are_ids or len(set(ids)) != len(ids):
            raise ValueError(
                f"{robot}: motor_ids is {motor_ids!r}. Give {len(usual)} different ids, 0 to {LAST_ID}, "
                f"in the order {', '.join(usual)}"
            )
        return dict(zip(usual, ids, strict=True))

    @classmethod
    def lerobot_types(cls, robot: str) -> tuple[str, ...]:
        """Return the names under which lerobot may store a robot's calibration. A new calibration is stored under
        the first one."""
        others = tuple(alias for alias, name in cls.TABLES.aliases.items() if name == robot)
        present = cls.TABLES.robots[robot].get("lerobot", cls.LEROBOT_TYPES.get(robot, ()))
        return tuple(dict.fromkeys((*present, robot, *others)))

    @classmethod
    def calibration_file(cls, robot: str, robot_id: str) -> Path:
        """Return the path of lerobot's calibration file of one robot.

        Raises:
            ValueError: The id cannot be the name of a file.
        """
        lerobot.require_id(robot_id)
        return lerobot.folder() / cls.CALIBRATIONS / cls.lerobot_types(robot)[0] / f"{robot_id}.json"

    @classmethod
    def _calibration(
        cls, robot: str, options: Mapping[str, Any], ids: Mapping[str, int]
    ) -> tuple[dict[str, lerobot.MotorCalibration] | None, str]:
        requested = options.get("calibration")
        if isinstance(requested, Mapping):
            source = str(options.get("calibration_source") or "given as a dict")
            return lerobot.check(requested, ids, cls.MAX_OFFSET, source), source
        if isinstance(requested, (str, Path)):
            path: Path | None = Path(requested).expanduser()
        elif requested is None:
            tool_name, types = options.get("tool_name"), cls.lerobot_types(robot)
            path = lerobot.find(types, str(tool_name), category=cls.CALIBRATIONS) if tool_name else None
        else:
            raise ValueError(f"{robot}: calibration is {requested!r}. Give a path, a dict or None")
        if path is None:
            return None, NO_CALIBRATION
        return lerobot.load(path, ids, cls.MAX_OFFSET), str(path)


def _seconds(robot: str, name: str, value: object, usual: float, accepted: tuple[float, float]) -> float:
    """Return an option in seconds; ``usual`` if it is None. Raise ``ValueError`` if it is no number in range."""
    shortest, longest = accepted
    seconds = usual if value is None else finite(value)
    if seconds is None or not shortest <= seconds <= longest:
        raise ValueError(f"{robot}: {name} is {value!r}. Give seconds, {shortest:g} to {longest:g}")
    return seconds


def _max_jump_deg(robot: str, max_jump: object) -> float:
    degrees = MAX_JUMP_DEG if max_jump is None else finite(max_jump)
    if degrees is None or not 0 < degrees <= NO_MAX_JUMP_DEG:
        raise ValueError(
            f"{robot}: max_jump is {max_jump!r}. Give degrees, above 0 and at most {NO_MAX_JUMP_DEG:g}"
        )
    return degrees


def _plain(motor: lerobot.MotorCalibration) -> dict[str, int]:
    return {field: getattr(motor, field) for field in lerobot.FIELDS}
