"""Motions with a duration on whole trees, in virtual time: each robot's own gate, transport and wire, with
its twin in memory. The checks read the commands that the robot received."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
import trio
import trio.testing

from strands_actors.caller.session.motions import (
    LONGEST_S,
    Motion,
    RobotReading,
    Steps,
    plan_hold,
    plan_move,
    refuse_targets,
)
from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver, Reason
from strands_actors.drivers import get_native_driver_class as native
from strands_actors.policies.mock import Mock
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Beat, Stop
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.testing import InlineTree, open_inline_tree
from tests.hostile.bench import Bench
from tests.hostile.peer import HostilePeer
from tests.hostile.peer import Steps as Instrument
from tests.hostile.rigs import RIGS
from tests.hostile.test_virtual import Trial, ready
from tests.tree.writer import Writer

MOCK_S = 3.0

Make = Callable[[Driver, RobotReading], tuple[Any, int]]
"""Returns a policy, and the number of steps after which it ends."""

POLICIES = [robot for robot in RIGS if not native(robot).ROLLOUTS]
BASES = {
    "earthrover": {"linear": 0.3, "angular": 0.0},
    "yahboom_m3pro": {"linear.x": 0.2, "linear.y": 0.0, "angular.z": 0.0},
    "stretch3": {"vx": 0.1, "wz": 0.0},
    "spot": {"vx": 0.2, "vy": 0.0, "wz": 0.0},
}


@pytest.fixture(autouse=True)
def without_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the policies' code in the loop, because virtual time would go on while a thread works."""

    async def run_sync(function: Callable[..., Any], *args: Any, **_: Any) -> Any:
        await trio.lowlevel.checkpoint()
        return function(*args)

    monkeypatch.setattr(trio.to_thread, "run_sync", run_sync)


class Ended(NamedTuple):
    status: TaskStatus
    began_s: float
    position: tuple[float, ...]
    bench: Bench


def run(robot: str, make: Make, meanwhile: Callable[..., Any] | None = None) -> Ended:
    """Run a policy on a robot's tree.

    ``make`` returns the policy and the number of its steps (0: it ends after ``MOCK_S``). ``meanwhile``
    runs at the same time, and is given the tree.
    """
    found: list[Ended] = []

    async def main() -> None:
        rig = RIGS[robot]
        bench = rig.make(HostilePeer(steps))
        async with bench.living(), open_inline_tree(driver=bench.driver) as tree:
            writer = Writer(tree)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(beat, writer)
                await ready(Trial(tree, HostilePeer(steps), bench, rig, writer))
                found.append(await rollout(tree, bench, writer, make, meanwhile))
                nursery.cancel_scope.cancel()

    steps = Instrument()
    trio.run(main, clock=trio.testing.MockClock(autojump_threshold=0), instruments=[steps])
    return found[0]


async def beat(writer: Writer) -> None:
    while True:
        writer.ref.tell(Beat(writer.lease.id))
        await trio.sleep(0.2)


async def rollout(
    tree: InlineTree,
    bench: Bench,
    writer: Writer,
    make: Make,
    meanwhile: Callable[..., Any] | None,
) -> Ended:
    driver, status = tree.driver, await tree.status()
    assert status.observation is not None
    policy, n_steps = make(driver, RobotReading(status.observation, status.target, tree.node.clock.now_ns()))
    over, ended = trio.Event(), list[TaskStatus]()

    def report(told: TaskStatus) -> None:
        if not told.running:
            ended.append(told)
            over.set()

    at = tree.gate.address.split("/")[1]
    period_s = 1 / driver.timing.control_hz
    longest_s = math.inf if n_steps else MOCK_S
    ttl_s = max(driver.timing.stream_ttl_s, 2 * period_s)
    settings = Rollout(at, driver.axes, "", period_s, ttl_s, longest_s, n_steps, writer.lease.id, driver.table)
    cell = tree.node.cell(addresses.of(at).path("policy"), lambda: Policy(settings, lambda: policy, report))
    began_s = trio.current_time()
    async with trio.open_nursery() as nursery:
        nursery.start_soon(cell.run)
        if meanwhile is not None:
            nursery.start_soon(meanwhile, tree)
        with trio.fail_after(LONGEST_S):
            await over.wait()
        nursery.cancel_scope.cancel()
    await trio.sleep(0.5)  # a robot's reports are a little late
    seen = (await tree.status()).observation
    assert seen is not None
    return Ended(ended[0], began_s, seen.position, bench)


