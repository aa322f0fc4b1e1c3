"""How the setpoints of a rollout travel: by column where that says the same, else by name."""

from __future__ import annotations

import math
from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.runtime.actor import Actor
from strands_actors.runtime.clock import VirtualClock
from strands_actors.runtime.contract import Observation
from strands_actors.runtime.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.messages import (
    Accepted,
    Acquire,
    GetObservation,
    Lease,
    Release,
    Rollout,
    Setpoint,
    TaskStatus,
)
from strands_actors.supervisors.policy import Policy


class Gate(Actor):
    """Accepts everything, and keeps it."""

    def __init__(self) -> None:
        self.setpoints: list[Setpoint] = []

    def receive(
        self, message: Acquire | GetObservation | Setpoint | Release
    ) -> Lease | Observation | Accepted | None:
        match message:
            case Acquire():
                return Lease(7, 1)
            case GetObservation():
                return Observation(0, (0.0, 0.0), (0, 0))
            case Setpoint():
                self.setpoints.append(message)
                return Accepted(1, ())
        return None


def sent(action: dict[str, Any]) -> Setpoint:
    """As it reaches the gate."""
    gate = Gate()

    async def run() -> None:
        node = Node("test", VirtualClock())
        ended = trio.Event()

        def report(status: TaskStatus) -> None:
            if not status.running:
                assert status.exit_reason == "n_steps", status
                ended.set()

        rollout = Rollout("legs", ("hip", "knee"), "", 0.002, 0.1, 1.0, n_steps=2)
        path = addresses.of("legs").path
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            nursery.start_soon(node.cell(path("gate"), lambda: gate).run)
            await trio.testing.wait_all_tasks_blocked()
            nursery.start_soon(
                node.cell(path("policy"), lambda: Policy(rollout, lambda: lambda _: action, report)).run
            )
            await ended.wait()
            nursery.cancel_scope.cancel()

    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
    assert len(gate.setpoints) == 2
    assert gate.setpoints[0].lease == 7 and gate.setpoints[0].period_s == 0.002
    return gate.setpoints[0]


def test_rows_of_every_axis_travel_by_column() -> None:
    setpoint = sent({"hip": {"q": 1, "kp": 60.0}, "knee": {"q": math.inf, "kp": 2.0}})
    assert (setpoint.action, setpoint.columns) == ({}, {"q": (1.0, math.inf), "kp": (60.0, 2.0)})


@pytest.mark.parametrize(
    "action",
    [
        {"knee": {"q": 1.0}, "hip": {"q": 2.0}},  # another order
        {"hip": {"q": 1.0}},
        {"hip": {"q": 1.0}, "knee": {"q": 2.0}, "toe": {"q": 3.0}},
        {"hip": {"q": 1.0}, "knee": {"q": True}},
        {"hip": 1.0, "knee": 2.0},
    ],
)
def test_everything_else_by_name(action: dict[str, Any]) -> None:
    setpoint = sent(action)
    assert (setpoint.action, setpoint.columns) == (action, {})
