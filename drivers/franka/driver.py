"""Drive Franka arms through FCI: panda (FER, FCI version 5), fr3 and fr3_v2 (FCI version 10).

A command names a target for all seven joints. A trajectory generator moves the arm to this target. It uses at most
the share ``speed_factor`` of the arm's speed, acceleration and jerk. Between motions nothing is sent, and the
controller holds the arm. After any fault the driver sends StopMove: the controller brakes the arm and holds it. The
joints are never without torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.contract.driver import Driver, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, pose
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATUS, STOP, ToolVerb
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS

from .arms import FLANGE_M, HOME_RAD, arm_of, arms, model_table
from .config import FrankaConfig
from .gates import CONDITIONS, all_gates
from .generator import limits_of
from .protocol import MISSED_TICKS, STATE_HZ


class Options(DriverOptions, frozen=True):
    speed_factor: Annotated[
        float, option("share of the arm's speed, acceleration and jerk that a motion may use", gt=0, le=1)
    ] = 0.2
    stream_rate_hz: Annotated[
        float,
        option("how many of the 1000 states a second are taken over, rounded to a whole stride", ge=10, le=200),
    ] = 30.0


class Franka(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(arms())
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.franka.wire:FrankaWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.franka.stop_channel:FrankaStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.franka.twin:main"
    SENSORS: ClassVar[tuple[Sensor, ...]] = (pose("flange_m", frame="base"),)
    TORQUES: ClassVar[str] = "effort_nm"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (READ_SENSORS, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)
    WHOLE_ACTIONS: ClassVar[bool] = True
    ROLLOUTS: ClassVar[str] = (
        "a Franka arm is moved by send_action: each target is a separate motion, planned from the arm's position"
    )
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "recover": Service("let the controller clear a reflex, so that the arm may be armed again", within_s=5.0)
    }

    config: FrankaConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    firmware_watchdog = (
        f"The watchdog is always on: after {MISSED_TICKS} ms of a motion without a command the controller stops "
        "the arm by itself (communication_constraints_violation) and holds it. If its client's connection ends, it "
        "does so at once. The sensor success_rate shows the share of commands that arrive"
    )
    bound_s = 0.1
    conditions = CONDITIONS

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, Options, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        self.robot = robot
        self.arm = arm_of(robot)
        self.limits = limits_of(self.arm, chosen.speed_factor)
        stride = round(STATE_HZ / chosen.stream_rate_hz)
        self.timing = Timing(
            control_hz=STATE_HZ / stride,
            keepalive_s=0.05,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.15,
            safe_s=2.0,
            silent_s=0.5,  # The start of the 1 kHz process (``cycle``) blocks the wire process for a while.
        )
        self.config = FrankaConfig(
            self.robot, port, self.arm, self.limits, stride, chosen.speed_factor, self.timing.state_ttl_s
        )
        rows = zip(self.arm.keys, self.limits.low, self.limits.high, self.limits.speed, strict=True)
        axes = tuple(
            Axis(key=key, unit="rad", low=low, high=high, speed=speed, id=number)
            for number, (key, low, high, speed) in enumerate(rows, 1)
        )
        self.declare(Part(PartKind.ARM, axes))
        self.gates = all_gates(self.table, self.timing.state_ttl_s)

    def link_rows(self) -> str:
        return str(model_table(self.arm)["model_rows"])

    def check_port(self) -> None:
        _ = self.config.host

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        table = arm_table(model_table(self.arm))
        return ArmModel(table, self.axes, "link7", (0.0, 0.0, FLANGE_M), home=HOME_RAD)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        return {
            "robot": self.robot,
            "joints": list(self.axes),
            "targets": self.as_json(values),
            "speed_factor": self.config.speed_factor,
        }
