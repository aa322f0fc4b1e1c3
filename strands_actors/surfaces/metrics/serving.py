"""Join the mesh, and serve the metrics of its robots over HTTP."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import trio
from prometheus_client import CollectorRegistry, start_http_server

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import EVENT_KEY, key
from strands_actors.surfaces.mesh.client import MeshClient

from .families import Families
from .ledger import Ledger
from .stops import StopCollector

TOPICS = ("state", "presence", "health")


async def serve(
    client: MeshClient, host: str, port: int, on_serving: Callable[[str], None], traces: str = ""
) -> None:
    """Serve the metrics of all robots on the mesh until cancelled, and send their stops as traces.

    Args:
        client: The client of the mesh.
        host: Address to listen at.
        port: The port; 0 for a free one.
        on_serving: Called with the URL once the server listens.
        traces: URL of the collector of traces; empty for no traces.

    Raises:
        OSError: The server cannot listen at this address.
    """
    ledger, lock = Ledger(), threading.Lock()
    collector = StopCollector() if traces else None

    def on_sample(received: Received) -> None:
        now_s = time.monotonic()
        with lock:
            ledger.receive(received, now_s)
        if collector is not None:
            collector.receive(received, now_s)

    registry = CollectorRegistry()
    registry.register(Families(ledger, lock))
    server, thread = start_http_server(port, host, registry)
    try:
        for topic in TOPICS:
            client.subscribe(key("*", topic), on_sample)
        on_serving(f"http://{host}:{server.server_port}/metrics")
        if collector is not None:
            from .traces import trace_stops

            client.subscribe(EVENT_KEY, lambda received: collector.receive(received, time.monotonic()))
            await trace_stops(collector, traces)
        await trio.sleep_forever()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
