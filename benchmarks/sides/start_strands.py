"""Measure the import of strands-robots in its environment: ``python -m benchmarks.sides.start_strands [short]``."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys

STATEMENT = "from strands_robots import Robot"
TIMED = f"import time; began = time.perf_counter(); {STATEMENT}; print(time.perf_counter() - began)"


def imported(short: bool) -> dict[str, float]:
    """Return the median time of the import over several new processes.

    The first process is left out, because it may have compiled byte code.
    """
    spans_s = [
        float(subprocess.check_output([sys.executable, "-c", TIMED], text=True).splitlines()[-1])
        for _ in range(3 if short else 9)
    ][1:]
    return {"import_ms": statistics.median(spans_s) * 1e3}


if __name__ == "__main__":
    print(json.dumps(imported("short" in sys.argv[1:])))
