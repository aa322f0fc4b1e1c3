"""Name the wires with JSON messages that the kit of ``twin_robot.py`` models: driver, twin, and what moves it."""

from __future__ import annotations

import itertools
import uuid
from types import SimpleNamespace

from strands_actors.drivers.common.twin.http import HttpSession
from strands_actors.drivers.common.twin.tcp import Handler
from strands_actors.drivers.common.twin.websocket import serving_both
from strands_actors.drivers.microduck import link as duck_link
from strands_actors.drivers.microduck import twin as duck_twin
from strands_actors.drivers.microduck.robots import TWIST
from strands_actors.drivers.reachy import twin as reachy_twin

from .robot_model import Actions, Seam
from .service_robot import SpreadActions
from .session_arm import SlowActions
from .stream_robot import StreamRobot

WALKS = 0.5
"""Share of the speed of a duck on rollers that is allowed to one that walks."""


class WalkActions(SpreadActions):
    """Twists without the axes of the body."""

    def next(self, far: bool) -> dict[str, float]:
        return {key: WALKS * value for key, value in super().next(far).items() if key in TWIST}


class Duck(StreamRobot):
    """JSON-RPC on unix sockets: a Microduck. Its faults are those of a connection through ssh."""

    PORT = "/no/such/robotd.sock"
    DRIVER = "strands_actors.drivers.microduck.driver:Microduck"
    FIRST = (("enable", {}),)
    MARK = "vx"
    SETTLE_S = 9.0  # a stop tries for 2 s on each of two connections
    OPENERS = ((duck_link, "open_unix"),)
    TIMED = (duck_twin,)

    def make_twin(self) -> None:
        self.twin = duck_twin.DuckTwin(self.robot, self.now_s)

    def handler(self) -> Handler:
        return duck_twin.serving(self.twin)

    def actions(self) -> Actions:
        return WalkActions(self.driver, self.world.rng("actions"))

    @property
    def follows_commands(self) -> bool:
        return any(self.twin.body.requested)

    def pass_time(self) -> None:
        self.twin.body.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()


class DeskRobot(StreamRobot):
    """HTTP and WebSocket: a Reachy Mini. It follows commands from a target, a move or the tracking of a face until
    the next stop, although it holds its last target after both."""

    PORT = "192.0.2.18"
    DRIVER = "strands_actors.drivers.reachy.driver:Reachy"
    MARK = "head_roll"
    SETTLE_S = 9.0  # a stop tries for 1.7 s

    def make_twin(self) -> None:
        self.twin = reachy_twin.ReachyTwin(self.robot, self.now_s)
        self._numbers = itertools.count()
        self._follows_target = False

    def handler(self) -> Handler:
        return serving_both(lambda: HttpSession(self.twin), self.twin.choose)

    def actions(self) -> Actions:
        return SlowActions(self.world.rng("actions"), self.MARK, "head_yaw", "head_pitch", unit=60.0, far=0.25)

    def seams(self) -> tuple[Seam, ...]:
        ids = SimpleNamespace(uuid4=lambda: uuid.UUID(int=next(self._numbers)))
        return (*super().seams(), (reachy_twin, "uuid", ids))

    @property
    def follows_commands(self) -> bool:
        return self._follows_target or self.twin.body.move is not None or self.twin.tracking

    def note_frame(self, kind: str, safe_state: str | None, role: str, left_s: float) -> None:
        if kind in ("setpoint", "safe"):
            self._follows_target = kind == "setpoint"
        super().note_frame(kind, safe_state, role, left_s)

    def pass_time(self) -> None:
        self.twin.body.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()
        self._follows_target = False
