"""A rollout whose first action comes only after a stop: it must not begin any more."""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Lease, Resume, Resumed, Stop
from strands_actors.testing import open_inline_tree, run_virtual

from .writer import armed


@pytest.mark.parametrize("reason", [Reason.STOP, Reason.ESTOP, Reason.POLICY])
def test_saf_008_a_rollout_of_before_a_stop_takes_no_lease_after_it(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            begun = caller.lease.id  # what the rollout knows of its caller
            await tree.gate.ask(Stop(reason, "test", lock=reason is Reason.ESTOP), 1.0)
            assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)
            late = await tree.gate.ask(Acquire("policy", over=begun), 1.0)
            assert isinstance(late, Refused)
            assert late.code == "stopped"

            assert isinstance(await caller.acquire(), Lease)  # the robot is the caller's
            assert isinstance(await caller.send(latched=True, a=1.0), Accepted)
            assert isinstance(await tree.gate.ask(Acquire("policy", over=caller.lease.id), 1.0), Lease)

    run_virtual(run)


def test_an_operators_lockout_is_lifted_by_an_operator_only() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            await tree.gate.ask(Stop(Reason.ESTOP, "bob", lock=True), 1.0)
            refusal = await tree.gate.ask(Resume("agent", lift=False), 1.0)
            assert isinstance(refusal, Refused)
            assert (refusal.code, refusal.reason) == ("locked_out", "e-stopped by bob")
            assert (await tree.status()).mode == "disarmed"
            assert isinstance(await tree.gate.ask(Resume("bob"), 1.0), Resumed)

            await tree.gate.ask(Stop(Reason.STOP, "bob"), 1.0)  # no lockout: whoever has the robot may energise it
            assert isinstance(await tree.gate.ask(Resume("agent", lift=False), 1.0), Resumed)
            assert isinstance(await caller.acquire(), Lease)

    run_virtual(run)
