"""Show stops as OpenTelemetry traces, and send them to a collector.

    e-stop                      from the order to the last outcome; only of an order over the mesh
      stop so101                from the order in the robot's wire process to the result
        write the safe state    until the first frame of the safe state is written
        confirm                 until the motors have confirmed it, with an event for each axis

Another thread sends the spans. If the collector cannot be reached, spans are dropped, and nothing else waits.
"""

from __future__ import annotations

import contextlib
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence

import trio
from opentelemetry import trace
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, Resource
from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import Status, StatusCode
from opentelemetry.util.types import AttributeValue

from strands_actors.kernel.clock import NS
from strands_actors.surfaces.view.samples import SafetyEvent
from strands_actors.version import __version__

from .stops import Order, Stop, StopCollector

Attributes = dict[str, AttributeValue]

PERIOD_S = 0.25
"""Stops that are complete are shown in this period, in seconds."""
BATCH_S = 1.0
"""Spans are sent in this period, in seconds."""
SEND_S = 2.0
"""Longest time to send spans to the collector, in seconds."""
MOST_ORDERS = 64
"""So many orders are remembered. A robot with a slow stop confirms it long after the others, in the same trace."""


@contextlib.contextmanager
def sent_to(endpoint: str) -> Iterator[SpanProcessor]:
    """Send spans to a collector during the block.

    Args:
        endpoint: URL of the collector's receiver for OTLP over HTTP, such as ``http://127.0.0.1:4318/v1/traces``.
    """
    processor = BatchSpanProcessor(
        OTLPSpanExporter(endpoint, timeout=SEND_S),
        schedule_delay_millis=BATCH_S * 1e3,
        export_timeout_millis=SEND_S * 1e3,
    )
    try:
        yield processor
    finally:
        processor.shutdown()  # type: ignore[no-untyped-call]


class StopTraces:
    """Makes the spans of stops.

    Args:
        processor: Receives the spans.
    """

    def __init__(self, processor: SpanProcessor) -> None:
        resource = Resource({SERVICE_NAME: "strands-actors", SERVICE_VERSION: __version__})
        provider = TracerProvider(resource=resource, shutdown_on_exit=False)
        provider.add_span_processor(processor)
        self._tracer = provider.get_tracer("strands_actors.stops")
        self._orders: OrderedDict[Order, trace.Span] = OrderedDict()

    def add(self, stops: Sequence[Stop]) -> None:
        """Make the spans of stops by one order, or of one stop."""
        order, event = stops[0].order, stops[0].event
        parent: trace.Span | None = None
        if order is not None and event is not None:
            parent = self._orders.get(order)
            if parent is None:
                parent = self._ordered(order, event, stops)
        for stop in stops:
            self._stopped(stop, parent)

    def _ordered(self, order: Order, event: SafetyEvent, stops: Sequence[Stop]) -> trace.Span:
        # The clocks of two hosts may differ, so the time of the order may be later than the first stop.
        began_s = min(event.sent_s or event.t, *(stop.began_s for stop in stops))
        attributes: Attributes = {
            "strands.by": event.by,
            "strands.sender": order.sender,
            "strands.turn": order.turn,
            "strands.robots": [stop.robot for stop in stops],
        }
        name = "e-stop" if event.event == "estop" else event.event
        span = self._tracer.start_span(name, attributes=attributes, start_time=_ns(began_s), context=_ROOT)
        for stop in stops:
            outcome: Attributes = {"strands.robot": stop.robot, "strands.confirmed": stop.confirmed}
            answered_s = stop.event.t if stop.event is not None else stop.ended_s
            span.add_event("outcome", outcome, _ns(answered_s))
        missing = [stop.robot for stop in stops if not stop.confirmed]
        span.set_status(_status(not missing, f"not confirmed by {', '.join(missing)}"))
        span.end(_ns(max(stop.event.t if stop.event is not None else stop.ended_s for stop in stops)))
        self._orders[order] = span
        while len(self._orders) > MOST_ORDERS:
            self._orders.popitem(last=False)
        return span

    def _stopped(self, stop: Stop, parent: trace.Span | None) -> None:
        result = stop.result
        attributes: Attributes = {"strands.robot": stop.robot, "strands.confirmed": stop.confirmed}
        detail = stop.event.detail if stop.event is not None else ""
        if result is not None:
            attributes |= {
                "strands.reason": result.reason,
                "strands.safe_state": result.safe_state,
                "strands.epoch": result.epoch,
                "strands.path": result.path,
            }
            detail = detail or f"not confirmed by {', '.join(result.unconfirmed) or 'the robot'}"
        context = _ROOT if parent is None else trace.set_span_in_context(parent)
        name = f"stop {stop.robot}"
        span = self._tracer.start_span(name, context, attributes=attributes, start_time=_ns(stop.began_s))
        if result is not None:
            self._parts(stop, span)
        span.set_status(_status(stop.confirmed, detail))
        span.end(_ns(stop.ended_s))

    def _parts(self, stop: Stop, parent: trace.Span) -> None:
        assert stop.result is not None
        context = trace.set_span_in_context(parent)
        written_s = stop.began_s
        if stop.result.written_ms:
            written_s = min(stop.began_s + stop.result.written_ms / 1e3, stop.ended_s)
            written = self._tracer.start_span("write the safe state", context, start_time=_ns(stop.began_s))
            written.end(_ns(written_s))
        span = self._tracer.start_span("confirm", context, start_time=_ns(written_s))
        for axis in (*stop.axes, *(axis for axis in stop.result.unconfirmed if axis not in stop.axes)):
            is_confirmed = axis not in stop.result.unconfirmed and (stop.confirmed or bool(stop.result.unconfirmed))
            attributes: Attributes = {"strands.axis": axis, "strands.confirmed": is_confirmed}
            span.add_event("confirmed" if is_confirmed else "not confirmed", attributes, _ns(stop.ended_s))
        span.end(_ns(stop.ended_s))


async def trace_stops(collector: StopCollector, endpoint: str) -> None:
    """Send the stops of a collector as traces until cancelled. ``endpoint`` is that of ``sent_to``."""
    with sent_to(endpoint) as processor:
        traces = StopTraces(processor)
        while True:
            await trio.sleep(PERIOD_S)
            for stops in collector.take(time.monotonic()):
                traces.add(stops)


_ROOT = trace.set_span_in_context(trace.INVALID_SPAN)
"""A context without a span, so that a span in it begins a trace."""


def _ns(seconds: float) -> int:
    return round(seconds * NS)


def _status(confirmed: bool, detail: str) -> Status:
    return Status(StatusCode.OK) if confirmed else Status(StatusCode.ERROR, detail)
