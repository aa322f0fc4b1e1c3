"""The robot's end of a Feetech bus: servos with their control tables, MuJoCo behind them."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from strands_actors.drivers.common.physics import Plant
from strands_actors.drivers.common.twin import Exchange, Fault, Faults, PtyLine, Reply, run

from . import protocol as p
from .servo import Reading, Servo

TORN_FRAME_S = 0.01
"""A frame whose rest does not come for so long is given up [assumed]."""

OPTIONS = {
    "link": "path at which the serial port appears (default: in a temporary directory)",
    "wire_time": "replies take the time a UART takes (default: true)",
}


def robot_tables() -> dict[str, dict[str, Any]]:
    tables: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("robots.toml").read_text())
    return tables


def table_of(robot: str) -> dict[str, Any]:
    """The robot's table, by its name or an alias. Raise ``ValueError`` with the names there are."""
    tables = robot_tables()
    for name, table in tables.items():
        if robot == name or robot in table["aliases"]:
            return table
    raise ValueError(f"no robot {robot!r} on the Feetech bus. there are {', '.join(tables)}")


class FeetechBus:
    """Requests in, replies out. Time passes between calls, on the clock it is given; it never waits."""

    def __init__(
        self,
        plant: Plant,
        ids: Sequence[int],
        models: Sequence[int],
        voltage_v: float = 7.4,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """``ids`` and ``models`` (the numbers of register 3): the servos of the plant's joints, in order."""
        self.plant = plant
        self.servos = [
            Servo(plant, joint, servo_id, model, voltage_v)
            for joint, (servo_id, model) in enumerate(zip(ids, models, strict=True))
        ]
        self.faults = Faults()
        self._now_s = now_s
        self._decoder = p.Decoder()
        self._heard_s = now_s()

    @classmethod
    def for_robot(cls, robot: str, now_s: Callable[[], float] = time.monotonic) -> FeetechBus:
        """The bus of one robot of ``robots.toml``."""
        table = table_of(robot)
        numbers = {name: number for number, name in p.MODEL_NUMBERS.items()}
        return cls(
            Plant.from_table(table),
            [joint["id"] for joint in table["joints"]],
            [numbers[joint["model"]] for joint in table["joints"]],
            float(table["voltage_v"]),
            now_s,
        )

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        now_s = self._now_s()
        if now_s - self._heard_s > TORN_FRAME_S:
            self._decoder.clear()  # else a damaged length would swallow the frames that follow
        self._heard_s = now_s
        for packet in self._decoder.feed(data):
            yield Exchange(p.classify(packet), p.frame(*packet), self.handle(packet, bits_per_s))

    def handle(self, packet: p.Packet, bits_per_s: int | None = None) -> list[Reply]:
        """One request. A servo set to another rate than ``bits_per_s`` does not hear it (None: all do)."""
        self._pass_time()
        hearing: dict[int, list[Servo]] = {}  # several servos on one id all answer, as on a real bus
        for servo in self.servos:
            if servo.fault is not Fault.OFF and bits_per_s in (None, servo.bits_per_s):
                hearing.setdefault(servo.id, []).append(servo)
        if packet.code == p.SYNC_READ:
            replies: list[Reply | None] = _sync_read(hearing, packet.params)
        elif packet.code == p.SYNC_WRITE:
            _sync_write(hearing, packet.params)
            replies = []
        elif packet.id == p.BROADCAST:
            replies = [_answer(servo, packet) for key in sorted(hearing) for servo in hearing[key]]
            if packet.code != p.PING:
                replies = []
        else:
            replies = [_answer(servo, packet) for servo in hearing.get(packet.id, ())]
        faulty = (self.faults.apply(reply) for reply in replies if reply)
        return [reply for reply in faulty if reply]

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """``unit``: a servo's id as it is now; None: all."""
        self._pass_time()
        self.faults.set(fault, unit)
        for servo in self.servos:
            servo.fault = self.faults.of(servo.id)

    def power_cycle(self) -> None:
        self._pass_time()
        for servo in self.servos:
            servo.power_cycle()

    def _pass_time(self) -> None:
        now_s, plant = self._now_s(), self.plant
        plant.catch_up(now_s)
        columns = (plant.position_rad, plant.velocity_rad_s, plant.effort_nm, plant.effort_limit_nm)
        for servo, rad, rad_s, nm, limit_nm in zip(self.servos, *columns, strict=True):
            servo.reading = Reading(rad, rad_s, nm / limit_nm)
            servo.protect(now_s)


def _status(servo: Servo, params: bytes = b"", kind: str = "read") -> Reply:
    return Reply(servo.return_delay_s, p.frame(servo.id, servo.error, params), servo.id, kind)


def _sync_read(hearing: Mapping[int, Sequence[Servo]], params: bytes) -> list[Reply | None]:
    """In the order of the request; a servo that is not there leaves no gap."""
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
    """Do what a request to one servo, or to all, says. None: it is not one, or wants no answer."""
    params = packet.params
    reply = _status(servo, kind=p.classify(packet))  # with the id and the delay it had when it was asked
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


def main(
    robot: str,
    *,
    port_file: str | None = None,
    log: str | None = None,
    fault: str | None = None,
    parent_fd: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    options = dict(options or {})
    if unknown := options.keys() - OPTIONS.keys():
        raise ValueError(f"no option {', '.join(sorted(unknown))}. there are {', '.join(OPTIONS)}")
    run(
        FeetechBus.for_robot(robot),
        PtyLine(options.get("link")),
        port_file=port_file,
        log=log,
        fault=fault,
        parent_fd=parent_fd,
        wire_time=bool(options.get("wire_time", True)),
    )
