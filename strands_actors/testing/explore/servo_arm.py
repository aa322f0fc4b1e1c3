"""The so101 of the explorer: the twin's servos with their registers, on a serial line in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from strands_actors.contract.loading import load

from .plant import Joints
from .serial_line import SerialLine
from .world import World

PATH = "/dev/serial/by-id/explored"
BAUD = 1_000_000
BYTE_S = 10 / BAUD
STS3215 = 777

# By name, as the registry loads drivers.
FeetechBus: Any = load("strands_actors.drivers.feetech.twin:FeetechBus")
Decoder: Any = load("strands_actors.drivers.feetech.protocol:Decoder")
SYNC_WRITE: int = load("strands_actors.drivers.feetech.protocol:SYNC_WRITE")
rows_of: Any = load("strands_actors.drivers.feetech.protocol:rows_of")
TABLES: Any = load("strands_actors.drivers.feetech.robots:TABLES")


class Frame(NamedTuple):
    """What the servos heard, and how it left them."""

    t_s: float
    role: str  # of the process that wrote it
    kind: str  # as the twin's log names it
    safe_state: str
    goals: Mapping[int, int]  # of the frame, by motor
    before: Mapping[int, int]  # goals before it
    lost: Mapping[int, int]  # goals that were written since then and lost
    positions: Mapping[int, int]  # counts, where the joints truly were
    torque_before: frozenset[int]
    torque: frozenset[int]


@dataclass
class Trouble:
    """What is wrong with the bus now."""

    replies_lost: bool = False
    requests_lost: bool = False
    mute: set[int] = field(default_factory=set)
    late_s: float = 0.0
    corrupt: float = 0.0  # share of replies
    twice: float = 0.0


class ServoArm:
    """``frames``: what the servos heard that asks for more than an answer."""

    def __init__(self, world: World, goal_energises: bool = True) -> None:
        self.world = world
        table = TABLES.table("so101")
        joints = table["joints"]
        self.ids = tuple(joint["id"] for joint in joints)
        self.plant = Joints([joint["key"] for joint in joints])
        models, volts = [STS3215] * len(joints), float(table["voltage_v"])
        self.bus = FeetechBus(self.plant, self.ids, models, volts, lambda: world.now_s, goal_energises)
        self.line = SerialLine(world, PATH, self._hear)
        self.trouble = Trouble()
        self.frames: list[Frame] = []
        self.torque_log: list[tuple[float, frozenset[int]]] = [(world.now_s, frozenset())]
        self._rng = world.rng("bus")
        self._goal = load("strands_actors.drivers.feetech.protocol:GOAL_POSITION")
        self._torque = load("strands_actors.drivers.feetech.protocol:TORQUE_ENABLE")
        self._position = load("strands_actors.drivers.feetech.protocol:POSITION")
        self._before = self._goals()
        self._lost: dict[int, int] = {}
        self._decoder = Decoder()

    @property
    def torque(self) -> frozenset[int]:
        """Which motors have torque, by their registers."""
        return frozenset(servo.id for servo in self.bus.servos if servo.get(self._torque))

    def torque_at(self, t_s: float) -> frozenset[int]:
        last: frozenset[int] = frozenset()
        for since_s, motors in self.torque_log:
            if since_s > t_s:
                break
            last = motors
        return last

    def unload(self, motor: int) -> None:
        """A servo protects itself: its torque is gone."""
        servo = self._servo(motor)
        servo.write(self._torque.address, b"\0")
        self._log_torque()

    def brown_out(self, motor: int) -> None:
        """A dip of its supply: it begins anew."""
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
            yield at_s + late_s, data
            if trouble.twice and rng.random() < trouble.twice:
                yield at_s + late_s + 0.002 * rng.random(), data

    def _log(self, exchange: Any, role: str) -> None:
        before, torque_before = self._before, self.torque_log[-1][1]
        now = self.torque
        goals = self._before = self._goals()
        frame = Frame(
            self.world.now_s,
            role,
            exchange.kind,
            str(exchange.safe_state or ""),
            {motor: goals[motor] for motor in self._named(exchange, goals)},
            before,
            dict(self._lost),
            self.positions(),
            torque_before,
            now,
        )
        self.frames.append(frame)
        for motor in frame.goals:
            self._lost.pop(motor, None)
        self._log_torque()
        what = f"{exchange.kind} {exchange.safe_state or ''} {dict(frame.goals)} torque {sorted(now)}"
        self.world.note("wire", role, what)

    def _named(self, exchange: Any, goals: Mapping[int, int]) -> Sequence[int]:
        """Whose goal the frame writes."""
        data = exchange.request
        if len(data) > 7 and data[4] == 0x83 and data[5] == self._goal.address:
            size = data[6] + 1
            return [data[at] for at in range(7, len(data) - 1, size)]
        return []

    def _goals(self) -> dict[int, int]:
        return {servo.id: servo.get(self._goal) for servo in self.bus.servos}

    def _log_torque(self) -> None:
        now = self.torque
        if now != self.torque_log[-1][1]:
            self.torque_log.append((self.world.now_s, now))

    def _servo(self, motor: int) -> Any:
        return next(servo for servo in self.bus.servos if servo.id == motor)
