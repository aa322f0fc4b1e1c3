"""Measure physics steps of a simulated SO-101: ``python -m benchmarks.sides.steps SIDE [short]``. With ``short``
the run is short.

Each call sets a target and makes the physics steps of a control period (20 ms), of a second, or of ten seconds.
SIDE is the program that is measured. ``ours`` calls ``Robot.step``. ``mj_step`` calls MuJoCo directly. ``piped``
calls MuJoCo in another process, through a socket with messages of a few bytes.
"""

from __future__ import annotations

import ctypes
import math
import os
import socket
import struct
import time
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

from benchmarks.house import Figures

from .common import answer

SIZES = {"control_period_per_s": 10, "second_per_s": 500, "ten_seconds_per_s": 5000}
"""Steps per call."""


def span_s(short: bool) -> float:
    return 0.5 if short else 3.0


def target_deg(number: int) -> float:
    return (number % 40) - 20.0


def rates(go: Callable[[int, int], None], short: bool) -> Figures:
    """Return the steps per second of each size.

    Args:
        go: Function ``go(number, steps)``. It sets the target of this number, and makes this number of steps.
        short: Run the short form.
    """
    figures: Figures = {}
    for figure, steps in SIZES.items():
        go(0, steps)
        number, began_s = 0, time.perf_counter()
        while (passed_s := time.perf_counter() - began_s) < span_s(short):
            go(number, steps)
            number += 1
        figures[figure] = number * steps / passed_s
    return figures


def table() -> dict[str, Any]:
    robots = tomllib.loads(resources.files("strands_actors.drivers.feetech").joinpath("robots.toml").read_text())
    so101: dict[str, Any] = robots["so101"]
    return so101


def verbs(short: bool) -> Figures:
    from strands_actors import Robot

    with Robot("so101") as robot:
        problem = robot.connect_eagerly()
        assert problem is None, problem

        def go(number: int, steps: int) -> None:
            stepped = robot.step(steps, {"shoulder_pan": target_deg(number)})
            assert stepped["status"] == "success", stepped

        return rates(go, short)


def armed() -> Any:
    """Return MuJoCo's model of the arm, with its motors energised. MuJoCo's internal timer stays installed; our
    simulated robots remove it.
    """
    import mujoco

    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"))
    stopwatch = ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time")
    installed = stopwatch.value

    from strands_actors.drivers.common.physics.physics import Plant

    stopwatch.value = installed
    plant = Plant.from_table(table())
    for index in range(len(plant.joints)):
        plant.energise(index, True)
    return plant


def raw(short: bool) -> Figures:
    import mujoco

    plant = armed()

    def go(number: int, steps: int) -> None:
        plant.data.ctrl[0] = math.radians(target_deg(number))
        mujoco.mj_step(plant.model, plant.data, steps)

    return rates(go, short)


REQUEST = struct.Struct("<di")


def piped(short: bool) -> Figures:
    ours, theirs = socket.socketpair()
    if os.fork() == 0:
        ours.close()
        _serve(theirs)
        os._exit(0)
    theirs.close()

    def go(number: int, steps: int) -> None:
        ours.send(REQUEST.pack(math.radians(target_deg(number)), steps))
        ours.recv(4096)

    with ours:
        return rates(go, short)


def _serve(sock: socket.socket) -> None:
    import mujoco

    plant = armed()
    while data := sock.recv(REQUEST.size):
        plant.data.ctrl[0], steps = REQUEST.unpack(data)
        mujoco.mj_step(plant.model, plant.data, steps)
        sock.send(plant.data.qpos.tobytes())


if __name__ == "__main__":
    answer({"ours": verbs, "mj_step": raw, "piped": piped})
