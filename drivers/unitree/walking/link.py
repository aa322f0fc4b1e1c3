"""One participant on the network of a robot that walks by its onboard controller: requests out,
states in. Wire and stop channel are made of it.

``send`` leaves at once. ``until`` takes in what has arrived until something is true.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.stamps import Stamps
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.link import FIND_S, Network, Service
from strands_actors.kernel.clock import Clock

from .dialect import Dialect, Order
from .odometry import Odometry
from .robots import dialect_of
from .states import STATE_TYPE, SportState, decode_state

LOOK_S = 0.002
"""How often ``until`` looks."""
ASK_EVERY_NS = 50_000_000
"""How often a robot that does not tell its mode by itself is asked for it."""
SPEED_NS = 600_000_000
"""A robot that tells no speed within so long tells none [assumed]."""


class WalkingLink(Network):
    """Raise ``WireDown`` when the sockets cannot be had."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        assert config.model.walks is not None
        self.where = config.port
        self.dialect: Dialect = dialect_of(config.model.walks)
        self.sport = Service(self.participant, config.model.service, clock)
        self.gait: SportState | None = None
        """What it does, as it said last."""
        self.gait_ns = 0
        """When the newest came whose stamp had changed; 0: none yet."""
        self.answered: dict[Order, int] = {}
        """Requests that were answered, with yes or no, and when the newest of those was made."""
        self.refused: dict[Order, str] = {}
        """Requests whose last answer says no, and why."""
        self._stamps = Stamps()
        self._odometry = Odometry()  # of a robot that is asked for its mode
        self._asked_ns = 0
        self._followed_ns = 0
        self._newest: tuple[bytes, bytes, int] | None = None
        """A LowState, not decoded yet, who wrote it, and when it came."""

    def follow(self) -> None:
        """Hear what the onboard controller does, from now on."""
        if not self._followed_ns:
            self._followed_ns = max(1, self.clock.now_ns())
            if self.dialect.state_topic:
                self.participant.reader(self.dialect.state_topic, STATE_TYPE, self._on_gait)

    @property
    def tells_no_speed(self) -> bool:
        """Return whether the robot was given time to tell its speed, and has never done so."""
        waited_ns = self.clock.now_ns() - self._followed_ns
        return not self._odometry.tells_speed and bool(self._followed_ns) and waited_ns >= SPEED_NS

    def send(self, order: Order) -> bool:
        """Make a request. Return whether it left for a service that knows us."""
        self.sport.ask(order.api, partial(self._hear, order), order.parameter)
        return self.sport.matched

    def send_stop(self, order: Order) -> bool:
        """As ``send``, to a robot that says that it has gone, too."""
        self.sport.ask(order.api, partial(self._hear, order), order.parameter, stop=True)
        return self.sport.takes_stops

    def is_in(self, modes: Collection[int]) -> bool:
        """Return whether the robot has told that it is in one of these modes."""
        return self.gait is not None and self.gait.mode in modes

    def poll(self) -> None:
        super().poll()
        if self._followed_ns and self.dialect.ask_mode:
            self._ask_state(self.clock.now_ns())
        newest, self._newest = self._newest, None
        if newest is not None:
            payload, writer, t_ns = newest
            super()._on_state(memoryview(payload), writer, t_ns)

    async def until(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Return whether it has become true in time."""
        with trio.move_on_after(within_s):
            while True:
                self.poll()
                if condition():
                    return True
                await trio.sleep(LOOK_S)
        return False

    async def find(self, where: str) -> None:
        """Return when the robot's service hears us. Raise ``WireDown``."""
        if not await self.until(lambda: self.sport.matched, FIND_S):
            raise WireDown(f"{where}: there is no service {self.sport.name}. Check port= and domain=")

    def _ask_state(self, now_ns: int) -> None:
        if now_ns - self._asked_ns < ASK_EVERY_NS:
            return
        self._asked_ns = now_ns
        self.sport.ask(self.dialect.ask_mode, self._on_mode)
        if self.dialect.ask_odometry:
            self.sport.ask(self.dialect.ask_odometry, self._on_pose)

    # -- what is heard

    def _hear(self, order: Order, response: rpc.Response) -> None:
        if response.id < self.answered.get(order, 0):
            return
        self.answered[order] = response.id
        if response.why:
            self.refused[order] = response.why
        else:
            self.refused.pop(order, None)

    def _on_state(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        """500 come a second, and one in ten of them is looked at."""
        self._newest = bytes(payload), bytes(writer), t_ns

    def _on_gait(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # one that cannot be read is none: the one before it grows old
            gait = decode_state(payload[4:])
            if not self._stamps.take(gait.stamp_ns, t_ns):
                return
            if self.dialect.ask_mode:
                if self._stamps.goes_on:
                    self._odometry.take_state(gait, t_ns)
                    self._show()
                return
            self.gait = gait
            if self._stamps.goes_on:
                self.gait_ns = t_ns

    def _on_mode(self, response: rpc.Response) -> None:
        if not response.why:
            self._odometry.take_mode(rpc.fsm_id(response), response.id)
            self._show()

    def _on_pose(self, response: rpc.Response) -> None:
        if not response.why:
            self._odometry.take_pose(rpc.odometry(response), response.id)
            self._show()

    def _show(self) -> None:
        self.gait, self.gait_ns = self._odometry.state(), self._odometry.stamp_ns
