"""Simulate the HTTP service of the vendor's SDK process, with a rover behind it.

As the real service, it confirms a command when it has accepted it, and reports latitude 1000 without a GPS fix.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.common.physics.stepped import DrawnBody
from strands_actors.drivers.common.twin import (
    Fault,
    NetworkOptions,
    TcpServer,
    TwinRobot,
    WireLog,
    main_of,
)
from strands_actors.drivers.common.twin.http import Answer, serving
from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p
from .mechanism import Rover
from .robots import TABLES


class RoverTwinOptions(NetworkOptions, frozen=True):
    watchdog_s: Annotated[
        float | None,
        option("seconds without a command after which the SDK process sends zero; 0: never; None: the robot's"),
    ] = None
    fix: Annotated[bool, option("whether the rover has a GPS fix")] = True
    rear: Annotated[bool, option("whether it has a rear camera")] = True


_HOME_DEG = 22.75, 114.09
_M_PER_DEG = 111_320.0
_PICTURE = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDACgcHiMeGSgjISMtKygwPGRBPDc3PHtYXUlkkYCZlo+AjIqgtObDoKrarYqMyP/L2u71"
    "////m8H////6/+b9//j/wAALCAAYACABAREA/8QAFgABAQEAAAAAAAAAAAAAAAAABQAE/8QAFBABAAAAAAAAAAAAAAAAAAAAAP/a"
    "AAgBAQAAPwDUHMB0YDmEHMB3/9k="
)
"""A chessboard of 32 x 24 pixels, in grey."""


REQUESTS: Modelled[str] = Modelled(
    "requests to the SDK process",
    {
        f"POST {p.CONTROL}": "drives, turns, and switches the lamp; status 400 without a command",
        f"POST {p.SPEAK}": "keeps the text, which nobody hears; status 400 without a text",
        f"GET {p.DATA}": "returns battery, position, speed and the readings of the sensors",
        "GET /v2/front": "returns a picture of a chessboard",
        "GET /v2/rear": "returns a picture of a chessboard; status 404 without a rear camera",
    },
    "status 404, not found",
)
MODELLED = (REQUESTS,)


class RoverTwin(TwinRobot):
    """The simulated HTTP service. All clients control the same rover."""

    def __init__(
        self,
        table: Mapping[str, Any],
        now_s: Callable[[], float] = time.monotonic,
        *,
        watchdog_s: float | None = None,
        fix: bool = True,
        rear: bool = True,
    ) -> None:
        super().__init__()
        watchdog = float(table["watchdog_s"]) if watchdog_s is None else float(watchdog_s)
        self.rover = Rover(table, watchdog, now_s)
        self.body = RoverBody(self.rover, table)
        self._fix = fix
        self._rear = rear
        self._stuck: bytes | None = None
        self.spoken = ""
        """The last text to speak."""

    def begin_fault(self, fault: Fault) -> None:
        self.rover.pass_time()
        self._stuck = self.data() if fault is Fault.STUCK else None
        self.rover.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        self.rover.reset()

    def answer(self, request: Request) -> Answer:
        self.rover.pass_time()
        if f"{request.method} {request.target}" not in REQUESTS:
            return Answer(p.NOT_FOUND, b'{"detail":"Not Found"}', "other")
        match request.method, request.target:
            case "POST", p.CONTROL:
                return self._control(request.body)
            case "POST", p.SPEAK:
                return self._speak(request.body)
            case "GET", p.DATA:
                return Answer(p.OK, self._stuck or self.data())
        return self._picture(request.target.removeprefix("/v2/"))

    def _control(self, body: bytes) -> Answer:
        try:
            command = p.decode_command(body)
        except MalformedFrame:
            command = None
        if command is None:
            return Answer(p.BAD_REQUEST, b'{"detail":"Command not provided"}', "other")
        linear, angular, lamp = (finite(command.get(name, 0)) or 0.0 for name in ("linear", "angular", "lamp"))
        self.rover.tell(linear, angular, lamp, Commander.WIRE if linear or angular else Commander.NONE)
        message_type, safe_state = ("safe", "zero") if p.is_stop(command) else ("setpoint", None)
        return Answer(p.OK, b'{"message":"Command sent successfully"}', message_type, safe_state)

    def _speak(self, body: bytes) -> Answer:
        try:
            text = p.decode_text(body)
        except MalformedFrame:
            text = ""
        if not text:
            return Answer(p.BAD_REQUEST, b'{"detail":"Text not provided"}', "other")
        self.spoken = text
        return Answer(p.OK, b'{"message":"Speech sent to rover"}', "other")

    def _picture(self, view: str) -> Answer:
        if view == "rear" and not self._rear:
            return Answer(p.NOT_FOUND, b'{"detail":"Rear camera is not available"}')
        picture = {f"{view}_frame": base64.b64encode(_PICTURE).decode(), "timestamp": self.rover.time_s}
        return Answer(p.OK, msgspec.json.encode(picture))

    def data(self) -> bytes:
        """Return the present answer to ``GET /data``."""
        rover = self.rover
        stamp = rover.reported_s
        speed = rover.reported_speed + (0.5 if self.faults.of(None) is Fault.WRONG else 0.0)
        latitude, longitude = _HOME_DEG if self._fix else (1000.0, 1000.0)
        if self._fix:
            latitude, longitude = latitude + rover.y_m / _M_PER_DEG, longitude + rover.x_m / _M_PER_DEG
        return msgspec.json.encode(
            {
                "battery": 88,
                "signal_level": 5,
                "orientation": round(rover.reported_heading_deg) % 360,
                "lamp": int(rover.lamp >= p.LIT),
                "speed": round(speed, 3),
                "gps_signal": 30.0 if self._fix else 0.0,
                "latitude": latitude,
                "longitude": longitude,
                "vibration": 0.0,
                "timestamp": stamp,
                "accels": [[0.0, 0.0, 1.0, stamp]],
                "gyros": [[0.0, 0.0, 0.0, stamp]],
                "mags": [[0.0, 0.0, 0.0, stamp]],
                "rpms": [[*(round(rpm) for rpm in rover.reported_rpms), stamp]],
            }
        )


class RoverBody(DrawnBody):
    """The rover as a body that a simulation can drive. While a client of the wire protocol drives it, commands of
    the simulation are ignored."""

    axes = ("linear", "angular", "lamp")

    def __init__(self, rover: Rover, table: Mapping[str, Any]) -> None:
        super().__init__(table, rover)
        self._rover = rover

    @property
    def commanders(self) -> Sequence[Commander]:
        return (self._rover.commander,) * len(self.axes)

    def felt(self) -> Felt:
        return self._felt((*self._rover.commanded, self._rover.lamp))

    def pose(self) -> Sequence[float]:
        return [self._rover.x_m, self._rover.y_m, self._rover.yaw_rad]

    def energise(self, on: bool) -> None:
        rover = self._rover
        if rover.commander is (Commander.NONE if on else Commander.SIM):
            rover.tell(0.0, 0.0, rover.lamp, Commander.SIM if on else Commander.NONE)

    def set_targets(self, values: Sequence[float]) -> None:
        if self._rover.commander is Commander.SIM:
            linear, angular, lamp = values
            self._rover.tell(linear, angular, lamp, Commander.SIM)

    def hold(self) -> None:
        self.set_targets((0.0, 0.0, self._rover.lamp))

    def reset(self) -> None:
        self._rover.reset()


def twin_of(robot: str, now_s: Callable[[], float] = time.monotonic, **options: Any) -> RoverTwin:
    """Return the simulated service of a robot of ``robots.toml``. ``options`` are the fields of
    ``RoverTwinOptions`` except host and port."""
    return RoverTwin(TABLES.table(robot), now_s, **options)


def build(robot: str, options: RoverTwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = twin_of(robot, watchdog_s=options.watchdog_s, fix=options.fix, rear=options.rear)
    return TcpServer(twin, {options.port: serving(twin)}, log, options.host)


main = main_of(RoverTwinOptions, build)
