"""Robotiq two-finger grippers on Modbus TCP: robotiq_2f85, robotiq_2f85_v4.

Safe, for whatever reason, is to hold: the fingers stop where they are (rGTO 0) and stay activated, so that what
is held stays held by the gear, which cannot be driven from the fingers' side [assumed]. There is no limp, and
nothing here ever asks for the automatic release. What is given up in a hold is that the gripper closes again
by itself when the object slips.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, StopChannel, Timing
from strands_actors.contract.tool_verbs import SENSORS, STATUS, STOP, ToolVerb
from strands_actors.drivers.common.tcp_port import parse_address
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from .gates import FORCE, POSITION, SPEED, all_gates, keys_of, parse, position_key
from .protocol import ACTIVATION_S
from .robots import TABLES

if TYPE_CHECKING:
    from .wire import RobotiqWire

TCP_PORT = 502

_HOW: Mapping[str, Mapping[str, str]] = {
    "speed": {"type": "number", "description": "0 slowest to 1 fastest, the default"},
    "force": {"type": "number", "description": "0 weakest to 1 strongest, the default"},
}


class Robotiq(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = "strands_actors.drivers.robotiq.twin:main"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        ToolVerb("open", "action", "Open the fingers all the way.", _HOW, action={"gripper": 0.0}),
        ToolVerb("close", "action", "Close the fingers, onto what is between them.", _HOW, action={"gripper": 1.0}),
        SENSORS,
        STATUS,
        STOP,
    )
    ROLLOUTS: ClassVar[str] = "a gripper is one dimension of its arm's action and runs no policy of its own"
    OPTIONS: ClassVar[Mapping[str, str]] = {
        "unit_id": "Modbus unit, 0 to 247; default 9, behind a UR controller 0",
        "stroke_mm": "opening when fully open, to be sure that it is the gripper that was meant",
        "activate": "whether connecting may activate a gripper that is not: that moves its fingers through their "
        "whole stroke; default true",
    }

    axes = ("gripper",)
    unit = "closed fraction, 0 open to 1 closed (position, aperture_mm: millimetres open)"
    timing = Timing(
        control_hz=50.0,
        keepalive_s=0.5,  # nothing needs it: it heals a request that the gripper did not take
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
        arm_s=ACTIVATION_S + 2.0,
    )
    fallbacks: Mapping[Reason, str] = dict.fromkeys(Reason, "hold")
    firmware_watchdog = "none: left alone it keeps its grip and finishes its last motion [assumed]"

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        if unknown := [name for name in options if name not in (*cls.OPTIONS, "tool_name")]:
            raise TypeError(f"{robot}: unknown option {', '.join(unknown)}. Use {', '.join(cls.OPTIONS)}")
        table = TABLES.table(robot)
        unit_id = options.get("unit_id", table["unit"])
        if isinstance(unit_id, bool) or not isinstance(unit_id, int) or not 0 <= unit_id <= 247:
            raise ValueError(f"{robot}: unit_id is {unit_id!r}. Give a whole number from 0 to 247")
        stroke_mm = options.get("stroke_mm", table["stroke_mm"])
        if stroke_mm != table["stroke_mm"]:
            raise ValueError(
                f"{robot}: stroke_mm is {stroke_mm!r}, this gripper opens {table['stroke_mm']:g} mm. "
                "Use the robot of that stroke"
            )
        activate = options.get("activate", True)
        if not isinstance(activate, bool):
            raise ValueError(f"{robot}: activate is {activate!r}. Give True or False")
        return {"unit_id": unit_id, "activate": activate}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = self.resolve(robot, options)
        self.robot = TABLES.canonical(robot)
        self.port = port
        self.unit_id: int = resolved["unit_id"]
        self.activate: bool = resolved["activate"]
        self.stroke_mm: float = TABLES.table(robot)["stroke_mm"]
        self.ids = (self.unit_id,)
        self.keys = keys_of(self.stroke_mm)
        self.gates = all_gates(self.timing.state_ttl_s)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.keys)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return {"gripper": values[POSITION]}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """``position`` is the closed fraction, whatever key it was asked for with [assumed]."""
        return {
            "robot": self.robot,
            "commanded_key": position_key(action, self.keys),
            "position": round(values[POSITION], 4),
            "aperture_mm": round(self.aperture_mm(values[POSITION]), 2),
            "speed": values[SPEED],
            "force": values[FORCE],
        }

    def aperture_mm(self, closed: float) -> float:
        """Nominal: the real scale is not linear at its ends [assumed]."""
        return self.stroke_mm * (1.0 - closed)

    def preload(self) -> None:
        importlib.import_module(f"{__package__}.wire")

    def open_wire(self, clock: Clock) -> RobotiqWire:
        from .wire import RobotiqWire

        return RobotiqWire(self, clock)

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        from .wire import RobotiqStopChannel

        return RobotiqStopChannel(self, clock)

    def address(self) -> tuple[str, int]:
        """Raise ``ValueError`` for a ``port`` that is no address."""
        return parse_address(self.port, TCP_PORT)
