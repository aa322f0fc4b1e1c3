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

from .sport import Dialect, Order, dialect_of
from .states import STATE_TOPIC, STATE_TYPE, SportState, decode_state

LOOK_S = 0.002
"""How often ``until`` looks."""


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
        """Requests that were done, and when the newest of those was made."""
        self.refused: dict[Order, str] = {}
        """Requests whose last answer says no, and why."""
        self._stamps = Stamps()
        self._newest: tuple[bytes, bytes, int] | None = None
        """A LowState, not decoded yet, who wrote it, and when it came."""
        self._follows = False

    def follow(self) -> None:
        """Hear what the onboard controller does, from now on."""
        if not self._follows:
            self._follows = True
            self.participant.reader(STATE_TOPIC, STATE_TYPE, self._on_gait)

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

    # -- what is heard

    def _hear(self, order: Order, response: rpc.Response) -> None:
        if response.why:
            self.refused[order] = response.why
            return
        self.refused.pop(order, None)
        self.answered[order] = max(response.id, self.answered.get(order, 0))

    def _on_state(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        """500 come a second, and one in ten of them is looked at."""
        self._newest = bytes(payload), bytes(writer), t_ns

    def _on_gait(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # one that cannot be read is none: the one before it grows old
            gait = decode_state(payload[4:])
            if self._stamps.take(gait.stamp_ns, t_ns):
                self.gait = gait
                if self._stamps.goes_on:
                    self.gait_ns = t_ns
