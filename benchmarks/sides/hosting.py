"""``hosting LENGTH``: measure the processor time of a host and of its metrics. LENGTH is ``short`` or ``long``.

The host keeps simulated SO-101 arms, which publish their states 10 times a second. The metrics are collected once a
second, as Prometheus may be set up to do. The figures are percent of one core.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from benchmarks.stage import COMMAND, at_home
from strands_actors.surfaces.host.messages import Verb
from strands_actors.surfaces.host.orders import order

from .wire import processor_s

SIZES = {"short": (2, 3.0), "long": (12, 30.0)}
"""Number of robots, and seconds."""
SETTLE_S = 10.0
COLLECT_S = 1.0
PATIENCE_S = 30.0
ARM = '[robot.arm{number:02}]\ntype = "so101"\ntransport = "twin"\n'


def child_of(parent: int, word: str) -> int:
    """Return the process id of the child whose command line has this word."""
    for path in Path("/proc").glob("[0-9]*"):
        try:
            is_child = int((path / "stat").read_text().rpartition(")")[2].split()[1]) == parent
            command = (path / "cmdline").read_text()
        except OSError:
            continue
        if is_child and word in command:
            return int(path.name)
    raise SystemExit(f"the host has no process for {word}")


def url_of_metrics() -> str:
    """Wait until the host serves the metrics, and return their address."""
    end_s = time.monotonic() + PATIENCE_S
    while not (url := order(Verb.STATUS).services["metrics"].address):
        if time.monotonic() > end_s:
            raise SystemExit("the host does not serve the metrics")
        time.sleep(0.1)
    return url


def collect(url: str, seconds: float) -> None:
    """Collect the metrics once a second."""
    end_s = time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        with urllib.request.urlopen(url) as answer:
            answer.read()
        time.sleep(min(left_s, COLLECT_S))


def main(length: str) -> None:
    robots, seconds = SIZES[length]
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        file = Path(directory, "fleet.toml")
        arms = "".join(ARM.format(number=number) for number in range(robots))
        file.write_text(f'[host]\nmetrics = "127.0.0.1:0"\n{arms}')
        arguments = [sys.executable, "-c", COMMAND, "up", str(file), "--json"]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as host:
            try:
                assert host.stdout is not None
                facts = json.loads(host.stdout.readline())
                up = sum(robot["phase"] == "up" for robot in facts["robots"])
                if up != robots:
                    raise SystemExit(f"{up} of {robots} robots are up: {facts}")
                url = url_of_metrics()
                time.sleep(SETTLE_S)
                pids = {"host": host.pid, "metrics": child_of(host.pid, "metrics")}
                before = {name: processor_s(pid) for name, pid in pids.items()}
                began_s = time.monotonic()
                collect(url, seconds)
                took_s = time.monotonic() - began_s
                figures = {
                    f"{name}_pct": 100 * (processor_s(pid) - before[name]) / took_s for name, pid in pids.items()
                }
            finally:
                host.terminate()
                host.wait()
    print(json.dumps({**figures, "together_pct": sum(figures.values())}), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
