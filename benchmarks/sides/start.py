"""The time of the import and of a robot's start: ``python -m benchmarks.sides.start SIDE [short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.

Each import runs in a new process with compiled byte code. The time is that of the import alone, without the
interpreter's start. ``armed`` is the time from the constructor until a status shows that the robot's motors are
energised.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from typing import Any

from benchmarks.house import Figures

from .common import answer

TIMED = "import time; began = time.perf_counter(); {}; print(time.perf_counter() - began)"


def imported(statement: str, short: bool) -> Figures:
    """Return the median time of an import statement, in ms, over several new processes."""
    spans_s = [
        float(subprocess.check_output([sys.executable, "-c", TIMED.format(statement)], text=True))
        for _ in range(3 if short else 9)
    ][1:]  # without the first one, which may have compiled the byte code
    return {"import_ms": statistics.median(spans_s) * 1e3}


def armed(short: bool, **options: Any) -> float:
    from strands_actors import Robot

    spans_s = []
    for _ in range(1 if short else 3):
        began_s = time.perf_counter()
        robot = Robot("so101", **options)
        try:
            problem = robot.connect_eagerly()
            if problem is not None:
                raise RuntimeError(problem)
            answer = robot.get_status()["content"][0]["json"]
            if answer["state"] != "armed":
                raise RuntimeError(f"the robot is not armed after connecting: its state is {answer['state']}")
            spans_s.append(time.perf_counter() - began_s)
        finally:
            robot.cleanup()
    return statistics.median(spans_s) * 1e3


def ours(short: bool) -> Figures:
    return imported("from strands_actors import Robot", short) | {
        "armed_ms": armed(short),
        "armed_on_wire_ms": armed(short, mode="real", transport="twin"),
    }


def parts(short: bool) -> Figures:
    return imported("import trio, msgspec", short)


if __name__ == "__main__":
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # as on a computer where it is installed
    answer({"ours": ours, "trio and msgspec": parts})
