"""One setpoint, hop by hop: ``python -m benchmarks.sides.hops SIDE [short]``.

An SO-101's whole tree and its twin; the clock of the host is read in the caller, the wire process and the twin.
The hops are medians, in the order of the way; ``total`` is from the call to the twin that reads the frame, ``call``
from the call to its answer.
"""

from __future__ import annotations

import itertools
import os
import statistics
import tempfile
import time
from pathlib import Path

from benchmarks.house import Figures
from strands_actors import Robot
from strands_actors.drivers import register_native_driver
from strands_actors.runtime.thread_line import ThreadLine
from strands_actors.testing import WireLog

from .common import answer, percentiles
from .hops_arm import NOTES, TimedArm, blank, passed

PERIOD_S = 0.02
ROBOT = "so101"
JOINT = "shoulder_pan"


def count(short: bool) -> int:
    return 50 if short else 500


class Stamps:
    """Of the caller's process: when the frame of a setpoint was handed to the line."""

    def __init__(self) -> None:
        self.handed = 0
        send = ThreadLine._send

        def sent(line: ThreadLine, packet: bytes) -> None:
            self.handed = time.monotonic_ns()
            send(line, packet)

        ThreadLine._send = sent  # type: ignore[method-assign,assignment]


def ours(short: bool) -> Figures:
    with tempfile.TemporaryDirectory(prefix="sa-hops-") as directory:
        notes, log = Path(directory) / "notes", Path(directory) / "twin.ndjson"
        blank(notes)
        os.environ |= {NOTES: str(notes), "STRANDS_ACTORS_TWIN_LOG": str(log)}
        register_native_driver(ROBOT, TimedArm, overwrite=True)
        stamps = Stamps()
        called: list[tuple[int, int, int]] = []
        with Robot(ROBOT, mode="real", transport="twin") as robot:
            for number in range(count(short)):
                stamps.handed, began_ns = 0, time.monotonic_ns()
                sent = robot.send_action({JOINT: (number % 3) * 2.0})
                called.append((began_ns, stamps.handed or began_ns, time.monotonic_ns()))
                assert sent["status"] == "success", sent
                time.sleep(PERIOD_S)
        rows = list(passed(notes))
        assert len(rows) == len(called), f"{len(called)} calls, {len(rows)} setpoints on the wire"
        read = [entry.t_ns for entry in WireLog(log).host("setpoint", called[0][0])]
        spans: list[list[int]] = []
        for (began, handed, returned), row in zip(called, rows, strict=True):
            seen = next(t_ns for t_ns in read if t_ns >= row.at_port)
            way = (began, handed, row.arrived, row.judged, row.taken, row.at_port, seen)
            spans.append([later - earlier for earlier, later in itertools.pairwise(way)])
            spans[-1] += [seen - began, returned - began]
    names = ("to_line", "to_wire_process", "to_driver", "to_transport", "to_port", "to_twin")
    columns = list(zip(*spans[count(short) // 10 :], strict=True))  # the first ones are cold
    hops = {f"{name}_us": statistics.median(column) / 1e3 for name, column in zip(names, columns, strict=False)}
    return hops | percentiles("total", list(columns[-2])) | percentiles("call", list(columns[-1]))


if __name__ == "__main__":
    answer({"ours": ours})
