"""Simulate an arm of CAN motors (a "twin"): its motors on one or two buses, with MuJoCo for the joints.

Each bus is a serial port with an adapter, which speaks ``slcan`` or the language of Damiao's or RobStride's
adapter, whichever the client begins with. With the option ``interfaces`` each bus is a network interface, such as
``vcan0``.

Its log has each frame that a motor has received, by its kind:

    setpoint   a command that may move the joint
    safe       a command without stiffness (``damp``, ``zero_torque``), one that is marked as a hold, or a disable
               (``limp``). The log names the safe state as soon as all motors are in it
    enable     a motor is energised

Further control lines: ``motor KEY STATE`` (a motor enters a state of ``protocol.State``, such as
``UNDERVOLTAGE``), and ``temperature KEY CELSIUS``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any

import trio

from strands_actors.contract.options import option
from strands_actors.drivers.can_motors.protocol import Frame, State
from strands_actors.drivers.can_motors.robots import SIDES, Arm, arm_of, model_table, read_table, table_of
from strands_actors.drivers.common.physics.jointed_body import JointedBody
from strands_actors.drivers.common.twin import (
    Exchange,
    Fault,
    Faults,
    Line,
    PtyLine,
    Reply,
    TwinOptions,
    WireLog,
    main_of,
    parse_fault,
)
from strands_actors.drivers.common.twin.server import Conversation, Frost

from .adapters import AnyAdapter
from .can_line import CanLine
from .motor import MODELLED, SIMULATED, MitPlant, SimMotor, SimRobStride

__all__ = ["MODELLED", "CanRobot", "CanServer", "main"]

FRAME_S = 0.00013
"""Time of one frame on a bus of 1 Mbit/s: some 130 bits."""
TICK_S = 0.02
"""How often the arm moves on without requests."""


class CanTwinOptions(TwinOptions, frozen=True):
    link: Annotated[str | None, option("path at which the serial port appears; None: a temporary one")] = None
    interfaces: Annotated[str, option("CAN interfaces to serve at instead of serial ports: vcan0")] = ""
    side: Annotated[str, option("side of a single arm: left or right", pattern="^(left|right)$")] = SIDES[1]
    table: Annotated[str | dict[str, Any] | None, option("table of an arm of one's own")] = None
    mit_protocol: Annotated[bool, option("whether RobStride motors speak the MIT protocol, with 11 bits")] = False


class CanRobot:
    """The motors of one arm. Its time advances at each call, by the given clock. No method waits."""

    def __init__(self, arm: Arm, table: Mapping[str, Any], now_s: Callable[[], float] = time.monotonic) -> None:
        self.arm = arm
        self.plant = MitPlant.from_table(model_table(arm, table))
        self.motors: tuple[SimMotor, ...] = tuple(
            SIMULATED[motor.type.family](motor, self.plant, index) for index, motor in enumerate(arm.motors)
        )
        self.body = JointedBody(self.plant, self.pass_time)
        self.faults = Faults()

        self.now_s = now_s

    def pass_time(self) -> None:
        now_s = self.now_s()
        due = [
            (end_s, motor) for motor in self.motors if (end_s := motor.overdue_s()) is not None and end_s <= now_s
        ]
        for end_s, motor in sorted(due, key=lambda each: each[0]):
            self.plant.catch_up(end_s)
            motor.switch(State.LOST_COMMUNICATION)
        self.plant.catch_up(now_s)

    def handle(self, bus: int, frame: Frame) -> tuple[str, str | None, list[tuple[int, Frame]]]:
        """Carry out a frame. Return its kind, the safe state of the whole arm, and the answers by unit."""
        self.pass_time()
        kind, safe_state = "other", None
        replies: list[tuple[int, Frame]] = []
        for motor in self.motors:
            if motor.motor.bus != bus or motor.fault is Fault.OFF:
                continue
            done = motor.receive(frame)
            if done is not None:
                motor.last_s = self.now_s()
                kind = done.kind
                replies += ((motor.unit, reply) for reply in done.replies)
        if kind == "safe":
            states = {motor.commanded for motor in self.motors if motor.fault is not Fault.OFF}
            safe_state = states.pop() if len(states) == 1 else ""
        return kind, safe_state, replies

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        self.pass_time()
        self.faults.set(fault, unit)
        for motor in self.motors:
            motor.set_fault(self.faults.of(motor.unit))

    def power_cycle(self) -> None:
        self.pass_time()
        for motor in self.motors:
            motor.power_cycle()

    def motor(self, key: str) -> SimMotor:
        return next(motor for motor in self.motors if motor.motor.key == key)


class BusSession:
    """The robot's side of one bus."""

    def __init__(self, robot: CanRobot, bus: int, socketcan: bool = False) -> None:
        self._robot = robot
        self._bus = bus
        self._adapter = AnyAdapter(socketcan)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        for request, frame, answer in self._adapter.frames(data):
            if frame is None:
                replies = (Reply(0.0, answer, kind="other"),) if answer else ()
                yield Exchange("other", request, replies)
                continue
            kind, safe_state, answers = self._robot.handle(self._bus, frame)
            faulty = (
                self._robot.faults.apply(Reply(2 * FRAME_S, self._adapter.encode(each), unit))
                for unit, each in answers
            )
            yield Exchange(kind, request, [reply for reply in faulty if reply], safe_state)


