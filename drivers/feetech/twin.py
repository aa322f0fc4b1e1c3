"""Simulate the servos of a Feetech bus: their control tables, with MuJoCo for the joints."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Exchange, Reply, Server, WireLog, main_of
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.common.twin.servo_bus import BusOptions, ServoBus, serve

from . import protocol as p
from .robots import LEADERS, TABLES
from .servo import Servo

INSTRUCTIONS: Modelled[int] = Modelled(
    "instructions to the servos",
    {
        p.PING: "returns the error byte",
        p.READ: "returns registers",
        p.WRITE: "writes registers; read-only ones keep their value",
        p.REG_WRITE: "keeps a write until the next action",
        p.ACTION: "carries out the kept write",
        p.RESET: "restores the values at delivery, except the id",
        p.REBOOT: "restarts the servo",
        p.SYNC_READ: "returns the same registers of several servos",
        p.SYNC_WRITE: "writes the same registers of several servos",
    },
    "silence",
)
MODELLED = (INSTRUCTIONS,)


class FeetechBus(ServoBus[Servo, p.Packet]):
    def __init__(
        self,
        plant: Plant,
        ids: Sequence[int],
        models: Sequence[int],
        voltage_v: float = 7.4,
        now_s: Callable[[], float] = time.monotonic,
        goal_energises: bool = True,
    ) -> None:
        """Make a simulated bus with one servo for each joint of ``plant``.

        Args:
            plant: The simulated joints.
            ids: The id of each servo, in the order of the joints.
            models: The model number (register 3) of each servo, in the same order.
            voltage_v: Supply voltage.
            now_s: The clock.
            goal_energises: See ``Servo``.
        """
        servos = [
            Servo(plant, joint, servo_id, model, voltage_v, goal_energises)
            for joint, (servo_id, model) in enumerate(zip(ids, models, strict=True))
        ]
        super().__init__(plant, servos, p.Decoder(), now_s)

    @classmethod
    def for_robot(
        cls, robot: str, now_s: Callable[[], float] = time.monotonic, goal_energises: bool = True
    ) -> FeetechBus:
        """Return the simulated bus of a robot of ``robots.toml``, or of a leader arm."""
        table = (LEADERS if robot in LEADERS.robots else TABLES).table(robot)
        numbers = {name: number for number, name in p.MODEL_NUMBERS.items()}
        return cls(
            Plant.from_table(table),
            [joint["id"] for joint in table["joints"]],
            [numbers[joint["model"]] for joint in table["joints"]],
            float(table["voltage_v"]),
            now_s,
            goal_energises,
        )

    def exchange(self, packet: p.Packet, replies: Sequence[Reply]) -> Exchange:
        message_type = p.classify(packet)
        safe_state = p.safe_state(packet, [servo.id for servo in self.servos]) if message_type == "safe" else None
        return Exchange(message_type, p.frame(*packet), replies, safe_state)

    def answer(self, packet: p.Packet, hearing: Mapping[int, Sequence[Servo]]) -> Iterable[Reply | None]:
        if packet.code not in INSTRUCTIONS:
            return ()
        if packet.code == p.SYNC_READ:
            return _sync_read(hearing, packet.params)
        if packet.code == p.SYNC_WRITE:
            _sync_write(hearing, packet.params)
            return ()
        if packet.id == p.BROADCAST:
            replies = [_answer(servo, packet) for key in sorted(hearing) for servo in hearing[key]]
            return replies if packet.code == p.PING else ()
        return [_answer(servo, packet) for servo in hearing.get(packet.id, ())]


def _status(servo: Servo, params: bytes = b"", message_type: str = "read") -> Reply:
    return Reply(servo.return_delay_s, p.frame(servo.id, servo.error, params), servo.id, message_type)


def _sync_read(hearing: Mapping[int, Sequence[Servo]], params: bytes) -> list[Reply | None]:
    """Return the replies of the servos in the order of the request. A missing servo does not delay the next
    reply."""
    if len(params) < 2:
        return []
    address, size, *ids = params
    return [_status(s, s.read(address, size)) for i in ids for s in hearing.get(i, ())]


def _sync_write(hearing: Mapping[int, Sequence[Servo]], params: bytes) -> None:
    if len(params) < 2:
        return
    address, size = params[:2]
    for start in range(2, len(params) - size, size + 1):
        for servo in hearing.get(params[start], ()):
            servo.write(address, params[start + 1 : start + 1 + size])


def _answer(servo: Servo, packet: p.Packet) -> Reply | None:
    """Carry out a request to one servo. Return its reply; None if the request is unknown or gets no reply."""
    params = packet.params
    # Make the reply now, since the request may change the id or the return delay.
    reply = _status(servo, message_type=p.classify(packet))
    match packet.code, len(params):
        case p.PING, _:
            return reply
        case p.READ, 2:
            return _status(servo, servo.read(*params))
        case p.WRITE, size if size > 1:
            servo.write(params[0], params[1:])
        case p.REG_WRITE, size if size > 1:
            servo.keep(params)
        case p.ACTION, _:
            servo.act()
        case p.RESET, _:
            servo.reset()
        case p.REBOOT, _:
            servo.power_cycle()
        case _:
            return None
    return reply if servo.get(p.STATUS_LEVEL) else None


class FeetechTwinOptions(BusOptions, frozen=True):
    goal_energises: Annotated[bool, option("whether a goal turns a servo's torque on, as on a real STS3215")] = True


def build(robot: str, options: FeetechTwinOptions, log: WireLog) -> Server:
    """Return the server of a robot of ``robots.toml``."""
    return serve(FeetechBus.for_robot(robot, goal_energises=options.goal_energises), options, log)


main = main_of(FeetechTwinOptions, build)
