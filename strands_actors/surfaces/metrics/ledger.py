"""Counts and histograms of each robot, from the samples of its telemetry. Pure.

A robot counts its setpoints, refusals and restarts itself, so these counts are right even if samples are lost.
Stops are counted here, from the result of the last stop: if two stops end between two samples, one is missed.
"""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.contract.shown import harmless
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import is_name
from strands_actors.surfaces.view.samples import BadSample, Health, LastStop, Presence, State, decode

SILENT_S = 1.0
"""After so long without a sample of ``state``, in seconds, a robot counts as silent. It sends ten a second."""
FORGET_S = 3600.0
"""After so long without a sample, in seconds, a robot is forgotten."""

AGES_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
STOPS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the buckets of the histograms, in seconds."""


class Histogram:
    """Counts values by bucket.

    Args:
        bounds: Upper bounds of the buckets. A last bucket without a bound has the rest.
    """

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = bounds
        self._counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def add(self, value: float) -> None:
        self._counts[bisect.bisect_left(self._bounds, value)] += 1
        self.total += value

    def buckets(self) -> list[tuple[str, float]]:
        return cumulative(self._bounds, self._counts)


def cumulative(bounds: Sequence[float], counts: Sequence[int]) -> list[tuple[str, float]]:
    """Return (upper bound, number of values up to it) of each bucket, as Prometheus has them.

    Args:
        bounds: Upper bounds of the buckets.
        counts: Number of values in each bucket, and in a last one without a bound.
    """
    below, rows = 0, []
    for bound, count in zip((*map(str, bounds), "+Inf"), counts, strict=True):
        below += count
        rows.append((bound, float(below)))
    return rows


class StopKey(NamedTuple):
    """The labels of a count of stops."""

    reason: str
    safe_state: str
    confirmed: bool


class Account:
    """The state of one robot."""

    def __init__(self) -> None:
        self.state: State | None = None
        self.presence: Presence | None = None
        self.health: Health | None = None
        self.stops: Counter[StopKey] = Counter()
        self.ages = Histogram(AGES_S)
        self.stop_times = Histogram(STOPS_S)
        self.last_at = 0.0
        """Time of the newest sample of ``state``, in the time of ``Ledger.receive``."""
        self._last_stop: LastStop | None = None

    def add_state(self, state: State, now_s: float) -> None:
        first, self.state, self.last_at = self.state is None, state, now_s
        if state.age_s >= 0:
            self.ages.add(state.age_s)
        stop, before = state.last_stop, self._last_stop
        self._last_stop = stop
        if stop is not None and stop != before and not first:
            self.stops[StopKey(stop.reason, stop.safe_state, stop.confirmed)] += 1
            self.stop_times.add(stop.took_ms / 1e3)


class Ledger:
    """The accounts of all robots."""

    def __init__(self) -> None:
        self._accounts: dict[str, Account] = {}
        self.bad_samples: Counter[tuple[str, str]] = Counter()
        """Number of samples that could not be read, by robot and topic."""

    def receive(self, received: Received, now_s: float) -> None:
        """Take a sample of ``state``, ``presence`` or ``health``.

        Args:
            received: The sample.
            now_s: The time, in seconds of any clock that does not jump.
        """
        robot, topic = received.key.split("/", 2)[1:]
        if not is_name(robot):
            return
        account = self._accounts.setdefault(robot, Account())
        try:
            match topic:
                case "state":
                    account.add_state(decode(received.payload, State), now_s)
                case "presence":
                    account.presence = decode(received.payload, Presence)
                case "health":
                    account.health = decode(received.payload, Health)
        except BadSample:
            self.bad_samples[robot, harmless(topic)] += 1

    def accounts(self, now_s: float) -> dict[str, Account]:
        """Return the account of each robot, by its name. Robots that are gone for long are forgotten."""
        self._accounts = {
            robot: account
            for robot, account in self._accounts.items()
            if account.state is None or now_s - account.last_at < FORGET_S
        }
        return dict(sorted(self._accounts.items()))
