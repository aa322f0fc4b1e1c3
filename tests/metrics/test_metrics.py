"""Prometheus's own parser reads the metrics of running robots."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
import urllib.request
from collections.abc import Iterable
from typing import Any

import msgspec
import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.gate.intervals import BOUNDS_S
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.metrics.families import DASHBOARD, Families
from strands_actors.surfaces.metrics.ledger import FORGET_S, SILENT_S, Ledger
from tests.cli.command import Command, RobotProcess

PATIENCE_S = 30.0
OPEN_METRICS = "application/openmetrics-text; version=1.0.0"

Values = dict[str, list[tuple[dict[str, str], float]]]


def values_of(families: Iterable[Metric]) -> Values:
    values: Values = {}
    for family in families:
        for sample in family.samples:
            values.setdefault(sample.name, []).append((sample.labels, sample.value))
    return values


def value(values: Values, name: str, **labels: str) -> float | None:
    for found, number in values.get(name, []):
        if found == labels:
            return number
    return None


class Exporter:
    """A ledger with the metrics that a scrape gets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.ledger = Ledger()
        self._registry = CollectorRegistry()
        self._registry.register(Families(self.ledger, threading.Lock(), lambda: self.now_s))

    def send(self, topic: str, robot: str = "arm", **fields: Any) -> None:
        usual: dict[str, dict[str, Any]] = {
            "state": {"peer_id": robot, "t": 1.0, "state": "armed", "epoch": 1},
            "presence": {"robot_id": robot, "timestamp": 1.0, "hw": "so101", "hostname": "here"},
            "health": {"peer_id": robot, "t": 1.0, "ok": True, "connected": True},
        }
        payload = msgspec.json.encode(usual[topic] | fields)
        self.ledger.receive(Received(f"strands/{robot}/{topic}", payload, "application/json", None), self.now_s)

    def scrape(self) -> Values:
        return values_of(text_string_to_metric_families(generate_latest(self._registry).decode()))


def test_counts_and_states_are_in_the_scrape() -> None:
    exporter = Exporter()
    exporter.send("state", setpoints=7, refused={"past_travel": 2}, age_s=0.004)
    exporter.send("presence", lease='a "script"\n', locked_by="me")
    exporter.send("health", writes=9, restarts={"wire": 1}, faults={"a": "hot"}, counts={"commands": 3})
    values = exporter.scrape()
    assert value(values, "strands_actors_up", robot="arm") == 1
    assert value(values, "strands_actors_setpoints_total", robot="arm") == 7
    assert value(values, "strands_actors_refusals_total", robot="arm", code="past_travel") == 2
    assert value(values, "strands_actors_state", robot="arm", strands_actors_state="armed") == 1
    assert value(values, "strands_actors_state", robot="arm", strands_actors_state="holding") == 0
    assert value(values, "strands_actors_reading_age_seconds", robot="arm") == 0.004
    assert value(values, "strands_actors_lease_info", robot="arm", holder='a "script"\n') == 1
    assert value(values, "strands_actors_robot_info", robot="arm", type="so101", host="here") == 1
    assert value(values, "strands_actors_locked", robot="arm") == 1
    assert value(values, "strands_actors_process_restarts_total", robot="arm", process="wire") == 1
    assert value(values, "strands_actors_faulty_axes", robot="arm") == 1
    assert value(values, "strands_actors_wire_writes_total", robot="arm") == 9
    assert value(values, "strands_actors_mesh_commands_total", robot="arm") == 3


def test_intervals_of_setpoints_and_gaps_of_recorders_are_in_the_scrape() -> None:
    exporter = Exporter()
    counts = [0] * (len(BOUNDS_S) + 1)
    counts[BOUNDS_S.index(0.02)], counts[-1] = 3, 1
    gaps = {"recorder_gaps": 2, "recorder_missed": 70}
    exporter.send("health", setpoint_intervals=counts, setpoint_intervals_s=1.5, counts=gaps)
    exporter.send("health", robot="old")
    values = exporter.scrape()
    name = "strands_actors_setpoint_interval_seconds"
    buckets = {found["le"]: number for found, number in values[f"{name}_bucket"]}
    assert (buckets["0.016"], buckets["0.02"], buckets["0.5"], buckets["+Inf"]) == (0, 3, 3, 4)
    assert value(values, f"{name}_sum", robot="arm") == 1.5
    assert value(values, f"{name}_sum", robot="old") is None, "an older robot does not measure them"
    assert value(values, "strands_actors_recorder_gaps_total", robot="arm") == 2
    assert value(values, "strands_actors_recorder_missed_events_total", robot="arm") == 70


