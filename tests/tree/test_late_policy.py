"""A rollout whose first action comes only after a stop must not start any more."""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Lease, Resume, Resumed, Stop
from strands_actors.testing import open_inline_tree, run_virtual

from .writer import armed


@pytest.mark.parametrize("reason", [Reason.STOP, Reason.ESTOP, Reason.POLICY])
def test_saf_008_a_rollout_from_before_a_stop_gets_no_lease_after_it(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            begun = caller.lease.id  # the lease of its caller that the rollout was started under
            await tree.gate.ask(Stop(reason, "test", lock=reason is Reason.ESTOP), 1.0)
            assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)
            late = await tree.gate.ask(Acquire("policy", over=begun), 1.0)
            assert isinstance(late, Refused)
            assert late.code == "stopped"

            assert isinstance(await caller.acquire(), Lease)  # the caller commands the robot
            assert isinstance(await caller.send(latched=True, a=1.0), Accepted)
            assert isinstance(await tree.gate.ask(Acquire("policy", over=caller.lease.id), 1.0), Lease)

    run_virtual(run)


def test_only_an_operator_lifts_an_operators_lockout() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            await tree.gate.ask(Stop(Reason.ESTOP, "bob", lock=True), 1.0)
            refusal = await tree.gate.ask(Resume("agent", lift=False), 1.0)
            assert isinstance(refusal, Refused)
            assert (refusal.code, refusal.reason) == ("locked_out", "e-stopped by bob")
            assert (await tree.status()).mode == "disarmed"
            assert isinstance(await tree.gate.ask(Resume("bob"), 1.0), Resumed)

            # without a lockout each holder of the robot may energise it
            await tree.gate.ask(Stop(Reason.STOP, "bob"), 1.0)
            assert isinstance(await tree.gate.ask(Resume("agent", lift=False), 1.0), Resumed)
            assert isinstance(await caller.acquire(), Lease)

    run_virtual(run)
