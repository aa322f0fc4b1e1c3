"""The metrics with their names and labels. Each has the label ``robot``."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.intervals import BOUNDS_S
from strands_actors.supervisors.root.messages import UNREACHABLE

from .ledger import SILENT_S, Account, Ledger, cumulative

PREFIX = "strands_actors"
DASHBOARD = Path(__file__).with_name("grafana.json")
"""A dashboard for Grafana with these metrics."""

STATES = (*Mode, UNREACHABLE)


class Families(Collector):
    """Gives the metrics of a ledger to Prometheus's client. A scrape reads only the memory of this process.

    Args:
        ledger: The accounts.
        lock: Held while the ledger is read, since a scrape runs in a thread of the server.
        now_s: The clock of the samples, in seconds.
    """

    def __init__(self, ledger: Ledger, lock: threading.Lock, now_s: Callable[[], float] = time.monotonic) -> None:
        self._ledger = ledger
        self._lock = lock
        self._now_s = now_s

    def collect(self) -> Iterator[Any]:
        with self._lock:
            now_s = self._now_s()
            accounts = self._ledger.accounts(now_s)
            metrics = list(_Metrics(accounts, now_s).all())
            bad = _counter("bad_samples", "Samples of telemetry that could not be read.", "topic")
            for (robot, topic), count in self._ledger.bad_samples.items():
                bad.add_metric([robot, topic], count)
        yield from (*metrics, bad)


class _Metrics:
    def __init__(self, accounts: dict[str, Account], now_s: float) -> None:
        self._accounts = accounts
        self._now_s = now_s

    def all(self) -> Iterator[Any]:
        yield from self._of_state()
        yield from self._of_stops()
        yield from self._of_presence()
        yield from self._of_health()

    def _of_state(self) -> Iterator[Any]:
        up = _gauge("up", "1 if telemetry arrived within the last second.")
        states = StateSetMetricFamily(f"{PREFIX}_state", "The state of the robot.", labels=["robot"])
        epoch = _gauge("epoch", "Number of stops and holds since the robot was started.")
        age = _gauge("reading_age_seconds", "Age of the newest positions.")
        setpoints = _counter("setpoints", "Accepted setpoints.")
        refusals = _counter("refusals", "Refused setpoints, by the code of the refusal.", "code")
        for robot, account in self._accounts.items():
            state = account.state
            is_up = state is not None and self._now_s - account.last_at <= SILENT_S
            up.add_metric([robot], float(is_up))
            if state is None:
                continue
            setpoints.add_metric([robot], state.setpoints)
            for code, count in state.refused.items():
                refusals.add_metric([robot, code], count)
            if is_up:  # Old values would look like new ones.
                states.add_metric([robot], {str(mode): mode == state.state for mode in STATES})
                epoch.add_metric([robot], state.epoch)
                if state.age_s >= 0:
                    age.add_metric([robot], state.age_s)
        yield from (up, states, epoch, age, setpoints, refusals)

    def _of_stops(self) -> Iterator[Any]:
        stops = _counter("stops", "Stops and holds since this exporter began.", "reason", "safe_state", "confirmed")
        times = _histogram("stop_duration_seconds", "Time from the order of a stop to its confirmation.")
        ages = _histogram("observed_reading_age_seconds", "Age of the positions in the samples of telemetry.")
        for robot, account in self._accounts.items():
            for key, count in account.stops.items():
                stops.add_metric([robot, key.reason, key.safe_state, str(key.confirmed).lower()], count)
            times.add_metric([robot], account.stop_times.buckets(), account.stop_times.total)
            ages.add_metric([robot], account.ages.buckets(), account.ages.total)
        yield from (stops, times, ages)

    def _of_presence(self) -> Iterator[Any]:
        info = InfoMetricFamily(f"{PREFIX}_robot", "The type of the robot, and its host.", labels=["robot"])
        lease = InfoMetricFamily(f"{PREFIX}_lease", "The program that may move the robot.", labels=["robot"])
        locked = _gauge("locked", "1 if an e-stop locks the robot.")
        for robot, account in self._accounts.items():
            presence = account.presence
            if presence is None:
                continue
            info.add_metric([robot], {"type": presence.hw, "host": presence.hostname})
            locked.add_metric([robot], float(bool(presence.locked_by)))
            if presence.lease:
                lease.add_metric([robot], {"holder": presence.lease})
        yield from (info, lease, locked)

    def _of_health(self) -> Iterator[Any]:
        connected = _gauge("connected", "1 if the wire process has a link to the robot.")
        faults = _gauge("faulty_axes", "Number of axes that report a fault.")
        writes = _counter("wire_writes", "Setpoints that were written to the wire.")
        reads = _counter("wire_reads", "Readings from the wire.")
        restarts = _counter("process_restarts", "Restarts of the robot's processes.", "process")
        commands = _counter("mesh_commands", "Commands that arrived over the mesh.")
        refused = _counter("mesh_commands_refused", "Commands that arrived over the mesh and were refused.")
        intervals = _histogram("setpoint_interval_seconds", "Time between two accepted setpoints of a stream.")
        gaps = _counter("recorder_gaps", "Gaps in recordings, because a recorder was too slow.")
        missed = _counter("recorder_missed_events", "Events that are missing in recordings because of such gaps.")
        for robot, account in self._accounts.items():
            health = account.health
            if health is None:
                continue
            connected.add_metric([robot], float(health.connected))
            faults.add_metric([robot], len(health.faults))
            writes.add_metric([robot], health.writes)
            reads.add_metric([robot], health.reads)
            for process, count in health.restarts.items():
                restarts.add_metric([robot, process], count)
            commands.add_metric([robot], health.counts.get("commands", 0))
            refused.add_metric([robot], health.counts.get("commands_refused", 0))
            if len(health.setpoint_intervals) == len(BOUNDS_S) + 1:
                buckets = cumulative(BOUNDS_S, health.setpoint_intervals)
                intervals.add_metric([robot], buckets, health.setpoint_intervals_s)
            gaps.add_metric([robot], health.counts.get("recorder_gaps", 0))
            missed.add_metric([robot], health.counts.get("recorder_missed", 0))
        yield from (intervals, gaps, missed)
        yield from (connected, faults, writes, reads, restarts, commands, refused)


def _gauge(name: str, about: str) -> Any:
    return GaugeMetricFamily(f"{PREFIX}_{name}", about, labels=["robot"])


def _counter(name: str, about: str, *labels: str) -> Any:
    return CounterMetricFamily(f"{PREFIX}_{name}", about, labels=["robot", *labels])


def _histogram(name: str, about: str) -> Any:
    return HistogramMetricFamily(f"{PREFIX}_{name}", about, labels=["robot"])
