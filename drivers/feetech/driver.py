"""Feetech STS/SMS arms and legs: so100, so101, hope_jr, open_duck_mini."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from strands_actors.drivers.common import calibration as lerobot
from strands_actors.runtime.clock import Clock
from strands_actors.runtime.contract import (
    HOLDING_REASONS,
    Candidate,
    Driver,
    GateState,
    Reason,
    SecondPath,
    Timing,
)
from strands_actors.runtime.messages import Refused

from .axes import aliases, axes_of, canonical, motor_ids, robots
from .gates import all_gates, parse
from .protocol import BAUD_RATES, HOMING_OFFSET

if TYPE_CHECKING:
    from .wire import FeetechWire

MAX_OFFSET = (1 << (HOMING_OFFSET.sign_bit or 0)) - 1

NO_CALIBRATION = "none: full servo travel"

_LEROBOT_TYPES = {"so100": ("so_follower",), "so101": ("so_follower",)}
"""Folder names of lerobot beside the robot's own name and aliases: since 0.5 both arms share one."""


class Feetech(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(robots())
    ALIASES: ClassVar[Mapping[str, str]] = aliases()
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "serial"
    TWIN: ClassVar[str] = "strands_actors.drivers.feetech.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = {
        "calibration": "path of a lerobot calibration file, or its content; "
        "default: lerobot's file of this tool_name, else full servo travel",
        "baud": f"speed of the bus, one of {', '.join(map(str, BAUD_RATES))}; default {BAUD_RATES[0]}",
    }

    unit = "degrees (gripper: percent open)"
    timing = Timing(
        control_hz=30.0,
        keepalive_s=0.05,  # SYNC_WRITE is never acknowledged: a re-send heals a frame the bus lost
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
    )
    ladder: Mapping[Reason, str] = {reason: "hold" if reason in HOLDING_REASONS else "limp" for reason in Reason}
    firmware_watchdog = "none: a servo left alone holds its last goal with torque on, for ever"

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        accepted = (*cls.OPTIONS, "tool_name", "calibration_source")
        if unknown := [name for name in options if name not in accepted]:
            raise TypeError(f"{robot}: unknown option {', '.join(unknown)}. Use {', '.join(cls.OPTIONS)}")
        name = canonical(robot)
        baud = options.get("baud") or BAUD_RATES[0]
        if isinstance(baud, bool) or baud not in BAUD_RATES:
            raise ValueError(f"{robot}: baud is {baud!r}. Use one of {', '.join(map(str, BAUD_RATES))}")
        motors, source = _calibration(name, options)
        return {
            "baud": int(baud),
            "calibration": motors and {key: _plain(motor) for key, motor in motors.items()},
            "calibration_source": source,
        }

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = options if "calibration_source" in options else self.resolve(robot, options)
        motors = resolved.get("calibration")
        self.robot = canonical(robot)
        self.port = port
        self.baud = int(resolved.get("baud") or BAUD_RATES[0])
        self.calibration_source: str = resolved["calibration_source"]
        self.calibration = motors and {key: lerobot.MotorCalibration(**fields) for key, fields in motors.items()}
        self.joints = axes_of(self.robot, self.calibration)
        self.axes = tuple(axis.key for axis in self.joints)
        self.ids = tuple(axis.id for axis in self.joints)
        self.gates = all_gates(self.joints, self.timing.state_ttl_s)
        self._index = {key: at for at, key in enumerate(self.axes)}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.joints, self._index, state)

    def open_wire(self, clock: Clock) -> FeetechWire:
        from .wire import FeetechWire

        return FeetechWire(self, clock)

    def second_path(self, descriptors: Sequence[int], clock: Clock) -> SecondPath:
        from .wire import FeetechSecondPath

        return FeetechSecondPath(self, descriptors[0], clock)


def _calibration(robot: str, options: Mapping[str, Any]) -> tuple[dict[str, lerobot.MotorCalibration] | None, str]:
    given = options.get("calibration")
    ids = motor_ids(robot)
    if isinstance(given, Mapping):
        source = str(options.get("calibration_source") or "given as a dict")
        return lerobot.check(given, ids, MAX_OFFSET, source), source
    if isinstance(given, (str, Path)):
        path: Path | None = Path(given).expanduser()
    elif given is None:
        other_names = tuple(alias for alias, name in aliases().items() if name == robot)
        types = (robot, *other_names, *_LEROBOT_TYPES.get(robot, ()))
        tool_name = options.get("tool_name")
        path = lerobot.find(types, str(tool_name)) if tool_name else None
    else:
        raise ValueError(f"{robot}: calibration is {given!r}. Give a path, a dict or None")
    if path is None:
        return None, NO_CALIBRATION
    return lerobot.load(path, ids, MAX_OFFSET), str(path)


def _plain(motor: lerobot.MotorCalibration) -> dict[str, int]:
    return {field: getattr(motor, field) for field in lerobot.FIELDS}
