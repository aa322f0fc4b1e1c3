"""Provide robots in memory that differ from a position arm: a base, a drone, an arm behind slow HTTP.

Their drivers use only the contract, as the driver of any author does. Tests of the tree use them as
examples of their kind, also in virtual time. The robot behind each driver is a ``Peer``: it logs the
frames that it receives, and simulates their effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import msgspec
import trio

from strands_actors.contract import (
    NS,
    Axis,
    AxisMode,
    Clock,
    Condition,
    ConnectWhenNeeded,
    Driver,
    DriverOptions,
    MotorReport,
    Observation,
    Part,
    PartKind,
    Permit,
    PermitDenied,
    Reason,
    Refused,
    SafeState,
    Timing,
    Wire,
    WireDown,
    axis_gates,
    fallbacks_for,
    plain,
    read_options,
)


class Sent(NamedTuple):
    """One frame that the robot received.

    Attributes:
        t_ns: When it was received.
        kind: ``setpoint`` or ``safe``.
        values: One value an axis.
        safe_state: The requested safe state; empty for a setpoint.
        path: ``wire`` or ``stop_channel``.
    """

    t_ns: int
    kind: str
    values: tuple[float, ...]
    safe_state: str
    path: str


@dataclass
class Peer:
    """The robot. It continues with its last command, even after the sender of the command has ended."""

    axes: int
    sent: list[Sent] = field(default_factory=list)
    answer_s: float = 0.001  # time that an answer takes
    motors_on: bool = False
    height_m: float = 0.0  # for a drone
    battery_pct: float = 100.0
    reachable: bool = True

    def take(self, t_ns: int, kind: str, values: Sequence[float], safe_state: str = "", path: str = "wire") -> None:
        self.sent.append(Sent(t_ns, kind, tuple(values), safe_state, path))
        if safe_state in (SafeState.OFF, SafeState.LAND):
            self.motors_on = safe_state == SafeState.LAND and self.height_m > 0

    @property
    def last_values(self) -> tuple[float, ...]:
        return self.sent[-1].values if self.sent else (0.0,) * self.axes

    def of(self, kind: str, since_ns: int = 0) -> list[Sent]:
        return [sent for sent in self.sent if sent.kind == kind and sent.t_ns >= since_ns]

    def after(self, kind: str, earlier: Sent) -> list[Sent]:
        """Return the frames of this kind that came after ``earlier``, in the order of the wire."""
        index = next(index for index, sent in enumerate(self.sent) if sent is earlier)
        return [sent for sent in self.sent[index + 1 :] if sent.kind == kind]


PEERS: dict[str, Peer] = {}
"""The robot at each port."""

FLOOR_PCT = 20.0
LANDING_S = 2.0


class NoOptions(DriverOptions, frozen=True):
    """The fake robots have no options."""


class KindConfig(msgspec.Struct, frozen=True):
    """The robot's data for its wire and its stop channel."""

    port: str
    axes: tuple[Axis, ...]
    answer_s: float
    control_hz: float
    state_ttl_s: float

    @property
    def peer(self) -> Peer:
        return PEERS.setdefault(self.port, Peer(len(self.axes), answer_s=self.answer_s))


class _Kind(Driver):
    """The common part of the three drivers."""

    WIRE: ClassVar[str] = "tests.fake_kinds:KindWire"
    STOP_CHANNEL: ClassVar[str] = "tests.fake_kinds:KindStopChannel"
    ANSWER_S: ClassVar[float] = 0.001

    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = ""
    PARTS: ClassVar[tuple[Part, ...]]
    config: KindConfig
    firmware_watchdog = "The robot goes on with its last command"

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, NoOptions, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        self.declare(*self.PARTS)
        self.unit = ", ".join(dict.fromkeys(axis.unit for axis in self.table))
        self.gates = axis_gates(self.table, self.timing.state_ttl_s)
        self.config = KindConfig(port, self.table, self.ANSWER_S, self.timing.control_hz, self.timing.state_ttl_s)


def _velocity(key: str, unit: str, limit: float) -> Axis:
    return Axis(key=key, unit=unit, low=-limit, high=limit, mode=AxisMode.VELOCITY)


class FakeBase(_Kind):
    """A base that keeps its last velocity. Only the lifetime of a command, or a stop, ends its motion."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("fake_base",)
    PARTS = (Part(PartKind.BASE, (_velocity("vx", "m/s", 0.5), _velocity("wz", "rad/s", 1.0))),)
    timing = Timing(
        control_hz=10.0, keepalive_s=0.1, stream_ttl_s=0.3, oneshot_ttl_s=0.3, state_ttl_s=0.5, call_s=0.4
    )
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.ZERO)


class FakeDrone(_Kind):
    """A drone that hovers when a writer is late, switches its motors off for an e-stop, and lands for
    every other reason. Arming does not take off. A low battery makes it land at any time."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("fake_drone",)
    PARTS = (
        Part(
            PartKind.DRONE,
            (_velocity("vx", "m/s", 1.0), _velocity("vy", "m/s", 1.0), _velocity("vz", "m/s", 0.5)),
        ),
    )
    timing = Timing(
        control_hz=20.0,
        keepalive_s=0.05,
        stream_ttl_s=0.3,
        oneshot_ttl_s=0.3,
        state_ttl_s=0.5,
        safe_s=2 * LANDING_S,
    )
    fallbacks: Mapping[Reason, SafeState] = {
        **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LAND),
        Reason.ESTOP: SafeState.OFF,
    }

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        super().__init__(robot, port, options)
        self.conditions = (Condition(_battery, Reason.FAULT, SafeState.LAND, always=True),)


