"""``metrics``: serve the metrics of the running robots for Prometheus."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.contract.extras import require
from strands_actors.surfaces.mesh.client import open_mesh

from .errors import Problem
from .orders import configuration


def metrics(host: str, port: int, mesh: Path | None, as_json: bool) -> None:
    """Serve the metrics until Ctrl-C.

    Raises:
        Problem: The server cannot listen at this address.
    """
    require("metrics", "metrics")
    trio.run(_serve, host, port, mesh, as_json)


async def _serve(host: str, port: int, mesh: Path | None, as_json: bool) -> None:
    from strands_actors.surfaces.metrics.families import DASHBOARD
    from strands_actors.surfaces.metrics.serving import serve

    def on_serving(url: str) -> None:
        facts = {"url": url, "dashboard": str(DASHBOARD)}
        lines = f"metrics of all robots: {url}; Ctrl-C ends this\na dashboard for Grafana: {DASHBOARD}"
        print(json.dumps(facts) if as_json else lines, flush=True)

    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with open_mesh(configuration(mesh)) as client, open_background() as nursery:
            ended = trio.CancelScope()

            async def listen() -> None:
                async for _ in signals:
                    ended.cancel()

            nursery.start_soon(listen)
            with ended:
                try:
                    await serve(client, host, port, on_serving)
                except OSError as error:
                    reason = error.strerror or error
                    where = f"{host}:{port}"
                    raise Problem(
                        f"metrics: no server can listen at {where} ({reason}). Give another --port"
                    ) from error
