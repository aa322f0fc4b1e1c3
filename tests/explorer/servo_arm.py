"""The so101 of the explorer: the twin's servos with their registers, on a serial line in memory."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from strands_actors.contract.loading import load

from .hostile_peer import HostilePeer
from .kinds import PEER
from .plan import Event
from .plant import Joints
from .robot_model import Effect, Frame, RobotModel, Seam, nothing, put
from .serial_line import SerialLine
from .world import World

BAUD = 1_000_000
BYTE_S = 10 / BAUD
STS3215 = 777

# Loaded by name, as the registry loads drivers.
FeetechBus: Any = load("strands_actors.drivers.feetech.twin:FeetechBus")
Feetech: Any = load("strands_actors.drivers.feetech.driver:Feetech")
FeetechWire: Any = load("strands_actors.drivers.feetech.wire:FeetechWire")
StopChannel: Any = load("strands_actors.drivers.feetech.wire:FeetechStopChannel")
Decoder: Any = load("strands_actors.drivers.feetech.protocol:Decoder")
SYNC_WRITE: int = load("strands_actors.drivers.feetech.protocol:SYNC_WRITE")
rows_of: Any = load("strands_actors.drivers.feetech.protocol:rows_of")
TABLES: Any = load("strands_actors.drivers.feetech.robots:TABLES")


@dataclass
class Trouble:
    """The present faults of the bus."""

    replies_lost: bool = False
    requests_lost: bool = False
    mute: set[int] = field(default_factory=set)
    late_s: float = 0.0
    corrupt: float = 0.0  # share of replies
    twice: float = 0.0


TOLERATED_COUNTS = 34
"""3 degrees: largest distance between the goal of a hold and the joint's position. A measured position
may be off by one degree."""
SWEEP_DEG = 4.5
"""Step of one joint from setpoint to setpoint: 135 degrees a second."""


class ArmActions:
    """Actions with unique joint angles, so that a frame on the wire identifies its setpoint."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        number = self._given
        action = {
            "wrist_roll": -140.0 + 0.3 * ((number + 467) % 900),
            "wrist_flex": -85.0 + 0.2 * ((number + 425) % 800),
            "shoulder_pan": abs((SWEEP_DEG * number + 80.0) % 320.0 - 160.0) - 80.0,
        }
        if far:
            action["shoulder_pan"] = self._rng.uniform(-90.0, 90.0)
            action["elbow_flex"] = self._rng.uniform(-80.0, 80.0)
        return action


