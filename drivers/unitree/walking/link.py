"""One DDS participant for a robot that walks by its onboard controller. It sends requests and receives states.

The wire process and the stop channel each have one. ``send`` does not wait. ``until`` handles received data until a
condition is true.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.link import FIND_S, Network, Service
from strands_actors.kernel.clock import Clock

from .dialect import Dialect, Order
from .odometry import Odometry
from .robots import dialect_of
from .states import STATE_TYPE, SportState, decode_state

LOOK_S = 0.002
"""Period in which ``until`` handles received data, in seconds."""
ASK_EVERY_NS = 50_000_000
"""Period of requests for the mode, if the robot does not publish it."""
SPEED_NS = 600_000_000
"""If a robot has reported no speed within this time, it has no odometry [assumed]."""


class WalkingLink(Network):
    """The connection to a walking robot. Its constructor raises ``WireDown`` if the sockets cannot be opened."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        assert config.model.walks is not None
        self.address = config.port
        self.dialect: Dialect = dialect_of(config.model.walks)
        self.sport = Service(self.participant, config.model.service, clock)
        self.gait: SportState | None = None
        """The newest state of the onboard controller."""
        self.gait_ns = 0
        """Time at which the newest state with a new time stamp arrived. 0 if there was no such state."""
        self.answered: dict[Order, int] = {}
        """Answered requests, with success or failure -> the time at which the newest such request was sent."""
        self.refused: dict[Order, str] = {}
        """Requests that the robot has refused in its last answer -> the reason."""
        self._stamps = Stamps()
        self._odometry = Odometry()  # Used only for a robot that reports its mode and its pose separately.
        self._requested_ns = 0
        self._followed_ns = 0
        self._newest: tuple[bytes, bytes, int] | None = None
        """The newest LowState, undecoded, with its writer and its time."""

    def follow(self) -> None:
        """Subscribe to the states of the onboard controller. Further calls do nothing."""
        if not self._followed_ns:
            self._followed_ns = max(1, self.clock.now_ns())
            if self.dialect.state_topic:
                self.participant.reader(self.dialect.state_topic, STATE_TYPE, self._on_gait)

    @property
    def reports_no_speed(self) -> bool:
        """True if the robot has never reported its speed, although ``SPEED_NS`` have passed since ``follow``."""
        waited_ns = self.clock.now_ns() - self._followed_ns
        return not self._odometry.reports_speed and bool(self._followed_ns) and waited_ns >= SPEED_NS

    def send(self, order: Order) -> bool:
        """Send a request. Return True if the robot's service is connected and can receive it."""
        self.sport.ask(order.api, partial(self._hear, order), order.parameter)
        return self.sport.matched

    def send_stop(self, order: Order) -> bool:
        """Send a request as ``send`` does, but also to a service that has announced its end."""
        self.sport.ask(order.api, partial(self._hear, order), order.parameter, stop=True)
        return self.sport.takes_stops

    def is_in(self, modes: Collection[int]) -> bool:
        """Return True if the robot's last reported mode is one of ``modes``."""
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
        """Handle received data until the condition is true. Return False if it is not true within ``within_s``."""
        with trio.move_on_after(within_s):
            while True:
                self.poll()
                if condition():
                    return True
                await trio.sleep(LOOK_S)
        return False

    async def find(self, address: str) -> None:
        """Wait until DDS has connected us to the robot's service.

        Raises:
            WireDown: The service was not found within ``FIND_S``.
        """
        if not await self.until(lambda: self.sport.matched, FIND_S):
            raise WireDown(f"{address}: the robot has no service {self.sport.name}. Check port= and domain=")

    def _ask_state(self, now_ns: int) -> None:
        if now_ns - self._requested_ns < ASK_EVERY_NS:
            return
        self._requested_ns = now_ns
        self.sport.ask(self.dialect.ask_mode, self._on_mode)
        if self.dialect.ask_odometry:
            self.sport.ask(self.dialect.ask_odometry, self._on_pose)

    # -- handle received answers and states

    def _hear(self, order: Order, response: rpc.Response) -> None:
        if response.id < self.answered.get(order, 0):
            return
        self.answered[order] = response.id
        if response.error:
            self.refused[order] = response.error
        else:
            self.refused.pop(order, None)

    def _on_state(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        """Keep only the newest LowState, undecoded. 500 arrive per second, and ``poll`` decodes about one in
        ten."""
        self._newest = bytes(payload), bytes(writer), t_ns

    def _on_gait(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # Ignore an unreadable state. The gates notice if the last one gets too old.
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
        if not response.error:
            self._odometry.take_mode(rpc.fsm_id(response), response.id)
            self._show()

    def _on_pose(self, response: rpc.Response) -> None:
        if not response.error:
            self._odometry.take_pose(rpc.odometry(response), response.id)
            self._show()

    def _show(self) -> None:
        self.gait, self.gait_ns = self._odometry.state(), self._odometry.stamp_ns