def test_stops_are_counted_from_the_beginning_of_the_exporter() -> None:
    exporter = Exporter()
    stop = {"epoch": 1, "reason": "stop", "safe_state": "limp", "confirmed": True, "took_ms": 4.0}
    exporter.send("state", last_stop=stop)
    assert "strands_actors_stops_total" not in exporter.scrape()
    for epoch, took_ms in ((2, 4.0), (3, 90.0)):
        for _ in range(2):
            exporter.send("state", last_stop=stop | {"epoch": epoch, "took_ms": took_ms})
    exporter.send("state", last_stop=stop | {"epoch": 4, "confirmed": False, "took_ms": 7000.0})
    values = exporter.scrape()
    labels = {"robot": "arm", "reason": "stop", "safe_state": "limp"}
    assert value(values, "strands_actors_stops_total", **labels, confirmed="true") == 2
    assert value(values, "strands_actors_stops_total", **labels, confirmed="false") == 1
    buckets = {found["le"]: number for found, number in values["strands_actors_stop_duration_seconds_bucket"]}
    assert (buckets["0.002"], buckets["0.005"], buckets["0.1"], buckets["5.0"], buckets["+Inf"]) == (0, 1, 2, 2, 3)
    assert value(values, "strands_actors_stop_duration_seconds_sum", robot="arm") == pytest.approx(7.094)


def test_a_silent_robot_is_down_and_later_forgotten() -> None:
    exporter = Exporter()
    exporter.send("state", setpoints=7)
    exporter.now_s += SILENT_S + 0.1
    values = exporter.scrape()
    assert value(values, "strands_actors_up", robot="arm") == 0
    assert value(values, "strands_actors_setpoints_total", robot="arm") == 7
    assert "strands_actors_state" not in values
    exporter.now_s += FORGET_S
    assert "strands_actors_up" not in exporter.scrape()


def test_bad_samples_are_counted_and_bad_names_are_left_out() -> None:
    exporter = Exporter()
    exporter.send("state", epoch="x")
    exporter.send("state", robot="a b")
    values = exporter.scrape()
    assert value(values, "strands_actors_bad_samples_total", robot="arm", topic="state") == 1
    assert [labels["robot"] for labels, _ in values["strands_actors_up"]] == ["arm"]


def test_the_dashboard_asks_for_metrics_that_exist() -> None:
    exporter = Exporter()
    exporter.send("state")
    names = {family.name for family in Families(exporter.ledger, threading.Lock(), lambda: 100.0).collect()}
    expressions = [
        target["expr"] for panel in json.loads(DASHBOARD.read_text())["panels"] for target in panel["targets"]
    ]
    asked = {name for text in expressions for name in re.findall(r"strands_actors_\w+(?=\{robot)", text)}
    assert len(asked) >= 10
    assert {re.sub(r"_(total|bucket|info)$", "", name) for name in asked} <= names


def test_a_port_in_use_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert run(["metrics", "--port", str(taken.getsockname()[1])]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and "Give another --port" in printed.err and printed.err.count("\n") == 1


def test_the_metrics_of_a_running_robot_are_served(cli: Command, robot: RobotProcess) -> None:
    with cli.start("metrics", "--port", "0", "--json") as process:
        try:
            assert process.stdout is not None
            facts = json.loads(process.stdout.readline())

            def scraped() -> Values:
                request = urllib.request.Request(facts["url"], headers={"Accept": OPEN_METRICS})
                with urllib.request.urlopen(request, timeout=PATIENCE_S) as response:
                    assert response.headers["Content-Type"].startswith("application/openmetrics-text")
                    return values_of(text_string_to_metric_families(response.read().decode()))

            def until(name: str, least: float, **labels: str) -> None:
                deadline = time.monotonic() + PATIENCE_S
                while (value(scraped(), name, robot="so101", **labels) or 0.0) < least:
                    assert time.monotonic() < deadline, (name, labels, scraped())
                    time.sleep(0.05)

            until("strands_actors_up", 1)
            assert robot.call("send_action", {"shoulder_pan": 5.0})["status"] == "success"
            assert robot.call("send_action", {"shoulder_pan": 400.0})["status"] == "error"
            until("strands_actors_setpoints_total", 1)
            until("strands_actors_refusals_total", 1, code="past_travel")
            assert cli.run("estop", "so101").returncode == 0
            until("strands_actors_stops_total", 1, reason="estop", safe_state="limp", confirmed="true")
            until("strands_actors_stop_duration_seconds_count", 1)
            until("strands_actors_wire_reads_total", 1)
            assert value(scraped(), "strands_actors_process_restarts_total", robot="so101", process="wire") == 0
            process.terminate()
            assert process.wait(20) == 0
        finally:
            process.kill()
