"""The time at which a rollout starts its next inference: early enough for the buffer, and not earlier
than necessary.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import pytest
import trio
import trio.testing

from strands_actors.supervisors import addresses
from strands_actors.supervisors.policy import Buffer, Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.testing import open_inline_tree

from .writer import armed

PERIOD_S = 0.01
PERIOD_NS = 10_000_000
CHUNK = [{"a": 0.0}] * 10


@pytest.mark.parametrize(("took_ms", "left"), [(0, 5), (30, 5), (33, 5), (40, 6), (60, 9), (80, 12), (1000, 150)])
def test_the_buffer_is_low_at_half_a_chunk_or_when_an_inference_may_outlast_it(took_ms: int, left: int) -> None:
    buffer = Buffer(PERIOD_S)
    assert buffer.low
    buffer.add(CHUNK * 16, 0)
    buffer.add(CHUNK, took_ms * 1_000_000)
    while len(buffer) > left:
        assert not buffer.low
        buffer.next()
    assert buffer.low


@pytest.mark.parametrize("took", range(1, 10))  # periods
def test_a_policy_that_is_quicker_than_its_chunks_never_leaves_the_buffer_empty(took: int) -> None:
    buffer = Buffer(PERIOD_S)
    buffer.add(CHUNK, took * PERIOD_NS)
    due = longest = 0
    for _ in range(1000):
        buffer.next()  # raises if the buffer is empty
        longest = max(longest, len(buffer))
        if due:
            due -= 1
            if not due:
                buffer.add(CHUNK, took * PERIOD_NS)
        elif buffer.low:
            due = took
    assert longest <= len(CHUNK) * 2.5


def test_an_empty_chunk_leaves_the_buffer_as_low_as_before() -> None:
    """A policy that reads several observations returns no action while it collects them."""
    buffer = Buffer(PERIOD_S)
    buffer.add(CHUNK, PERIOD_NS)
    while not buffer.low:
        buffer.next()
    buffer.add([], 1)
    assert buffer.low and len(buffer) == 5


class Slow:
    """Compute for 70 ms for each 100 ms of actions."""

    def __init__(self) -> None:
        self.called_at_s: list[float] = []

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self.called_at_s.append(trio.from_thread.run_sync(trio.current_time))
        trio.from_thread.run(trio.sleep, 0.07)
        return CHUNK


def test_the_setpoints_of_a_slow_policy_have_no_pause() -> None:
    policy = Slow()

    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            ended = trio.Event()

            def report(status: TaskStatus) -> None:
                if not status.running:
                    assert status.exit_reason == "n_steps", status
                    ended.set()

            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, ("a", "b"), "", PERIOD_S, 0.1, 10.0, n_steps=60, over=caller.lease.id)
            cell = tree.node.cell(
                addresses.of(robot).path("policy"), lambda: Policy(rollout, lambda: policy, report)
            )
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                with trio.fail_after(5.0):
                    await ended.wait()
                nursery.cancel_scope.cancel()
            sent = [entry.t_ns for entry in tree.hardware.of("setpoint")]
            assert len(sent) >= 60
            # If the next inference only started at half a chunk, the buffer would be empty for 20 ms,
            # apart from the wire's keepalive.
            assert max(after - before for before, after in itertools.pairwise(policy.called_at_s)) < 0.105

    # An inference runs in a thread, and virtual time waits until the loop has been idle for this long.
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