def _battery(observation: Observation, now_ns: int) -> Refused | None:
    (pct,) = observation.sensors.get("battery_pct", (100.0,))
    if pct >= FLOOR_PCT:
        return None
    return Refused("battery", f"battery at {pct:.0f} %", "charge it", f"{pct:.0f}", f"{FLOOR_PCT:.0f}")


class FakeHttp(_Kind):
    """An arm behind a service that takes 300 ms for every answer."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("fake_http",)
    PARTS = (
        Part(
            PartKind.ARM,
            tuple(
                Axis(key=f"joint{number}", unit="rad", low=-2.0, high=2.0, speed=1.0, id=number)
                for number in (1, 2)
            ),
        ),
    )
    timing = Timing(control_hz=10.0, keepalive_s=0.5, stream_ttl_s=0.5, state_ttl_s=1.0)
    fallbacks: Mapping[Reason, SafeState] = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.STOP)
    ANSWER_S: ClassVar[float] = 0.3


class KindWire(Wire):
    """A wire that fetches samples in the background, so that a read returns at once even if the robot
    answers slowly."""

    interruptible: ClassVar[bool] = True

    def __init__(self, config: KindConfig, clock: Clock) -> None:
        self._config = config
        self._peer = config.peer
        self._clock = clock
        self._sample: Observation | None = None

    async def open(self) -> dict[str, Any]:
        self._sample = await self._ask()
        return {"answer_s": self._peer.answer_s}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        async with trio.open_nursery() as nursery:
            async for _ in self._clock.ticks(1 / self._config.control_hz):
                nursery.start_soon(self._refresh)

    async def arm(self, permit: Permit) -> Observation:
        sample = await self._ask()
        permit.check()
        self._peer.motors_on = True
        self._sample = sample
        return sample

    async def read(self) -> Observation:
        await trio.lowlevel.checkpoint()
        sample = self._sample
        silent_ns = round(self._config.state_ttl_s * NS)
        if sample is None or self._clock.now_ns() - sample.t_ns > silent_ns:
            raise WireDown("the service does not answer. Check its network")
        return sample

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        if not self._peer.motors_on:
            raise PermitDenied("the motors are off")
        permit.check()
        # Return without waiting for the robot's answer.
        self._peer.take(self._clock.now_ns(), "setpoint", values)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await _make_safe(self._config, self._clock, safe_state, "wire")

    def close(self) -> None:
        self._sample = None

    async def _ask(self) -> Observation:
        await trio.sleep(self._peer.answer_s)
        if not self._peer.reachable:
            raise WireDown("the service is not reachable")
        now_ns = self._clock.now_ns()
        return Observation(
            now_ns,
            self._peer.last_values,
            (now_ns,) * len(self._config.axes),
            sensors={"battery_pct": (self._peer.battery_pct,)},
        )

    async def _refresh(self) -> None:
        sample = await self._ask()
        if self._sample is None or sample.t_ns > self._sample.t_ns:
            self._sample = sample


class _Connection:
    def close(self) -> None:
        """Do nothing: the robot is in memory."""


class KindStopChannel(ConnectWhenNeeded[KindConfig, _Connection]):
    async def connect(self) -> _Connection:
        return _Connection()

    async def make_safe_by(self, port: _Connection, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await _make_safe(self.config, self.clock, safe_state, "stop_channel")

    def failed(self, reason: str, port: _Connection | None = None) -> tuple[MotorReport, ...]:
        return tuple(MotorReport(axis.key, axis.id, False, False, False, reason) for axis in self.config.axes)


async def _make_safe(config: KindConfig, clock: Clock, safe_state: str, path: str) -> tuple[MotorReport, ...]:
    """Send the safe frame before the first wait. A landing is confirmed only when it has ended."""
    peer = config.peer
    written = peer.reachable
    if written:
        rest = tuple(
            axis.rest if axis.mode is AxisMode.VELOCITY else now
            for axis, now in zip(config.axes, peer.last_values, strict=True)
        )
        peer.take(clock.now_ns(), "safe", rest, safe_state, path)
    await trio.sleep(peer.answer_s)
    if written and safe_state == SafeState.LAND and peer.height_m > 0:
        await trio.sleep(LANDING_S)
        peer.height_m, peer.motors_on = 0.0, False
    detail = "" if written else "the service is not reachable"
    return tuple(MotorReport(axis.key, axis.id, written, written, written, detail) for axis in config.axes)
