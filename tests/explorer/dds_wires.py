"""Name the wires on DDS that the kit of ``twin_robot.py`` models: driver, twin, and what moves it.

A robot counts its frames when its participant reads a datagram, so a frame belongs to the sender of the newest one.
"""

from __future__ import annotations

import itertools
import uuid
from collections.abc import Sequence
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from strands_actors.contract.driver import Driver
from strands_actors.drivers.booster import link as booster_link
from strands_actors.drivers.booster.robots import TABLES as BOOSTERS
from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.booster.twin import onboard as booster_onboard
from strands_actors.drivers.booster.twin import server as booster_server
from strands_actors.drivers.common.rtps.wire_types import discovery_port, user_port
from strands_actors.drivers.common.twin import dds
from tests.memory_udp import Datagram

from .children import SimOs
from .datagram_robot import TICK_S, NetworkRobot
from .legs import HOST, OURS, Legs, WorldClock
from .robot_model import Actions, Seam, replaced
from .udp_network import UdpNetwork
from .world import World

participant: Any = import_module("strands_actors.drivers.common.rtps.participant")
STEP_RAD = 0.002


class Gestures:
    """Actions with a unique angle of the first joint, while the second one swings. Both begin at home."""

    def __init__(self, driver: Driver, home_rad: Sequence[float]) -> None:
        self._axes = [(axis.key, rad) for axis, rad in zip(driver.table, home_rad, strict=False)]
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        (mark, mark_rad), (swing, swing_rad) = self._axes[:2]
        turn_rad = abs((STEP_RAD * self._given + 0.2) % 0.8 - 0.4) - 0.2
        return {mark: mark_rad + 1e-5 * self._given, swing: swing_rad + turn_rad}


class StandingBody(Legs):
    """A body that stays where it stands while it walks."""

    def carry(self, vx: float, vy: float, vyaw: float, passed_s: float) -> None:
        """Do nothing: only the twist is observed."""


class UpperBody(NetworkRobot):
    """RTPS with requests: a Booster T1. It follows commands while the host has its arms, and while it walks."""

    PORT = f"{HOST}:7410"
    DRIVER = "strands_actors.drivers.booster.driver:BoosterDriver"
    FIRST = (("enable_upper_body", {}),)
    MARK = "left_shoulder_pitch"
    SETTLE_S = 9.0
    TIMED = (booster_server, dds)

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.network = UdpNetwork(world, HOST, lambda *which: (discovery_port(*which), user_port(*which)))
        self.stalled = False
        self._numbers = itertools.count(1)
        self._ticks = 0
        self._unnoted: list[tuple[str, str | None, str, float]] = []
        world.after(0.0, self._tick)

    def make_twin(self) -> None:
        model = model_of(self.robot)
        self._home_rad = BOOSTERS.table(self.robot)["home_rad"]
        body = StandingBody(self._home_rad, [(motor.torque, motor.speed) for motor in model.motors])
        options = booster_server.BoosterTwinOptions(host=HOST)
        with replaced(booster_onboard, "body_of", lambda _: body):
            self.server = booster_server.BoosterServer(model, self, options)  # type: ignore[arg-type]
        self.server.clock = WorldClock(self.world)  # type: ignore[assignment]

    def actions(self) -> Actions:
        first = self.driver.table[0].id
        return Gestures(self.driver, self._home_rad[first:])

    def seams(self) -> tuple[Seam, ...]:
        ids = SimpleNamespace(uuid4=lambda: uuid.UUID(int=next(self._numbers)))
        return (
            *super().seams(),
            (participant, "open_sockets", self.network.open_sockets),
            (participant, "os", SimOs(self.world)),
            (booster_link, "own_address", lambda host: OURS),
            (booster_link, "uuid", ids),
        )

    @property
    def follows_commands(self) -> bool:
        onboard = self.server.onboard
        return onboard.host_has_arms or any(onboard.twist)

    def pass_time(self) -> None:
        self.server.advance(self.world.now_s)

    def switch_off_and_on(self) -> None:
        self.server.power_cycle()

    # -- the log of the twin

    def write(self, t_ns: int, sender: str, frames: Any, safe_state: str | None = None) -> None:
        if sender != "host":
            return
        datagram = self._sockets()[1].newest
        for kind, _ in frames:
            # A frame to the base alone brings the robot to no safe state while the host has the arms.
            if kind == "safe" and not safe_state:
                continue
            if kind == "setpoint" and self._is_of_a_stop(datagram):
                continue
            self._unnoted.append((kind, safe_state, datagram.role, datagram.left_s))

    def _is_of_a_stop(self, datagram: Datagram) -> bool:
        """Return whether the sender has begun a stop since its last setpoint. The twin logs a hold as a setpoint if
        the request to stand, which precedes it, has not arrived yet."""
        role, left_s = datagram.role, datagram.left_s
        return self._writes.since(role, left_s) <= self._stops.since(role, left_s)

    # -- the robot's end

    def _tick(self) -> None:
        if self.server.participant is None:
            self.server.plug()
            for sock in self._sockets():
                sock.on_arrival = self._poll
        if not self.stalled:
            self._poll()
            self.pass_time()
            self._ticks += 1
            self.server.send_due(self._ticks, self.server.clock.now_ns())
            self.look()
        self.world.after(TICK_S, self._tick)

    def _poll(self) -> None:
        if not self.stalled and self.server.participant is not None:
            self.server.participant.poll()
            # The twin logs a frame before it carries it out.
            unnoted, self._unnoted = self._unnoted, []
            for frame in unnoted:
                self.note_frame(*frame)
            self.look()

    def _sockets(self) -> list[Any]:
        return [sock for (host, _), sock in sorted(self.network.sockets.items()) if host == HOST]
