"""Command the joints of Unitree's legged robots, 500 times a second: ``unitree_g1``; Go2, B2, H1 and H1-2.

Connecting and arming move nothing: the robot is held up by its own controller until the first setpoint is
accepted. From then on it stands only as long as setpoints arrive. When they end, for any reason, the robot is
brought to one of two safe states. Neither of them holds the robot up:

``zero_torque``  every motor loses its torque at once. A standing robot falls within half a second
``damp``         for half a second every motor brakes its joint (kp 0, kd from ``robots.toml``), then it loses its
                 torque. A standing robot sinks and topples more slowly

The option ``on_exit`` selects the safe state. The default is ``zero_torque``. To put a robot down gently, bring it
into a pose from which it cannot fall before the commands end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.options import meanings, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu
from strands_actors.contract.tool_verbs import DURATION
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.motor_targets import ROWS, Parser, target_gates
from strands_actors.drivers.common.ports.addresses import check_peer
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import UnitreeConfig
from .gates import CONTROL_HZ, CONTROL_S, conditions
from .options import IMU, OF_JOINTS, LegsOptions
from .protocol import COMMAND_TOPIC
from .robots import TABLES, model_of
from .walking.loco import G1, H1
from .walking.robots import BASE
from .walking.services import services_of
from .walking.sport import GO2

_MOVE = Service(
    "walk so fast, m/s and rad/s of the body, for so many seconds",
    within_s=1.0,
    arguments=dict.fromkeys((*BASE, DURATION), 0.0),
)


class _Legs(Driver):
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.unitree.wire:UnitreeWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.unitree.stop_channel:UnitreeStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.unitree.twin:main"
    TASKS: ClassVar[str] = (
        "a policy for legs is not started by name, because balance needs a policy object of the script, "
        "at 500 Hz, on the robot's computer"
    )
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        imu(**IMU),
        Sensor("battery", {"pct": "battery_pct"}),
    )
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(LegsOptions)
    SPELLINGS: ClassVar[Mapping[str, str]] = {"interface": "network_interface"}
    OF_WALKING: ClassVar[Mapping[str, Service]] = {}
    """Services of the robots that can also walk (``level="sport"``)."""
    SIMULATED_ROWS: ClassVar[int] = len(ROWS) + 1

    unit = "radians"
    timing = Timing(
        control_hz=CONTROL_HZ,
        keepalive_s=0.9
        * CONTROL_S,  # Just below a control period: a setpoint is repeated only if the next is late.
        stream_ttl_s=0.1,
        oneshot_ttl_s=0.1,
        state_ttl_s=0.1,
        tick_s=CONTROL_S,
        heartbeat_ttl_s=0.02,
    )
    firmware_watchdog = (
        "The firmware has no watchdog that can be armed or read back. The robot keeps its last low-level command, "
        "or falls to damping after 50 to 100 ms [assumed]"
    )
    bound_s = 0.01

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        chosen = read_options(robot, LegsOptions, options)
        if chosen.level != "low":
            names = ", ".join(sorted({name.partition(":")[0] for name in cls.LEVELS}))
            raise ValueError(
                f"{robot} accepts only joint commands. Leave level= out: only {names} have level='sport'"
            )
        if chosen.simulator and chosen.domain == 0:
            raise ValueError(
                f"{robot}: simulator=True, but DDS domain 0 is reserved for real robots. Set another domain in the "
                "simulator (DOMAIN_ID in its config.py, 1 by default) and give the same number as domain="
            )
        return plain(chosen)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, LegsOptions, self.resolve(robot, options))
        model = model_of(robot)
        self.robot = model.name
        if self.robot not in self.SUPPORTED_ROBOTS:
            raise ValueError(f"{robot} is not supported here. Use one of {', '.join(self.SUPPORTED_ROBOTS)}")
        simulator = chosen.simulator
        domain = int(simulator) if chosen.domain is None else chosen.domain
        self.config = UnitreeConfig(model, port, chosen.network_interface, domain, simulator)
        self.declare(Part(PartKind.LEGS, model.table))
        self.fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState(chosen.on_exit))
        self.conditions = conditions(model, chosen.battery_floor_pct, self.timing.state_ttl_s, simulator)
        self.gates = target_gates(model, CONTROL_S, plans_motion=False)
        self._parser = Parser(model)

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        """Return all services, also those of ``level="sport"``. At this level they are refused with a hint."""
        return {**cls.OF_WALKING, **cls.SERVICES}

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        if service in self.OF_WALKING:
            return refusals.joints_only(walks=f"{self.robot}:sport" in self.LEVELS)
        return super().check_service(service, arguments)

    def check_port(self) -> None:
        check_peer(self.config.port)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return self._parser.parse(action, state)

    def parse_simulated(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Parse an action for a simulation. The target has an additional row with 1 or 0 for each joint.

        1 means that an action has named the joint. A joint with 0 is held by the simulated onboard controller,
        which keeps the robot on its feet.
        """
        count, rows_end = len(self.axes), len(self.axes) * len(ROWS)
        before = state.target[rows_end:] or (0.0,) * count
        parsed = self.parse(action, msgspec.structs.replace(state, target=state.target[:rows_end]))
        if isinstance(parsed, Refused):
            return parsed
        named_flags = [*before]
        for index in parsed.named:
            named_flags[index] = 1.0
        return msgspec.structs.replace(parsed, values=(*parsed.values, *named_flags))

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the joint positions of a target, by joint name. Its speeds, torques and gains are left out."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = self._parser.named(action)
        return {
            "topic": COMMAND_TOPIC,
            "joints": [self.axes[index] for index in named],
            "slots": [self.ids[index] for index in named],
            "targets": {self.axes[index]: values[index] for index in named},
            "unit": self.unit,
        }

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        return {**self.commanded(action, values), **controller_report(sensors)}

    def readings(self, observation: Observation) -> dict[str, Any]:
        result = controller_report(observation.sensors)
        pct = observation.sensors.get("battery_pct")
        result["battery_pct"] = None if pct is None else pct[0]
        result["imu"] = {field: list(observation.sensors.get(name, ())) or None for field, name in IMU.items()}
        return result

    def energised(self, safe_state: SafeState) -> bool:
        return False


