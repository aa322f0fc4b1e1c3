"""One e-stop stops one robot of every driver, judged by the wire log of each twin. They run in batches that
two cores can carry, each with an SO-101."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.driver import Reason
from strands_actors.drivers import get_native_driver_class
from strands_actors.surfaces.cli.matrix import one_of_each
from strands_actors.testing import Twin
from tests.answers import status, until, why

pytestmark = pytest.mark.real_time

AT_ONCE = 2
"""Pairs that never run in the same batch. Together with a G1, a Go2's twin got no processor for half a second,
and its stop was reported as not confirmed."""
BESIDE = "so101"
BOUND_S = 3.0
"""Longest time from the call to the safe frame of each robot. It is far above the measured time, for a busy
machine."""


@contextlib.contextmanager
def fleet(kinds: list[str], directory: Path) -> Iterator[dict[str, tuple[Twin, RealRobot]]]:
    with contextlib.ExitStack() as stack, ThreadPoolExecutor() as pool:
        for kind in kinds:
            (directory / kind).mkdir()
        twins = [Twin(kind, directory / kind) for kind in kinds]
        for twin, _ in zip(twins, pool.map(Twin.__enter__, twins), strict=True):
            stack.push(twin.__exit__)
        robots = [Robot(twin.robot, mode="real", port=twin.port) for twin in twins]
        for robot in robots:
            stack.callback(robot.cleanup)
        for robot in robots:
            problem = robot.connect_eagerly() and robot.connect_eagerly()  # a second attempt, for a busy machine
            assert problem is None, f"{robot.name}: {problem}"
        yield {twin.robot: (twin, robot) for twin, robot in zip(twins, robots, strict=True)}


def is_in(robot: RealRobot, field: str, value: str) -> bool:
    return bool(status(robot)[field] == value)


def armed(robot: RealRobot) -> bool:
    """Return True if the robot is armed. Legs with late setpoints on a busy machine are released."""
    return is_in(robot, "state", "armed") or robot.resume()["status"] == "success"


@pytest.mark.long
def test_saf_007_one_estop_stops_a_robot_of_every_wire(
    tmp_path: Path, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = [kind for kind in one_of_each() if get_native_driver_class(kind) is not get_native_driver_class(BESIDE)]
    batches = -(-len(kinds) // AT_ONCE)
    for first in range(batches):
        directory = tmp_path / str(first)
        directory.mkdir()
        # Locks outlive the trees of the batch before, and so does a tree whose robot has not confirmed its end.
        monkeypatch.setenv("STRANDS_ACTORS_DATA", str(directory / "data"))
        monkeypatch.setenv("STRANDS_ACTORS_RUN", str(run_dir / str(first)))
        with fleet([BESIDE, *kinds[first::batches]], directory) as robots:
            for kind, (_, robot) in robots.items():
                until(partial(armed, robot), f"{kind} is energised")
            began_ns = time.monotonic_ns()
            outcomes = {outcome.robot: outcome for outcome in estop(by="the button", within_s=12.0)}
            assert outcomes.keys() == robots.keys()
            assert [outcome for outcome in outcomes.values() if outcome.outcome != "safe"] == []
            for kind, (twin, robot) in robots.items():
                assert outcomes[kind].safe_state == robot.driver.fallbacks[Reason.ESTOP]
                twin.log.safe_within(began_ns, BOUND_S)
                assert twin.log.setpoints_after_safe(began_ns) == 0
                until(partial(is_in, robot, "locked_by", "the button"), f"{kind} is locked")
                seen = robot.get_observation()
                answer = robot.send_action({axis: seen.get(axis, 0.0) for axis in robot.driver.axes})
                assert answer["status"] == "error" and "the button" in why(answer), f"{kind}: {answer}"
                assert twin.log.setpoints_after_safe(began_ns) == 0
