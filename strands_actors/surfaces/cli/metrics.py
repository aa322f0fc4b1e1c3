"""``metrics``: serve the metrics of the running robots for Prometheus."""

from __future__ import annotations

import json
from pathlib import Path

import trio

from strands_actors.contract.extras import require
from strands_actors.surfaces.metrics.stops import problem_of_collector

from .errors import Problem
from .until_signal import mesh_until_signal


def metrics(host: str, port: int, traces: str, mesh: Path | None, as_json: bool) -> None:
    """Serve the metrics until Ctrl-C.

    Raises:
        Problem: The server cannot listen at this address, or ``traces`` is not a URL.
    """
    require("metrics", "metrics")
    if traces:
        require("otel", "metrics --traces")
        if problem := problem_of_collector(traces):
            raise Problem(f"--traces: {problem}")
    trio.run(_serve, host, port, traces, mesh, as_json)


async def _serve(host: str, port: int, traces: str, mesh: Path | None, as_json: bool) -> None:
    from strands_actors.surfaces.metrics.families import DASHBOARD
    from strands_actors.surfaces.metrics.serving import serve

    def on_serving(url: str) -> None:
        facts = {"url": url, "dashboard": str(DASHBOARD)}
        lines = f"metrics of all robots: {url}; Ctrl-C ends this\na dashboard for Grafana: {DASHBOARD}"
        lines += f"\nstops are sent as traces to {traces}" if traces else ""
        print(json.dumps(facts) if as_json else lines, flush=True)

    async with mesh_until_signal(mesh) as client:
        try:
            await serve(client, host, port, on_serving, traces)
        except OSError as error:
            reason, where = error.strerror or error, f"{host}:{port}"
            raise Problem(f"metrics: no server can listen at {where} ({reason}). Give another --port") from error
