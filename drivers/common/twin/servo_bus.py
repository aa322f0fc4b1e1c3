"""Simulate a bus of position servos: which servo receives a request, and how its fault changes the reply."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Generic, NamedTuple, Protocol, TypeVar

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.jointed_body import JointedBody
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.ports.half_duplex import Decoder, PacketT

from .assembly import AS_IN_TABLE, BuiltIn, parse_assembly
from .faults import Fault, Faults, Reply
from .line import PtyLine
from .options import TwinOptions
from .server import Exchange, Server
from .wirelog import WireLog

TORN_FRAME_S = 0.01
"""An incomplete frame is dropped after a pause of so long [assumed]."""

ZERO_COUNT = 2048
"""Count of the encoder when the joint is at 0 rad."""

TARGET_PERIOD_S = 0.005
"""Period of new targets for a joint that moves to its goal at a set rate."""

MOST_TARGET_BACKLOG_S = 0.25
"""Targets are caught up for at most so long. Time before that is skipped if no request came."""

AHEAD_RAD = 0.3
"""Largest distance between a moving target and a joint that is blocked."""

WATCHED_S = 5.0
"""For so long after the last request, the arm moves on by itself. An arm without torque may still fall then."""

COUNTS = 4096
COUNTS_PER_RAD = COUNTS / (2 * math.pi)


class Register(Protocol):
    """One register of a servo's control table."""

    @property
    def address(self) -> int: ...
    @property
    def size(self) -> int: ...
    def encode(self, value: int) -> bytes: ...
    def decode(self, data: bytes, base: int | None = None) -> int: ...


class Reading(NamedTuple):
    """Measured values of a simulated servo, at its own shaft. ``load`` is its torque as a fraction, -1 to 1, of the
    stall torque."""

    rad: float
    rad_s: float
    load: float


class TwinServo(ABC):
    """One simulated servo: its control table, and its effect on the joint. The bus updates ``reading`` before every
    request."""

    def __init__(self, plant: Plant, joint: int, table: bytearray, voltage_v: float, room_c: float) -> None:
        """Create a servo in its state at delivery.

        Args:
            table: The control table with the values at delivery.
        """
        self.plant = plant
        self.joint = joint
        self.built: BuiltIn = AS_IN_TABLE
        self.factory = bytes(table)
        self.table = table
        self._fault = Fault.OK
        self.reading = Reading(plant.position_rad[joint], 0.0, 0.0)
        self.voltage_v = voltage_v
        self.temperature_c = room_c
        self.rate_rad_s = 0.0
        """Rate at which the target moves; 0 if it has arrived."""
        self.aimed_rad = self.reading.rad
        """Goal to which the target moves, or at which it has arrived."""
        self._target_rad = self.reading.rad

    # -- moving the joint's target

    def move_target(self, rad: float, rate_rad_s: float = 0.0) -> None:
        """Move the joint's target to ``rad`` at ``rate_rad_s``. With rate 0 the joint moves as fast as it can."""
        self.aimed_rad = rad
        if rate_rad_s <= 0:
            self.rate_rad_s = 0.0
            self.plant.set_target(self.joint, self.built.joint_rad(rad))
            return
        if self.rate_rad_s == 0.0:
            self._target_rad = self.reading.rad
        self.rate_rad_s = rate_rad_s

    def turn(self, rate_rad_s: float) -> None:
        """Turn the joint without end at ``rate_rad_s``. With rate 0 it holds its present position."""
        if rate_rad_s == 0.0:
            self.move_target(self.reading.rad)
            return
        self.move_target(math.copysign(math.inf, rate_rad_s), abs(rate_rad_s))

    def stand(self) -> None:
        """Stop the movement of the joint's target."""
        self.rate_rad_s, self.aimed_rad = 0.0, self.reading.rad

    @property
    def target_rad(self) -> float:
        """Return the joint's present target, in radians."""
        return self._target_rad if self.rate_rad_s else self.aimed_rad

    def go_on(self, rad: float, seconds: float) -> None:
        """Move the target as far as it moves in ``seconds``. ``rad`` is the servo's present position."""
        step = self.rate_rad_s * seconds
        target = self._target_rad + max(-step, min(step, self.aimed_rad - self._target_rad))
        self._target_rad = max(rad - AHEAD_RAD, min(rad + AHEAD_RAD, target))
        self.plant.set_target(self.joint, self.built.joint_rad(self._target_rad))
        if self._target_rad == self.aimed_rad:
            self.rate_rad_s = 0.0

    def build_in(self, built: BuiltIn) -> None:
        """Build the servo into the arm differently from the robot's table, and switch it on."""
        self.built = built
        self.reading = self.reading._replace(rad=built.shaft_rad(self.plant.position_rad[self.joint]))
        self.set_identity(built.id, built.firmware)
        self.power_cycle()

    @abstractmethod
    def set_identity(self, servo_id: int | None, firmware: str | None) -> None:
        """Set the id and the firmware at delivery; None keeps a value. Raise ``ValueError`` for an invalid
        firmware version."""

    @property
    @abstractmethod
    def id(self) -> int: ...
    @property
    @abstractmethod
    def bits_per_s(self) -> int | None:
        """Return the bit rate at which the servo receives; None if its register has no valid value."""

    @property
    @abstractmethod
    def return_delay_s(self) -> float: ...
    @abstractmethod
    def sense(self) -> None:
        """Write the measured values into the read-only registers."""

    @abstractmethod
    def power_cycle(self) -> None: ...
    @abstractmethod
    def protect(self, now_s: float) -> None:
        """Do the protective actions that the firmware does without a request, as far as they are due at this
        time. ``now_s`` is the plant's time."""

    def get(self, register: Register) -> int:
        end = register.address + register.size
        return register.decode(bytes(self.table[register.address : end]))

    def put(self, register: Register, value: int) -> None:
        end = register.address + register.size
        self.table[register.address : end] = register.encode(value)

    @property
    def fault(self) -> Fault:
        return self._fault

    @fault.setter
    def fault(self, fault: Fault) -> None:
        if fault is self._fault:
            return
        # Measure once more before a fault begins, because a stuck servo repeats these values.
        self.sense()
        before, self._fault = self._fault, fault
        self.plant.set_stuck(self.joint, fault is Fault.STUCK)
        if Fault.OFF in (before, fault):
            self.power_cycle()