class CanServer:
    """Serve the buses of one simulated arm."""

    def __init__(self, robot: CanRobot, lines: Sequence[Line], log: WireLog, socketcan: bool = False) -> None:
        self.robot = robot
        self.body = robot.body
        self._lines = tuple(lines)
        self._frost = Frost()
        self._conversations = [
            Conversation(BusSession(robot, bus, socketcan), line, log, self._frost, wire_time=False)
            for bus, line in enumerate(lines)
        ]

    @property
    def address(self) -> str:
        return ",".join(line.address for line in self._lines)

    def set_fault(self, text: str) -> None:
        self.robot.set_fault(*parse_fault(text))

    def power_cycle(self) -> None:
        self.robot.power_cycle()

    def plug(self) -> None:
        for line in self._lines:
            line.plug()

    def unplug(self) -> None:
        for line in self._lines:
            line.unplug()

    def freeze(self, seconds: float) -> None:
        self._frost.freeze(seconds)

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line (see the module). Return False if it is unknown."""
        keys = [motor.key for motor in self.robot.arm.motors]
        match words:
            case ["motor", key, state] if key in keys and state in State.__members__:
                self.robot.pass_time()
                self.robot.motor(key).switch(State[state])
            case ["temperature", key, celsius] if key in keys and celsius.isdecimal():
                self.robot.motor(key).temperature_c = float(celsius)
            case _:
                return False
        return True

    async def serve(self) -> None:
        async with trio.open_nursery() as nursery:
            for conversation in self._conversations:
                nursery.start_soon(conversation.serve)
            nursery.start_soon(self._frost.every, TICK_S, self.robot.pass_time)

    def close(self) -> None:
        for line in self._lines:
            line.close()


def build(robot: str, options: CanTwinOptions, log: WireLog) -> CanServer:
    """Return the server of an arm of ``robots.toml``, or of a user's table."""
    table = options.table
    if isinstance(table, str):
        table = read_table(robot, table)
    elif table is None:
        table = table_of(robot, options.side)
    arm = arm_of(robot, table)
    twin = CanRobot(arm, table)
    for motor in twin.motors:
        if isinstance(motor, SimRobStride):
            motor.speaks_mit = options.mit_protocol
    if options.interfaces:
        return CanServer(twin, [CanLine(name) for name in options.interfaces.split(",")], log, socketcan=True)
    links = [options.link and f"{options.link}{bus or ''}" for bus in range(arm.buses)]
    return CanServer(twin, [PtyLine(link) for link in links], log)


main = main_of(CanTwinOptions, build)
