"""A robot that acknowledges a power-on at once and carries it out later, from a queue.

No later request empties the queue, and a stop is carried out at once. So a stop can come while a
power-on is queued. The motors are then off at the stop, and are switched on after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import trio

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.contract.driver import Driver, Reason, Service, Timing
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation, Permit, WireDown
from tests import fake_kinds

from .service_robot import ALL, NotingPeer, ServiceRobot

QUEUE_S = 0.3
"""Longest time that a request waits in the queue."""
LOOK_S = 0.01
FASTEST = 0.5


class QueueWire(fake_kinds.KindWire):
    async def arm(self, permit: Permit) -> Observation:
        await self._switch_on(permit)
        self._sample = sample = await self._ask()
        return sample

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any]:
        await self._switch_on(permit)
        return {"on": True}

    async def _switch_on(self, permit: Permit) -> None:
        """Request power, and wait until it is on. Raise ``WireDown`` if it does not come on."""
        peer: Any = self._peer
        await self._ask()
        permit.check()
        peer.queue_power()
        with trio.move_on_after(2 * QUEUE_S):
            while not peer.motors_on:  # noqa: ASYNC110  # there is no event for it
                await trio.sleep(LOOK_S)
            return
        raise WireDown("the motors do not switch on. Look at the robot")


class FakeQueue(fake_kinds._Kind):
    """Continues its last command without end, as ``FakeBase`` does."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("fake_queue",)
    WIRE: ClassVar[str] = "tests.explorer.queued_robot:QueueWire"
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "power_on": Service("switch the motors on", within_s=1.0, powers=True, in_motion=True, late_s=QUEUE_S)
    }
    PARTS = (
        Part(
            PartKind.BASE,
            tuple(
                Axis(key=key, unit="m/s", low=-FASTEST, high=FASTEST, mode=AxisMode.VELOCITY)
                for key in ("vx", "vy")
            ),
        ),
    )
    timing = Timing(
        control_hz=20.0, keepalive_s=0.05, stream_ttl_s=0.3, oneshot_ttl_s=0.3, state_ttl_s=0.5, late_s=QUEUE_S
    )
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.OFF)


class QueuePeer(NotingPeer):
    def queue_power(self) -> None:
        """Queue a request for power, and switch the motors on later."""
        world = self._model.world
        if not self.reachable:
            return
        role, left_s = world.current.role, world.now_s
        world.note("wire", role, "asks for power")
        world.after(QUEUE_S * self._model.rng.random(), lambda: self._switch_on(role, left_s))

    def _switch_on(self, role: str, left_s: float) -> None:
        self._on = True
        self._model.note("enable", "", self.last_values, ALL, role, left_s)


class QueuedRobot(ServiceRobot):
    DRIVER: ClassVar[type[Driver]] = FakeQueue
    PEER: ClassVar[type[NotingPeer]] = QueuePeer