ServoT = TypeVar("ServoT", bound=TwinServo)


class ServoBus(ABC, Generic[ServoT, PacketT]):
    """Simulate a bus of servos: it receives requests and returns replies. Its time advances at each call, by the
    given clock. No method waits."""

    def __init__(
        self, plant: Plant, servos: Sequence[ServoT], decoder: Decoder[PacketT], now_s: Callable[[], float]
    ) -> None:
        self.plant = plant
        self.servos = tuple(servos)
        self.faults = Faults()
        self.now_s = now_s
        self.body = JointedBody(plant, self.pass_time)
        self._decoder = decoder
        self._last_received_s = self._targets_moved_s = now_s()
        # Before the first request the arm stays in its first pose.
        self._watched_until_s = -math.inf

    def assemble(self, text: str | None) -> None:
        """Build servos into the arm differently from the robot's table (``assembly.py``). Raise ``ValueError`` for
        a text that is wrong."""
        by_id = {servo.id: servo for servo in self.servos}
        for servo_id, built in parse_assembly(text, frozenset(by_id)).items():
            by_id[servo_id].build_in(built)

    @abstractmethod
    def exchange(self, packet: PacketT, replies: Sequence[Reply]) -> Exchange:
        """Return a request with its replies as an ``Exchange``, which also has the kind of the request, for the
        log."""

    @abstractmethod
    def answer(self, packet: PacketT, hearing: Mapping[int, Sequence[ServoT]]) -> Iterable[Reply | None]:
        """Carry out a request, and yield the replies.

        Args:
            packet: The request.
            hearing: The servos that receive it, by id. If several servos have the same id, all of them answer, as
                on a real bus.
        """

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        now_s = self.now_s()
        if now_s - self._last_received_s > TORN_FRAME_S:
            # After a pause, drop an incomplete frame. If its length is damaged, it would include the following
            # frames.
            self._decoder.clear()
        self._last_received_s = now_s
        self._watched_until_s = now_s + WATCHED_S
        for packet in self._decoder.feed(data):
            yield self.exchange(packet, self.handle(packet, bits_per_s))

    def handle(self, packet: PacketT, bits_per_s: int | None = None) -> list[Reply]:
        """Carry out one request, and return the replies. A servo with another bit rate than ``bits_per_s`` does not
        receive it. With None all servos receive it."""
        self.pass_time()
        return self.with_faults(self.answer(packet, self.hearing(bits_per_s)))

    def hearing(self, bits_per_s: int | None) -> dict[int, list[ServoT]]:
        hearing: dict[int, list[ServoT]] = {}
        for servo in self.servos:
            if servo.fault is not Fault.OFF and bits_per_s in (None, servo.bits_per_s):
                hearing.setdefault(servo.id, []).append(servo)
        return hearing

    def with_faults(self, replies: Iterable[Reply | None]) -> list[Reply]:
        faulty = (self.faults.apply(reply) for reply in replies if reply)
        return [reply for reply in faulty if reply]

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Set a fault of the servo that now has the id ``unit``, or of all servos."""
        self.pass_time()
        self.faults.set(fault, unit)
        for servo in self.servos:
            servo.fault = self.faults.of(servo.id)

    def power_cycle(self) -> None:
        self.pass_time()
        for servo in self.servos:
            servo.power_cycle()

    def pass_time(self) -> None:
        self.step_to(self.now_s())

    @property
    def has_events(self) -> bool:
        return self.plant.watches_touches

    def events(self) -> list[tuple[str, bytes]]:
        """Advance to the present time, if a host has sent something lately, and return what happened since the last
        call: kind and JSON text of each event."""
        if self.now_s() < self._watched_until_s:
            self.pass_time()
        return [
            ("touch", f'{{"body": "{touch.body}", "speed_m_s": {touch.speed_m_s:.4f}}}'.encode())
            for touch in self.plant.take_touches()
        ]

    def step_to(self, now_s: float) -> None:
        plant = self.plant
        self._move_targets(now_s)
        plant.catch_up(now_s)
        columns = (plant.position_rad, plant.velocity_rad_s, plant.effort_nm, plant.effort_limit_nm)
        for servo, rad, rad_s, nm, limit_nm in zip(self.servos, *columns, strict=True):
            # A servo measures the load of its motor. Without torque it does not notice a hand (a simulation) that
            # moves the joint.
            own = plant.commander(servo.joint) is Commander.WIRE
            built = servo.built
            servo.reading = Reading(built.shaft_rad(rad), built.ratio * rad_s, nm / limit_nm if own else 0.0)
            # A load counts for as long as it is simulated. After a long silence of the bus, the plant skips most of
            # that time, and the load of a moment must not become an overload of seconds.
            servo.protect(plant.time_s)

    def _move_targets(self, now_s: float) -> None:
        """Advance the moving targets of the joints to the time ``now_s``."""
        moved_to_s, self._targets_moved_s = max(self._targets_moved_s, now_s - MOST_TARGET_BACKLOG_S), now_s
        while moved_to_s < now_s and (moving_servos := [servo for servo in self.servos if servo.rate_rad_s]):
            step_s = min(TARGET_PERIOD_S, now_s - moved_to_s)
            moved_to_s += step_s
            position = self.plant.position_rad
            for servo in moving_servos:
                servo.go_on(servo.built.shaft_rad(position[servo.joint]), step_s)
            self.plant.catch_up(moved_to_s)


class BusOptions(TwinOptions, frozen=True):
    link: Annotated[str | None, option("path at which the serial port appears; None: a temporary one")] = None
    wire_time: Annotated[bool, option("whether replies take the time that a UART takes")] = True
    assembly: Annotated[
        str | None,
        option(
            "servos that are built in otherwise than usual: 3:turned=14.4 (degrees of its horn), 3:ratio=1.5, "
            "3:id=4, 3:firmware=3.9, separated by commas"
        ),
    ] = None


def serve(robot: ServoBus[Any, Any], options: BusOptions, log: WireLog) -> Server:
    """Return the server of a simulated robot on a serial port."""
    robot.assemble(options.assembly)
    return Server(robot, PtyLine(options.link), log, wire_time=options.wire_time)