class ServoArm(RobotModel):
    """An so101 that is made limp at once."""

    PORT = "/dev/serial/by-id/explored"
    OPTIONS: ClassVar[Mapping[str, Any]] = {"on_exit": "limp"}
    KEEPS_TORQUE_BY_RESUME = True

    def __init__(self, world: World, robot: str, goal_energises: bool = True) -> None:
        super().__init__(world, robot)
        self.driver_class = Feetech
        driver: Any = self.make_driver(Feetech)
        self.driver = driver
        self._axes = {axis.key: axis for axis in driver.joints}
        table = TABLES.table(robot)
        joints = table["joints"]
        self.ids = tuple(joint["id"] for joint in joints)
        self.plant = Joints([joint["key"] for joint in joints])
        models, volts = [STS3215] * len(joints), float(table["voltage_v"])
        self.bus = FeetechBus(self.plant, self.ids, models, volts, lambda: world.now_s, goal_energises)
        self.line = SerialLine(world, self.PORT, self._hear)
        self.trouble = Trouble()
        self.peer = HostilePeer(world.rng("peer"))
        self._answers = self.peer.stream()
        self._rng = world.rng("bus")
        self._goal = load("strands_actors.drivers.feetech.protocol:GOAL_POSITION")
        self._torque = load("strands_actors.drivers.feetech.protocol:TORQUE_ENABLE")
        self._position = load("strands_actors.drivers.feetech.protocol:POSITION")
        self._before = self._goals()
        self._lost: dict[int, int] = {}
        self._decoder = Decoder()

    @property
    def torque(self) -> frozenset[int]:
        """The motors with torque, by their registers."""
        return frozenset(servo.id for servo in self.bus.servos if servo.get(self._torque))

    def actions(self) -> ArmActions:
        return ArmActions(self.world.rng("actions"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        axis = self._axes[key]
        return axis.id, axis.count(value)

    def marks(self, key: str) -> bool:
        return key.startswith("wrist")

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        here, before = frame.positions[motor], frame.before[motor]
        aims = (here, before, frame.lost.get(motor, here))
        return min(aims) - TOLERATED_COUNTS, max(aims) + TOLERATED_COUNTS

    def seams(self) -> tuple[Seam, ...]:
        line = self.line
        return (
            (Feetech, "open_wire", lambda driver, clock: FeetechWire(driver.config, clock, line.open)),
            (Feetech, "stop_channel", lambda driver, fds, clock: StopChannel(driver.config, fds, clock, line.open)),
            (StopChannel, "adopt", lambda channel, fd: line.adopt(fd)),
        )

    def effect(self, event: Event) -> Effect | None:
        trouble, motor = self.trouble, event.motor
        match event.kind:
            case "lose replies":
                return put(trouble, "replies_lost", True, False)
            case "lose requests":
                return put(trouble, "requests_lost", True, False)
            case "mute":
                return lambda: trouble.mute.add(motor), lambda: trouble.mute.discard(motor)
            case "late":
                return put(trouble, "late_s", 0.06, 0.0)
            case "corrupt":
                return put(trouble, "corrupt", 0.2, 0.0)
            case "twice":
                return put(trouble, "twice", 0.3, 0.0)
            case "pull":
                return self.line.pull, self.line.put_back
            case "unload":
                return lambda: self.unload(motor), nothing
            case "brown out":
                return lambda: self.brown_out(motor), nothing
        return put(self.peer, "kind", event.kind, "") if event.kind in PEER else None

    def mend(self) -> None:
        trouble = self.trouble
        trouble.replies_lost = trouble.requests_lost = False
        trouble.mute.clear()
        self.peer.kind = ""
        trouble.late_s = trouble.corrupt = trouble.twice = 0.0
        self.line.put_back()

    def unload(self, motor: int) -> None:
        """Make a servo protect itself, so that it has no torque."""
        servo = self._servo(motor)
        servo.write(self._torque.address, b"\0")
        self._log_torque()

    def brown_out(self, motor: int) -> None:
        """Restart a servo, as after a dip of its supply."""
        self.bus.pass_time()
        self._servo(motor).power_cycle()
        self._log_torque()

    def positions(self) -> dict[int, int]:
        self.bus.pass_time()
        for servo in self.bus.servos:
            servo.sense()
        return {servo.id: servo.get(self._position) for servo in self.bus.servos}

    # -- the servos' end of the line

    def _hear(self, data: bytes, role: str) -> Iterable[tuple[float, bytes]]:
        trouble = self.trouble
        if trouble.requests_lost or not self.line.plugged:
            self.world.note("wire", "loses", f"{role}: {data.hex()}")
            self._lose(data)
            return
        for exchange in self.bus.receive(data, BAUD):
            if exchange.kind != "read":
                self._log(exchange, role)
            yield from self._replies(exchange)

    def _lose(self, data: bytes) -> None:
        for packet in self._decoder.feed(data):
            if packet.code == SYNC_WRITE and packet.params[0] == self._goal.address:
                _, rows = rows_of(packet)
                self._lost |= {motor: self._goal.decode(row[: self._goal.size]) for motor, row in rows.items()}

    def _replies(self, exchange: Any) -> Iterable[tuple[float, bytes]]:
        trouble, rng = self.trouble, self._rng
        at_s = len(exchange.request) * BYTE_S
        for reply in exchange.replies:
            at_s += reply.delay_s + len(reply.data) * BYTE_S
            if trouble.replies_lost or reply.unit in trouble.mute:
                continue
            data = reply.data
            if trouble.corrupt and rng.random() < trouble.corrupt:
                at = rng.randrange(len(data))
                data = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
            late_s = trouble.late_s * rng.random()
            for piece in self._answers.spoil(data):
                yield at_s + late_s, piece
            if trouble.twice and rng.random() < trouble.twice:
                yield at_s + late_s + 0.002 * rng.random(), data

    def _log(self, exchange: Any, role: str) -> None:
        before, energised_before = self._before, self.energised_log[-1][1]
        now = self.torque
        goals = self._before = self._goals()
        frame = Frame(
            self.world.now_s,
            self.world.now_s,
            role,
            exchange.kind,
            str(exchange.safe_state or ""),
            {motor: goals[motor] for motor in self._named(exchange, goals)},
            before,
            dict(self._lost),
            self.positions(),
            energised_before,
            now,
        )
        self.frames.append(frame)
        for motor in frame.goals:
            self._lost.pop(motor, None)
        self._log_torque()
        what = f"{exchange.kind} {exchange.safe_state or ''} {dict(frame.goals)} torque {sorted(now)}"
        self.world.note("wire", role, what)

    def _named(self, exchange: Any, goals: Mapping[int, int]) -> Sequence[int]:
        """Return the motors for which the frame writes a goal."""
        data = exchange.request
        if len(data) > 7 and data[4] == 0x83 and data[5] == self._goal.address:
            size = data[6] + 1
            return [data[at] for at in range(7, len(data) - 1, size)]
        return []

    def _goals(self) -> dict[int, int]:
        return {servo.id: servo.get(self._goal) for servo in self.bus.servos}

    def _log_torque(self) -> None:
        self.log_energised(self.torque)

    def _servo(self, motor: int) -> Any:
        return next(servo for servo in self.bus.servos if servo.id == motor)


class LoweredArm(ServoArm):
    """An so101 that is lowered by a stop without hurry."""

    OPTIONS: ClassVar[Mapping[str, Any]] = {"on_exit": "lower"}
    SETTLE_S: ClassVar[float] = ServoArm.SETTLE_S + 3.0
    """A lowering takes 2.8 s."""

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, "so101")
