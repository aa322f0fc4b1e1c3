"""Collect what robots publish about a stop, until the stop can be shown as a trace. Pure: no clock, no I/O.

The topic ``state`` has the result of the last stop. The topic ``strands/safety/event`` has the sender of an order
that came over the mesh. A stop is complete ``GRACE_S`` after the first of the two, since the other follows within a
period of ``state``. The stops of several robots by one order, such as an e-stop for all
robots, have the same ``Order``.
"""

from __future__ import annotations

import contextlib
from urllib.parse import urlsplit

import msgspec

from strands_actors.contract.shown import shown
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import EVENT_KEY, is_name
from strands_actors.surfaces.view.samples import BadSample, LastStop, Presence, SafetyEvent, State, decode

GRACE_S = 1.0
"""A stop is shown so long after it was received first, in seconds."""

ORDERS = ("stop", "estop")
"""The events that are results of a stop."""


def problem_of_collector(url: str) -> str:
    """Return why traces cannot be sent to ``url``; empty if they can."""
    parts = urlsplit(url)
    if parts.scheme in ("http", "https") and parts.hostname:
        return ""
    return f"{shown(url)} is no URL of a collector. Give one such as http://127.0.0.1:4318/v1/traces"


class Order(msgspec.Struct, frozen=True):
    """An order that came over the mesh. ``sender`` and ``turn`` identify it."""

    sender: str
    turn: str


class Stop(msgspec.Struct):
    """A stop of one robot. Times are wall-clock times in seconds.

    Attributes:
        robot: Name of the robot.
        received_s: Time at which it was received first, in the time of ``StopCollector``.
        result: The robot's result; None if only the event arrived.
        ended_s: End of the stop.
        axes: The axes of the robot; empty if they are not known.
        event: The event of the order; None if the order did not come over the mesh.
    """

    robot: str
    received_s: float
    result: LastStop | None = None
    ended_s: float = 0.0
    axes: tuple[str, ...] = ()
    event: SafetyEvent | None = None

    @property
    def order(self) -> Order | None:
        """The order that came over the mesh; None without one, or if it cannot be identified."""
        event = self.event
        return Order(event.sender, event.turn) if event is not None and event.sender and event.turn else None

    @property
    def confirmed(self) -> bool:
        if self.result is not None:
            return self.result.confirmed
        return self.event is not None and self.event.outcome == "safe"

    @property
    def began_s(self) -> float:
        """Time at which the robot's wire process, or its stop channel, got the order."""
        took_ms = self.result.took_ms if self.result is not None else self.event.took_ms if self.event else 0.0
        return self.ended_s - took_ms / 1e3


class StopCollector:
    """Collects the stops of all robots."""

    def __init__(self) -> None:
        self._last: dict[str, LastStop | None] = {}
        self._axes: dict[str, tuple[str, ...]] = {}
        self._open: dict[tuple[str, int], Stop] = {}

    def receive(self, received: Received, now_s: float) -> None:
        """Take a sample of ``state`` or ``presence``, or an event. One that cannot be read is ignored, since the
        metrics count it.

        Args:
            received: The message.
            now_s: The time, in seconds of any clock that does not jump.
        """
        with contextlib.suppress(BadSample):
            if received.key == EVENT_KEY:
                self._event(decode(received.payload, SafetyEvent), now_s)
                return
            robot, topic = received.key.split("/", 2)[1:]
            if not is_name(robot):
                return
            if topic == "state":
                self._state(robot, decode(received.payload, State), now_s)
            elif topic == "presence":
                self._axes[robot] = decode(received.payload, Presence).action_keys

    def _state(self, robot: str, sample: State, now_s: float) -> None:
        is_first, last, self._last[robot] = robot not in self._last, self._last.get(robot), sample.last_stop
        # A stop before the first sample may have ended long ago.
        if sample.last_stop is None or is_first or sample.last_stop == last:
            return
        stop = self._stop(robot, sample.last_stop.epoch, now_s)
        stop.result = sample.last_stop
        stop.ended_s = sample.t - max(0.0, sample.last_stop_ago_s)

    def _event(self, event: SafetyEvent, now_s: float) -> None:
        if event.event not in ORDERS or not event.outcome or not is_name(event.peer_id):
            return
        stop = self._stop(event.peer_id, event.epoch, now_s)
        stop.event = event
        stop.ended_s = stop.ended_s or event.t

    def _stop(self, robot: str, epoch: int, now_s: float) -> Stop:
        return self._open.setdefault((robot, epoch), Stop(robot, now_s))

    def take(self, now_s: float) -> list[list[Stop]]:
        """Return the stops that are complete, and forget them. Stops by the same order are in one list."""
        due = {key: stop for key, stop in self._open.items() if now_s - stop.received_s >= GRACE_S}
        groups: dict[Order | tuple[str, int], list[Stop]] = {}
        for key, stop in due.items():
            del self._open[key]
            stop.axes = self._axes.get(stop.robot, ())
            groups.setdefault(stop.order or key, []).append(stop)
        return list(groups.values())
