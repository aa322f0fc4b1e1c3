"""Model robots behind a service, which differ from a position arm on a private bus.

They are a base that keeps its last velocity, a drone that lands, and an arm that answers after 300 ms.
The drivers, wires and stop channels are those of ``fake_kinds``. Their robot is replaced by one that records
when it is energised. Its service can be slow or out of reach.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import ClassVar

from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.contract.safe_state import SafeState
from tests import fake_kinds
from tests.fake_kinds import LANDING_S, FakeBase, FakeDrone, FakeHttp, Peer, Sent

from .plan import Event
from .robot_model import Effect, Frame, RobotModel, Seam, put
from .world import World

GOLDEN = 0.6180339887498949
SLOW_S = 0.4
EMPTY_PCT = 5.0
ALL = frozenset({1})
"""A robot behind a service is energised as a whole."""


class SpreadActions:
    """Draws actions.

    The first axis gets a value that is unique to each action and spread over its range. If the
    caller asks for ``far``, the other velocity axes get random values.
    """

    def __init__(self, driver: Driver, rng: random.Random) -> None:
        self._axes = driver.table
        self._rng = rng
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        first, *others = self._axes
        size = (first.high - first.low) / 2
        quick = first.mode is AxisMode.VELOCITY
        # The gate refuses a position that leaps too far.
        share = (GOLDEN * self._given) % 1.0 if quick else 0.5 + 0.00002 * self._given
        action = {first.key: first.low + size * (0.1 + 1.8 * share)}
        if far:
            action |= {axis.key: self._rng.uniform(axis.low, axis.high) for axis in others if quick}
        return action


class NotingPeer(Peer):
    """Records the frames that it receives. Requests arrive at once; a slow service delays the answers."""

    def __init__(self, model: ServiceRobot, answer_s: float, height_m: float) -> None:
        self._model = model
        self._on = False
        super().__init__(len(model.driver.table), answer_s=answer_s, height_m=height_m)

    @property
    def motors_on(self) -> bool:
        return self._on

    @motors_on.setter
    def motors_on(self, on: bool) -> None:
        if on:
            self._model.note("enable", "", self.last_values, ALL)
        elif self._on:
            self._model.log_energised(frozenset())
        self._on = on

    def take(self, t_ns: int, kind: str, values: Sequence[float], safe_state: str = "", path: str = "wire") -> None:
        world = self._model.world
        if not self.reachable:
            world.note("wire", "loses", f"{world.current.role}: {kind} {safe_state}")
            return
        before, energised = self.last_values, self._leaves(kind, safe_state)
        self.sent.append(Sent(t_ns, kind, tuple(values), safe_state, path))
        self._on = self._on and bool(energised or safe_state not in (SafeState.OFF, SafeState.LAND))
        self._model.note(kind, safe_state, before, energised)

    def _leaves(self, kind: str, safe_state: str) -> frozenset[int]:
        """Return the motors that are energised after a frame."""
        if kind == "setpoint":
            return ALL
        lands = safe_state == SafeState.LAND and self.height_m > 0
        if lands:
            self._model.world.after(LANDING_S, self._land)
        return self._model.energised_log[-1][1] if lands or safe_state == SafeState.HOLD else frozenset()

    def _land(self) -> None:
        """Land by the drone's own controller, whether or not a client is still alive."""
        self.height_m = 0.0
        self.motors_on = False


class ServiceRobot(RobotModel):
    PORT = "explored.example:80"
    KEEPS_TORQUE_BY_RESUME = False
    DRIVER: ClassVar[type[Driver]]
    PEER: ClassVar[type[NotingPeer]] = NotingPeer
    HEIGHT_M: ClassVar[float] = 0.0

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.driver_class = self.DRIVER
        self.driver = self.make_driver(self.DRIVER)
        self._motors = {axis.key: at for at, axis in enumerate(self.driver.table, 1)}
        velocities = (axis for axis in self.driver.table if axis.mode is AxisMode.VELOCITY)
        self.rest = {self._motors[axis.key]: axis.rest for axis in velocities}
        self.rng = world.rng("service")
        self.peer = self.PEER(self, self.driver.config.answer_s, self.HEIGHT_M)

    def note(
        self,
        kind: str,
        safe_state: str,
        before: Sequence[float],
        energised: frozenset[int],
        role: str = "",
        left_s: float = 0.0,
    ) -> None:
        """Log a frame that the robot received.

        Args:
            role: The process that sent it; empty for the present process.
            left_s: When it was sent; 0 for now.
        """
        now_s, was = self.world.now_s, self.energised_log[-1][1]
        role, left_s = role or self.world.current.role, left_s or now_s
        goals, earlier = _numbered(self.peer.last_values), _numbered(before)
        self.frames.append(
            Frame(now_s, left_s, role, kind, str(safe_state), goals, earlier, {}, earlier, was, energised)
        )
        self.log_energised(energised)
        self.world.note("wire", role, f"{kind} {safe_state} {goals}")

    def actions(self) -> SpreadActions:
        return SpreadActions(self.driver, self.world.rng("actions"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        return self._motors[key], value

    def marks(self, key: str) -> bool:
        return self._motors[key] == 1

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """A velocity goes to its rest. A position keeps its goal."""
        axis = self.driver.table[motor - 1]
        stays = axis.rest if axis.mode is AxisMode.VELOCITY else frame.before[motor]
        return stays, stays

    def seams(self) -> tuple[Seam, ...]:
        return ((fake_kinds, "PEERS", {self.PORT: self.peer}),)

    def effect(self, event: Event) -> Effect | None:
        peer = self.peer
        match event.kind:
            case "slow service":
                return put(peer, "answer_s", SLOW_S, self.driver.config.answer_s)
            case "out of reach":
                return put(peer, "reachable", False, True)
            case "low battery":
                return put(peer, "battery_pct", EMPTY_PCT, 100.0)
        return None

    def mend(self) -> None:
        self.peer.answer_s, self.peer.reachable = self.driver.config.answer_s, True
        self.peer.battery_pct = 100.0


class Base(ServiceRobot):
    DRIVER = FakeBase


class Drone(ServiceRobot):
    """A drone that flies from the beginning of the run."""

    DRIVER = FakeDrone
    HEIGHT_M = 1.0
    SETTLE_S = 9.0  # a landing takes 2 s, and may be tried twice


class SlowArm(ServiceRobot):
    DRIVER = FakeHttp


def _numbered(values: Sequence[float]) -> Mapping[int, float]:
    return dict(enumerate(values, 1))
