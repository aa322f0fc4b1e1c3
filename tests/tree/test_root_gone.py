"""The root ends at each step of its work, and the wire must act alone (SAF-003, SAF-018, SAF-020). In
virtual time; the frames and the energised motors decide.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.supervisors.root.stop_channel import LINGER_S
from strands_actors.supervisors.wire.transport import Transport
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import armed, freeze, setpoints

LIMP = [False, False]

STEPS = (
    "it is about to write",
    "it is about to fence",
    "it has fenced",
    "it is about to write again",
    "it is done",
)
"""The steps of a guardian that ends a wire."""


class Root:
    """A root that dies at one of its ``STEPS``. Then its wire sees the end of the link, and the root does
    nothing more. It continues at the end of the test, so that its tree can end.
    """

    def __init__(self, tree: InlineTree, dies_when: str) -> None:
        self._tree = tree
        self._dies_when = dies_when
        self.dead = False
        self.over = trio.Event()
        self.steps: list[str] = []
        guardian, place = tree.keeper, tree.wire
        second = guardian.channels.own
        assert second is not None
        make_safe, fence = second.make_safe, place.fence
        about_to_write = iter((STEPS[0], STEPS[3]))

        async def watched_make_safe(safe_state: str) -> tuple[MotorReport, ...]:
            await self._comes_to(next(about_to_write))
            reports = await make_safe(safe_state)
            if self.steps[-1] == STEPS[3]:
                await self._comes_to(STEPS[4])
            return reports

        async def watched_fence() -> bool:
            await self._comes_to(STEPS[1])
            fenced = await fence()
            await self._comes_to(STEPS[2])
            return fenced

        second.make_safe = watched_make_safe  # type: ignore[method-assign]
        place.fence = watched_fence  # type: ignore[method-assign]

    async def _comes_to(self, step: str) -> None:
        if not self.dead:
            self.steps.append(step)
        if step == self._dies_when:
            self.die()
        if self.dead:
            with trio.CancelScope(shield=True):
                await self.over.wait()

    def die(self) -> None:
        self.dead = True
        self._tree.wire.close_link()


@asynccontextmanager
async def moving_tree(dies_when: str = "") -> AsyncIterator[tuple[InlineTree, Root]]:
    """Run a robot that moves, and its root."""
    async with open_inline_tree() as tree:
        writer = await armed(tree)
        root = Root(tree, dies_when)
        await writer.send(latched=True, a=5.0)
        await trio.sleep(0.05)
        try:
            yield tree, root
        finally:
            root.over.set()


def transport_of(tree: InlineTree) -> Transport:
    actor = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor
    assert isinstance(actor, Transport)
    return actor


@pytest.mark.parametrize("step", STEPS)
def test_saf_003_a_root_may_die_at_any_step_of_ending_a_healthy_wire(step: str) -> None:
    """The root fences a wire that answered all the time."""

    async def run() -> None:
        async with moving_tree(step) as (tree, root):
            tree.keeper._break(Reason.WIRE, "the wire process stopped answering")
            began_ns = tree.node.clock.now_ns()
            await trio.sleep(0.5)
            assert root.dead and root.steps == list(STEPS[: STEPS.index(step) + 1])
            assert tree.hardware.of("safe", began_ns), "a safe frame is on the wire"
            assert setpoints(tree, tree.hardware.of("safe", began_ns)[0].t_ns + 1) == []
            assert tree.hardware.energised == LIMP

    run_virtual(run)


@pytest.mark.parametrize("step", STEPS[1:])
def test_saf_016_a_root_that_wrote_before_it_died_has_made_a_frozen_wires_robot_safe(step: str) -> None:
    async def run() -> None:
        async with moving_tree(step) as (tree, root):
            freeze(tree, "gate")
            await trio.sleep(0.5)
            assert root.dead
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_002_a_root_that_ends_while_its_wire_runs_fences_the_wire_before_it_writes() -> None:
    """That wire streams, so it could write a setpoint between a safe frame and the fence."""

    async def run() -> None:
        async with moving_tree() as (tree, root):
            assert tree.wire.alive
        assert root.steps[:3] == [STEPS[1], STEPS[2], "it is about to write"]

    run_virtual(run)


# -- the wire without its root


def test_saf_018_a_motor_that_is_silent_when_the_root_dies_is_released_when_it_answers() -> None:
    async def run() -> None:
        async with moving_tree() as (tree, root):
            tree.hardware.silent.add("b")
            root.die()
            await trio.sleep(10.0)
            assert tree.hardware.energised == [False, True]
            assert tree.wire.alive, "the wire still tries to make the robot safe"
            tree.hardware.silent.clear()
            await trio.sleep(2.5)
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_018_a_wire_without_a_root_tries_no_longer_than_the_published_time() -> None:
    async def run() -> None:
        async with moving_tree() as (tree, root):
            tree.hardware.silent.add("b")
            root.die()
            await trio.sleep(LINGER_S / 2)
            assert tree.wire.alive
            await trio.sleep(LINGER_S / 2 + 10.0)
            assert not tree.wire.alive and not tree.wire.ended_safe

    run_virtual(run)


def test_saf_020_the_root_dies_while_the_cable_is_out() -> None:
    """The wire cannot hand over its port, because there is no root. The robot is made safe when its cable
    is back.
    """

    async def run() -> None:
        async with moving_tree() as (tree, root):
            tree.hardware.plugged = False
            await tree.until("lost")
            root.die()
            freeze(tree, "guardian")
            await trio.sleep(5.0)
            assert tree.hardware.energised != LIMP
            tree.hardware.plugged = True
            back_ns = tree.node.clock.now_ns()
            await trio.sleep(2.5)
            assert tree.hardware.energised == LIMP
            assert setpoints(tree, back_ns) == tree.hardware.of("enable", back_ns) == []

    run_virtual(run)


def test_saf_003_the_stop_channel_is_used_if_the_transport_fails_after_the_root_died() -> None:
    async def run() -> None:
        async with moving_tree() as (tree, root):
            wire: Any = transport_of(tree)._wire

            async def fails(safe_state: str) -> tuple[MotorReport, ...]:
                raise RuntimeError("a fault was asked for")

            wire.make_safe = fails
            root.die()
            await trio.sleep(0.5)
            assert tree.hardware.energised == LIMP
            assert [entry.path for entry in tree.hardware.of("safe")] == ["stop_channel"]

    run_virtual(run)


def test_saf_003_the_stop_channel_is_used_if_the_transport_hangs_after_the_root_died() -> None:
    async def run() -> None:
        async with moving_tree() as (tree, root):
            wire: Any = transport_of(tree)._wire

            async def hangs(safe_state: str) -> tuple[MotorReport, ...]:
                await trio.sleep_forever()
                raise AssertionError

            wire.make_safe = hangs
            root.die()
            await trio.sleep(3.0)
            assert tree.hardware.energised == LIMP
            assert not tree.wire.alive and tree.wire.ended_safe

    run_virtual(run)


def test_a_wire_that_has_energised_nothing_ends_with_its_root_at_once() -> None:
    """Its robot was never connected."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            tree.hardware.plugged = False
            await tree.until("down")
            place = tree.wire
            place.close_link()
            await trio.sleep(0.1)
            assert not place.alive

    run_virtual(run)
