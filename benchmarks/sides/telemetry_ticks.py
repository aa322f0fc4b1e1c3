"""``telemetry_ticks LENGTH``: measure the processor time of two idle processes for each robot.

LENGTH is ``short`` or ``long`` (1 or 6 s). Each robot has two processes here, each with a trio loop that wakes 100
times per second. In this package the processes ``wire`` and ``root`` wake as often, to watch each other. There are
as many robots as in the first steps of ``telemetry``. ``robots_per_core`` is the number that a whole core could
run if it did nothing else.
"""

from __future__ import annotations

import json
import subprocess
import sys

from .legs_bare import share_of_ticks

PERIOD_S = 0.01
SECONDS = {"short": 1.0, "long": 6.0}
ROBOTS = 8


def main(length: str) -> None:
    command = [sys.executable, "-m", "benchmarks.sides.telemetry_ticks", "one", str(SECONDS[length])]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2 * ROBOTS)]
    share = sum(float(process.communicate()[0]) for process in processes) / ROBOTS
    print(json.dumps({"cpu_per_robot_pct": 100 * share, "robots_per_core": 1 / share}), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "one":
        print(share_of_ticks(PERIOD_S, float(sys.argv[2])), flush=True)
    else:
        main(sys.argv[1])
