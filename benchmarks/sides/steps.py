"""Steps of an SO-101's physics: ``python -m benchmarks.sides.steps SIDE [short]``.

Through the verbs the simulation is commanded and read in turn, as fast as it answers; the physics keeps to
wall time, so that its steps a second are what one over the time step is. How many it could do, its processor
time says.
"""

from __future__ import annotations

import os
import time
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from benchmarks.house import Figures

from .common import answer

CONTROL_S = 0.02


def span_s(short: bool) -> float:
    return 1.0 if short else 5.0


def table() -> dict[str, Any]:
    robots = tomllib.loads(resources.files("strands_actors.drivers.feetech").joinpath("robots.toml").read_text())
    found: dict[str, Any] = robots["so101"]
    return found


def processor_s(pid: int) -> float:
    """User and system time of a process, all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def verbs(short: bool) -> Figures:
    from strands_actors import Robot
    from strands_actors.drivers.common.model_rows import TIMESTEP_S

    with Robot("so101") as robot:
        problem = robot.connect_eagerly()
        assert problem is None, problem
        assert robot.engine is not None
        pid = robot.engine.pid
        cycles = 0
        began_s, before_s = time.perf_counter(), processor_s(pid)
        while (passed_s := time.perf_counter() - began_s) < span_s(short):
            sent = robot.send_action({"shoulder_pan": (cycles % 40) - 20.0})
            assert sent["status"] == "success", sent
            assert robot.get_observation()
            cycles += 1
        steps = passed_s / TIMESTEP_S
        used_s = processor_s(pid) - before_s
    return {
        "steps_per_s": steps / passed_s,
        "steps_per_cpu_s": steps / used_s,
        "cycles_per_s": cycles / passed_s,
    }


def raw(short: bool) -> Figures:
    """The same model and targets, a control period at a time."""
    import mujoco

    from strands_actors.drivers.common.physics import Plant

    plant = Plant.from_table(table())
    for index in range(len(plant.joints)):
        plant.take(index, True)
    each = round(CONTROL_S / plant.model.opt.timestep)
    steps, cycles = 0, 0
    began_s, before_s = time.perf_counter(), time.process_time()
    while (passed_s := time.perf_counter() - began_s) < span_s(short):
        plant.data.ctrl[0] = ((cycles % 40) - 20.0) * 0.017
        mujoco.mj_step(plant.model, plant.data, each)
        steps += each
        cycles += 1
    return {
        "steps_per_s": steps / passed_s,
        "steps_per_cpu_s": steps / (time.process_time() - before_s),
        "cycles_per_s": cycles / passed_s,
    }


if __name__ == "__main__":
    answer({"ours": verbs, "mj_step": raw})
