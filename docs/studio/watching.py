"""Run the demo on a twin, and record it: poses of the arm, readings, setpoints, faults and their effect.

It is the demo of ``strands-actors demo``, with its first two faults. The poses come from the twin itself, so the
arm is also seen when no process is left that reads it.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import trio

from strands_actors import Robot
from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import SimulationClient
from strands_actors.surfaces.cli.demo.scenario import FAULTS, Failed, Outcome, Scenario
from strands_actors.surfaces.cli.demo.watch import Sample, Watch
from strands_actors.testing import Twin

from .robots import scene_at

ROBOT = "so101"
SECONDS = 13.0
"""Length of the demo, without the time in which processes start."""
POSES_HZ = 50.0
_ANSWER_S = 20.0


class Seen(NamedTuple):
    """The record of a demo. All times are of the monotonic clock, in nanoseconds."""

    scene: bytes
    poses: list[Sample]
    axes: tuple[str, ...]
    positions: list[Sample]
    targets: list[Sample]
    outcomes: list[Outcome]


def watch_demo() -> Seen:
    """Run the demo and return its record.

    Raises:
        RuntimeError: The demo failed, or a fault did not lead to the safe state in time.
    """
    driver = get_native_driver_class(ROBOT)
    assert driver is not None and issubclass(driver, Driver)
    with tempfile.TemporaryDirectory() as name, Twin(ROBOT, Path(name), by_hand=True) as twin:
        robot = Robot(ROBOT, mode="real", port=twin.port)
        watch = Watch(robot, twin.log.path)
        scenario = Scenario(robot, watch, driver, lambda text, kind: print(f"  {text}", flush=True))
        try:
            scenario.start()
            with _poses(str(Path(name) / "control")) as (scene, poses):
                scenario.run(SECONDS, FAULTS[:2])
        except Failed as failure:
            raise RuntimeError(f"the demo failed. {failure}") from None
        finally:
            robot.cleanup()
            watch.stop()
    unsafe = [f"{outcome.signal} {outcome.victim}: {outcome}" for outcome in scenario.outcomes if not outcome.safe]
    if unsafe:
        raise RuntimeError(f"the demo failed, probably because this computer is busy. {unsafe[0]}")
    return Seen(scene, poses, watch.axes, watch.positions, watch.targets, scenario.outcomes)


@contextmanager
def _poses(control: str) -> Iterator[tuple[bytes, list[Sample]]]:
    """Yield the scene of a twin, and a list of its poses that grows while the block runs."""
    poses: list[Sample] = []
    ended = threading.Event()

    async def sample() -> None:
        client = SimulationClient(control)
        try:
            while not ended.is_set():
                pose = await client.call(p.GetPose(0), p.Pose, _ANSWER_S)
                poses.append(Sample(time.monotonic_ns(), pose.qpos))
                await trio.sleep(1 / POSES_HZ)
        finally:
            client.close()

    scene = trio.run(scene_at, control).file
    sampler = threading.Thread(target=trio.run, args=(sample,))
    sampler.start()
    try:
        yield scene, poses
    finally:
        ended.set()
        sampler.join()