@pytest.mark.parametrize("robot", POLICIES)
def test_the_mock_runs_to_its_end(robot: str) -> None:
    ended = run(robot, lambda driver, _: (Mock(driver.axes), 0))
    assert ended.status.exit_reason == "duration", ended.status
    assert any(kind == "setpoint" for t_s, kind in ended.bench.log() if t_s > ended.began_s)


def a_little(driver: Driver, seen: RobotReading) -> dict[str, float]:
    """Return a target near the position of the first joint."""
    at = next(at for at, axis in enumerate(driver.table) if axis.mode is AxisMode.POSITION)
    axis, here = driver.table[at], seen.observation.position[at]
    span = min(axis.high - axis.low, 2.0 if "rad" in axis.unit else 100.0)
    up = here + 0.1 * span <= axis.high
    return {axis.key: here + (0.1 if up else -0.1) * span}


KEEPS_NO_POSE = ("earthrover", "unitree_go2")
"""Robots that ``move_to`` refuses: a base has no joints, and legs fall when commands end."""


@pytest.mark.parametrize("robot", KEEPS_NO_POSE)
def test_a_robot_that_keeps_no_pose_gets_no_motion(robot: str) -> None:
    driver = native(robot)(robot, "127.0.0.1", native(robot).resolve(robot, {}))
    refused = refuse_targets(driver, {driver.axes[0]: 0.0})
    assert refused is not None and refused.code in ("no_positions", "keeps_no_pose", "a_speed")


@pytest.mark.parametrize("robot", [robot for robot in POLICIES if robot not in KEEPS_NO_POSE])
def test_a_joint_is_at_its_target_after_the_time(robot: str) -> None:
    targets: dict[str, float] = {}

    def make(driver: Driver, seen: RobotReading) -> tuple[Any, int]:
        targets.update(a_little(driver, seen))
        motion = plan_move(driver, targets, 2.5, seen, 1 / driver.timing.control_hz)
        assert isinstance(motion, Motion), motion
        return Steps(motion), motion.n_steps

    ended = run(robot, make)
    assert ended.status.exit_reason == "n_steps", ended.status
    assert ended.status.elapsed_s == pytest.approx(2.5, abs=0.3)
    driver = ended.bench.driver
    ((key, target),) = targets.items()
    axis = driver.table[driver.axes.index(key)]
    near = 0.02 if axis.unit in ("rad", "m") else 3.0
    assert ended.position[driver.axes.index(key)] == pytest.approx(target, abs=near)


@pytest.mark.parametrize("robot", BASES)
def test_a_held_speed_ends_by_itself(robot: str) -> None:
    def make(driver: Driver, seen: RobotReading) -> tuple[Any, int]:
        motion = plan_hold(driver, "move", BASES[robot], 1.5, seen, 1 / driver.timing.control_hz)
        assert isinstance(motion, Motion), motion
        return Steps(motion), motion.n_steps

    ended = run(robot, make)
    assert ended.status.exit_reason == "n_steps", ended.status
    commands = [
        (t_s, kind) for t_s, kind in ended.bench.log() if t_s >= ended.began_s and kind in ("setpoint", "safe")
    ]
    driving = [t_s for t_s, kind in commands if kind == "setpoint"]
    assert driving[-1] - driving[0] >= 1.3, "the speed is held for longer than the lifetime of one command"
    assert max(later - earlier for earlier, later in itertools.pairwise(driving)) < 0.2
    assert commands[-1][1] == "safe", "the last command must be a stop"


@pytest.mark.parametrize("robot", ["so101", "xarm7", "kinova_gen3", "earthrover"])
def test_saf_009_a_stop_ends_a_motion_in_a_time(robot: str) -> None:
    stopped: list[float] = []

    async def stop(tree: InlineTree) -> None:
        await trio.sleep(1.0)
        stopped.append(trio.current_time())
        await tree.gate.ask(Stop(Reason.STOP), 10.0)

    def make(driver: Driver, seen: RobotReading) -> tuple[Any, int]:
        period_s = 1 / driver.timing.control_hz
        motion = (
            plan_hold(driver, "move", BASES[robot], 5.0, seen, period_s)
            if robot in BASES
            else plan_move(driver, a_little(driver, seen), 5.0, seen, period_s)
        )
        assert isinstance(motion, Motion), motion
        return Steps(motion), motion.n_steps

    ended = run(robot, make, stop)
    assert ended.status.exit_reason == "stop", ended.status
    log = [(t_s, kind) for t_s, kind in ended.bench.log() if t_s >= stopped[0]]
    safe_s = next(t_s for t_s, kind in log if kind == "safe")
    assert safe_s - stopped[0] <= RIGS[robot].bound_s
    assert not [t_s for t_s, kind in log if kind == "setpoint" and t_s > safe_s], "a setpoint after the stop"
