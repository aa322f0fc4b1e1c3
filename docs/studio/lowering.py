"""Draw how fast the tool of a raised arm is while the arm falls, and while it is lowered."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import trio
import trio.testing

from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.kinematics.chain import Chain
from tests.drivers.servo.rig import DynamixelRig, FeetechRig, MakeRig, raised

POSES: Mapping[str, tuple[MakeRig, tuple[float, ...]]] = {
    "so101": (FeetechRig, (0, 0.3, -0.5, 0.3, 0, 0.5)),
    "koch": (DynamixelRig, (0, 0, -0.5, 0.3, 0, 0.5)),
}
WAYS = {SafeState.LIMP: 'on_exit="limp"', SafeState.LOWERED: 'on_exit="lower"'}
SHOWN_S = 3.2
STEP_S = 0.02
LIMIT_M_S = 0.15


class Course(NamedTuple):
    """What the tool did after a stop: its speed at each time, and when the arm had no torque any more."""

    times_s: list[float]
    speeds_m_s: list[float]
    limp_s: float


def make(path: Path) -> None:
    """Simulate the stops and draw them, one panel for each arm."""
    os.environ.setdefault("MPLBACKEND", "svg")
    import matplotlib

    matplotlib.rcParams["svg.hashsalt"] = path.name
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(8, 5), layout="constrained")
    panels = drawing.subplots(len(POSES), 1, sharex=True)
    for panel, (robot, (make_rig, pose)) in zip(panels, POSES.items(), strict=True):
        for way, label in WAYS.items():
            course = course_of(make_rig, pose, way)
            panel.plot(course.times_s, course.speeds_m_s, label=f"{label}: torque off after {course.limp_s:.1f} s")
        panel.axhline(LIMIT_M_S, color="grey", linestyle=":", label=f"{LIMIT_M_S:g} m/s")
        panel.set_ylabel("tool, m/s")
        panel.set_title(f"{robot}, raised, after a stop (lower is better)", fontsize=10, loc="left")
        panel.legend(fontsize=8)
    panels[-1].set_xlabel("seconds after the stop")
    drawing.savefig(path, metadata={"Date": None})


def course_of(make_rig: MakeRig, pose: tuple[float, ...], way: SafeState) -> Course:
    """Stop a raised arm in virtual time, and return what its tool did."""
    course = Course([], [], 0.0)

    async def main() -> None:
        nonlocal course
        rig = await raised(make_rig, pose)
        chain = Chain(rig.driver.TABLES.robots[rig.driver.robot], [axis.key for axis in rig.driver.joints])
        began_s, limp_s = trio.current_time(), 0.0

        async def stop() -> None:
            nonlocal limp_s
            await rig.wire.make_safe(way)
            limp_s = trio.current_time() - began_s

        async with trio.open_nursery() as nursery:
            nursery.start_soon(stop)
            before = chain.points(rig.bus.plant.position_rad)[-1]
            while trio.current_time() - began_s < SHOWN_S:
                await trio.sleep(STEP_S)
                rig.bus.pass_time()
                here = chain.points(rig.bus.plant.position_rad)[-1]
                way_m = sum((to - at) ** 2 for at, to in zip(before, here, strict=True)) ** 0.5
                course.times_s.append(trio.current_time() - began_s)
                course.speeds_m_s.append(way_m / STEP_S)
                before = here
        course = course._replace(limp_s=limp_s)

    trio.run(main, clock=trio.testing.MockClock(autojump_threshold=0))
    return course
