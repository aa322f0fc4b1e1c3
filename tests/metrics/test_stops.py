"""OpenTelemetry's own exporters get the stops of robots as traces."""

from __future__ import annotations

import http.server
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import StatusCode

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.metrics.stops import GRACE_S, StopCollector
from strands_actors.surfaces.metrics.traces import StopTraces
from tests.cli.command import Command, RobotProcess

PATIENCE_S = 30.0
AXES = ("pan", "lift")
STOP = {
    "epoch": 2,
    "reason": "estop",
    "safe_state": "limp",
    "confirmed": True,
    "took_ms": 4.0,
    "written_ms": 1.0,
    "path": "wire",
}
RESULT = {"outcome": "safe", "safe_state": "limp", "epoch": 2, "took_ms": 4.0}
ORDER = {"event": "estop", "by": "me", "sender": "desk", "turn": "7", "sent_s": 999.99}


class Spans:
    """A collector of stops, and the spans that are made of them."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.collector = StopCollector()
        self._exporter = InMemorySpanExporter()
        self._traces = StopTraces(SimpleSpanProcessor(self._exporter))

    def send(self, key: str, **fields: Any) -> None:
        received = Received(f"strands/{key}", msgspec.json.encode(fields), "application/json", None)
        self.collector.receive(received, self.now_s)

    def state(self, robot: str = "arm", t: float = 1000.05, ago_s: float = 0.05, **fields: Any) -> None:
        self.send(
            f"{robot}/state",
            **{"peer_id": robot, "t": t, "state": "disarmed", "epoch": 2, "last_stop_ago_s": ago_s} | fields,
        )

    def event(self, robot: str = "arm", **fields: Any) -> None:
        self.send("safety/event", **{"peer_id": robot, "t": 1000.001} | fields)

    def take(self) -> dict[str, ReadableSpan]:
        self.now_s += GRACE_S
        for stops in self.collector.take(self.now_s):
            self._traces.add(stops)
        spans = self._exporter.get_finished_spans()
        self._exporter.clear()
        return {span.name: span for span in spans}


@pytest.fixture
def spans() -> Spans:
    spans = Spans()
    for robot in ("arm", "leg"):
        fields = {"robot_id": robot, "timestamp": 1.0, "hw": "so101", "action_keys": AXES}
        spans.send(f"{robot}/presence", **fields)
        spans.state(robot)
    return spans


def times(span: ReadableSpan) -> tuple[float, float]:
    assert span.start_time is not None and span.end_time is not None
    return span.start_time / 1e9, span.end_time / 1e9


def events(span: ReadableSpan) -> dict[object, str]:
    return {(event.attributes or {})["strands.axis"]: event.name for event in span.events}


def parent_of(span: ReadableSpan) -> int | None:
    return None if span.parent is None else span.parent.span_id


def test_a_stop_without_an_order_is_a_trace_with_its_frames_and_confirmations(spans: Spans) -> None:
    for _ in range(2):
        spans.state(last_stop=STOP | {"reason": "writer", "safe_state": "hold"})
    made = spans.take()
    assert set(made) == {"stop arm", "write the safe state", "confirm"}
    stop, written, confirmed = made["stop arm"], made["write the safe state"], made["confirm"]
    assert stop.parent is None and parent_of(written) == parent_of(confirmed) == stop.context.span_id
    assert times(stop) == pytest.approx((999.996, 1000.0))
    assert times(written) == pytest.approx((999.996, 999.997))
    assert times(confirmed) == pytest.approx((999.997, 1000.0))
    assert events(confirmed) == {"pan": "confirmed", "lift": "confirmed"}
    assert stop.status.status_code is StatusCode.OK
    assert stop.attributes is not None and stop.attributes["strands.reason"] == "writer"
    assert spans.take() == {}, "it is shown once"


def test_one_order_for_several_robots_is_one_trace(spans: Spans) -> None:
    spans.event("arm", **ORDER, **RESULT)
    spans.state("arm", last_stop=STOP)
    spans.state("leg", last_stop=STOP | {"confirmed": False, "unconfirmed": ["lift"]})
    spans.event("leg", t=1000.2, **ORDER, **RESULT | {"outcome": "unconfirmed"})
    made = spans.take()
    order, arm, leg = made["e-stop"], made["stop arm"], made["stop leg"]
    assert order.parent is None and parent_of(arm) == parent_of(leg) == order.context.span_id
    assert times(order) == pytest.approx((999.99, 1000.2))
    assert [event.name for event in order.events] == ["outcome", "outcome"]
    assert order.attributes is not None and order.attributes["strands.by"] == "me"
    assert arm.status.status_code is StatusCode.OK
    assert order.status.status_code is leg.status.status_code is StatusCode.ERROR
    assert leg.status.description == "not confirmed by lift"
    assert events(made["confirm"]) == {"pan": "confirmed", "lift": "not confirmed"}


def test_a_robot_that_confirms_later_is_in_the_trace_of_its_order(spans: Spans) -> None:
    spans.event("arm", **ORDER, **RESULT)
    spans.state("arm", last_stop=STOP)
    order = spans.take()["e-stop"]
    spans.event("leg", t=1009.0, **ORDER, **RESULT | {"took_ms": 9000.0})
    spans.state("leg", t=1009.1, ago_s=0.1, last_stop=STOP | {"took_ms": 9000.0})
    late = spans.take()
    assert "e-stop" not in late
    assert parent_of(late["stop leg"]) == order.context.span_id


def test_a_stop_that_no_process_answered_is_an_error(spans: Spans) -> None:
    spans.event("arm", **ORDER, outcome="unconfirmed", detail="no process answers")
    made = spans.take()
    assert set(made) == {"e-stop", "stop arm"}
    assert made["stop arm"].status.description == "no process answers"


def test_bad_messages_and_stops_before_the_first_sample_are_left_out(spans: Spans) -> None:
    spans.state("new", last_stop=STOP)
    spans.state("a b", last_stop=STOP)
    spans.send("arm/state", last_stop=3)
    spans.send("safety/event", peer_id="arm", t=-1.0, event="estop", outcome="safe")
    spans.event("arm", event="state", state="disarmed")
    spans.event("a b", **ORDER, **RESULT)
    assert spans.take() == {}


def test_a_collector_that_is_no_url_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["metrics", "--traces", "localhost:4318"]) == 2
    assert "http://127.0.0.1:4318/v1/traces" in capsys.readouterr().err


@contextmanager
def otlp_server() -> Iterator[tuple[str, list[Any]]]:
    """Receive spans as a collector does. Yield its URL, and the list of the spans."""
    spans: list[Any] = []

    class Receiver(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            if self.headers.get("Content-Encoding") == "gzip":
                raise ValueError("the test does not expect compression")
            for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
                for scope in resource.scope_spans:
                    spans.extend(scope.spans)
            self.send_response(200)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Receiver) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/v1/traces", spans
        finally:
            server.shutdown()
            thread.join()


def test_the_estop_of_a_running_robot_reaches_a_collector(cli: Command, robot: RobotProcess) -> None:
    with otlp_server() as (url, spans), cli.start("metrics", "--port", "0", "--traces", url, "--json") as process:
        try:
            assert process.stdout is not None
            json.loads(process.stdout.readline())
            assert robot.call("send_action", {"shoulder_pan": 5.0})["status"] == "success"
            deadline = time.monotonic() + PATIENCE_S
            while not any(span.name == "e-stop" for span in spans):
                assert time.monotonic() < deadline, [span.name for span in spans]
                assert cli.run("estop", "so101").returncode == 0
                time.sleep(2 * GRACE_S)
            process.terminate()
            assert process.wait(20) == 0
            order = next(span for span in spans if span.name == "e-stop")
            of_order = {span.name: span for span in spans if span.trace_id == order.trace_id}
            assert set(of_order) == {"e-stop", "stop so101", "write the safe state", "confirm"}
            confirmed = of_order["confirm"]
            assert {event.name for event in confirmed.events} == {"confirmed"} and len(confirmed.events) == 6
            written, stop = of_order["write the safe state"], of_order["stop so101"]
            assert order.start_time_unix_nano <= stop.start_time_unix_nano == written.start_time_unix_nano
            assert written.start_time_unix_nano < written.end_time_unix_nano <= confirmed.end_time_unix_nano
        finally:
            process.kill()