def controller_report(sensors: Mapping[str, tuple[float, ...]]) -> dict[str, Any]:
    """Return the state of the onboard controller as far as the robot reports it.

    The names are those of the package strands-robots. Fields that the robot does not report are missing.
    """
    return {
        field: convert(sensors[name][0]) for field, (name, convert) in _CONTROLLER_FIELDS.items() if name in sensors
    }


_CONTROLLER_FIELDS: Mapping[str, tuple[str, Callable[[float], Any]]] = {
    "fsm_id": ("fsm", int),
    "mode_machine": ("mode_machine", int),
    "sport_mode_released": ("sport_mode_released", bool),
}
"""Field to its sensor and its type."""


class G1Driver(_Legs):
    """A G1. It accepts joint commands while its state machine (FSM) is in the state 500, 501 or 801."""

    ANSWERS_WITH: ClassVar[tuple[str, ...]] = ("fsm", "mode_machine")

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("unitree_g1",)
    ALIASES: ClassVar[Mapping[str, str]] = {
        alias: name for alias, name in TABLES.aliases.items() if name == "unitree_g1"
    }
    OF_WALKING: ClassVar[Mapping[str, Service]] = {"move": _MOVE, **services_of(G1)}
    LEVELS: ClassVar[Mapping[str, str]] = {
        "unitree_g1:sport": "strands_actors.drivers.unitree.walking.driver:G1Walking",
    }


class Go2Driver(_Legs):
    """Go2, B2, H1 and H1-2. They accept joint commands once their onboard controller was switched off
    (released)."""

    ANSWERS_WITH: ClassVar[tuple[str, ...]] = ("sport_mode_released",)

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(name for name in TABLES.robots if name != "unitree_g1")
    ALIASES: ClassVar[Mapping[str, str]] = {
        alias: name for alias, name in TABLES.aliases.items() if name != "unitree_g1"
    }
    SERVICES: ClassVar[Mapping[str, Service]] = OF_JOINTS
    OF_WALKING: ClassVar[Mapping[str, Service]] = {"move": _MOVE, **services_of(H1), **services_of(GO2)}
    BEFORE_MOTION: ClassVar[str] = "release_sport_mode"
    LEVELS: ClassVar[Mapping[str, str]] = {
        "unitree_go2:sport": "strands_actors.drivers.unitree.walking.driver:Go2Walking",
        "b2:sport": "strands_actors.drivers.unitree.walking.driver:B2Walking",
        "unitree_h1:sport": "strands_actors.drivers.unitree.walking.driver:H1Walking",
    }
