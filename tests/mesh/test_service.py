"""If a part of the mesh service fails permanently, a stop over the mesh still works."""

from __future__ import annotations

from dataclasses import replace

import pytest
import trio

from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.mesh import service
from strands_actors.supervisors.mesh.service import BUDGET, MeshService
from strands_actors.supervisors.mesh.telemetry import Telemetry
from strands_actors.supervisors.root.messages import TaskStatus
from strands_actors.testing import FakeHardware
from strands_actors.testing.fake import HARDWARE, FakeDriver


def test_saf_007_a_robot_with_permanently_failing_telemetry_can_be_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failures = 0
    started = Telemetry.started

    async def fails(self: Telemetry) -> None:
        nonlocal failures
        await started(self)
        failures += 1
        raise ValueError("a fault was asked for")

    monkeypatch.setattr(Telemetry, "started", fails)
    monkeypatch.setitem(HARDWARE, "service", FakeHardware())
    monkeypatch.setattr(service, "BUDGET", replace(BUDGET, within_s=60.0))
    audited: list[tuple[str, ...]] = []

    async def run() -> None:
        node = Node("service", MonotonicClock())
        driver = FakeDriver("fake", "service", {})
        mesh = MeshService(
            node, "service", driver, lambda: TaskStatus(False, 0, 0.0), audit=lambda *entry: audited.append(entry)
        )
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            nursery.start_soon(mesh.run, ["tcp/127.0.0.1:0"], [], {})
            with trio.fail_after(30):
                while not mesh.problem:  # noqa: ASYNC110  # no event reports the problem
                    await trio.sleep(0.01)
            assert failures == BUDGET.restarts + 1 and "a fault was asked for" in mesh.problem
            assert any("failed" in entry[2] for entry in audited)
            at = addresses.of("service")
            assert at.safety in node.cells and at.gateway_stop in node.cells
            nursery.cancel_scope.cancel()

    trio.run(run)
