"""Steps of an SO-101's physics: ``python -m benchmarks.sides.steps SIDE [short]``.

The arm is sent somewhere and the physics steps, in turn: a control period (20 ms), a second, ten seconds at a time.
Through the verbs that is ``send_action`` and ``step``.
"""

from __future__ import annotations

import math
import time
import tomllib
from collections.abc import Callable
from importlib import resources
from typing import Any

from benchmarks.house import Figures

from .common import answer

SIZES = {"control_period_per_s": 10, "second_per_s": 500, "ten_seconds_per_s": 5000}
"""Steps at a time."""


def span_s(short: bool) -> float:
    return 0.5 if short else 3.0


def target_deg(number: int) -> float:
    return (number % 40) - 20.0


def rates(go: Callable[[int, int], None], short: bool) -> Figures:
    """``go(number, steps)``: to another target, and so many steps."""
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
    found: dict[str, Any] = robots["so101"]
    return found


def verbs(short: bool) -> Figures:
    from strands_actors import Robot

    with Robot("so101") as robot:
        problem = robot.connect_eagerly()
        assert problem is None, problem

        def go(number: int, steps: int) -> None:
            sent = robot.send_action({"shoulder_pan": target_deg(number)})
            stepped = robot.step(steps)
            assert sent["status"] == stepped["status"] == "success", (sent, stepped)

        return rates(go, short)


def raw(short: bool) -> Figures:
    """The same model and targets."""
    import mujoco

    from strands_actors.drivers.common.physics import Plant

    plant = Plant.from_table(table())
    for index in range(len(plant.joints)):
        plant.take(index, True)

    def go(number: int, steps: int) -> None:
        plant.data.ctrl[0] = math.radians(target_deg(number))
        mujoco.mj_step(plant.model, plant.data, steps)

    return rates(go, short)


if __name__ == "__main__":
    answer({"ours": verbs, "mj_step": raw})
