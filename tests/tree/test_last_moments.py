"""An e-stop that reaches the root in the last moments of a tree that ends (SAF-005, SAF-007). Guardian
and end are real, in virtual time. The exit of the process is replaced.
"""

from __future__ import annotations

import os
from types import MethodType, SimpleNamespace
from typing import Any

import pytest
import trio

import strands_actors.supervisors.root.process as process
from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.wire import StopChannel
from strands_actors.kernel.clock import Clock
from strands_actors.supervisors.gate.messages import Resume, Resumed, StopReport
from strands_actors.supervisors.root.messages import Fence
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeDriver, FakeStopChannel

from .writer import armed, driver_of

SESSION_S = 0.2


class SlowChannel(FakeStopChannel):
    """A stop channel that needs a network session."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await trio.sleep(SESSION_S)
        task_status.started()


class SlowDriver(FakeDriver):
    def stop_channel(self, descriptors: tuple[int, ...], clock: Clock) -> StopChannel:
        return SlowChannel(self.hardware, clock)


class Exited(BaseException):
    pass


def ending(tree: InlineTree, driver: Driver, seen: dict[str, Any]) -> Any:
    """Return an object with the members that ``Tree._leave`` uses."""

    async def end_standby() -> None:
        seen["safe states before the end of the standby"] = [entry.safe_state for entry in tree.hardware.of("safe")]

    async def settle() -> None:
        pass

    made = SimpleNamespace(
        _end=(Reason.CLEANUP, "script"),
        _waiting=[],
        guardian=tree.keeper,
        node=tree.node,
        safety_page=tree.keeper._safety_page,
        driver=driver,
        actors=SimpleNamespace(gate=tree.gate.address),
        cameras=SimpleNamespace(end=lambda: None),
        tasks=SimpleNamespace(process=None),
        keeper=SimpleNamespace(settle=settle),
        audit=SimpleNamespace(settle=settle),
        standby=SimpleNamespace(end=end_standby),
    )
    for name in ("_stop_by_gate", "_report_of_guardian", "_settle_s"):
        setattr(made, name, MethodType(getattr(process.Tree, name), made))
    return made


class ProcessOs:
    """Stand in for ``os``, and record the exit."""

    def __init__(self, seen: dict[str, Any]) -> None:
        self._seen = seen

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def _exit(self, code: int) -> None:
        self._seen["code"] = code
        raise Exited


@pytest.mark.parametrize("pressed_before", [False, True])
def test_saf_007_an_e_stop_during_the_end_of_a_tree_is_carried_out(
    pressed_before: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wire has ended. The robot is safe, but in a milder state than an e-stop requires. The report of
    an earlier e-stop does not count.
    """
    seen: dict[str, Any] = {}
    monkeypatch.setattr(process, "os", ProcessOs(seen))
    hardware = FakeHardware()
    driver = driver_of(hardware, "last moments", SlowDriver, "settle")

    async def press(tree: InlineTree, by: str) -> StopReport:
        report = await tree.guardian.ask(Fence(Reason.ESTOP, by, lock=True), 3.0)
        assert isinstance(report, StopReport)
        return report

    async def run() -> None:
        async with open_inline_tree(hardware, driver=driver) as tree:
            await armed(tree)
            if pressed_before:
                await press(tree, "before")
                await trio.sleep(5.0)
                await tree.until("disarmed")
                assert isinstance(await tree.gate.ask(Resume("operator", lift=True), 1.0), Resumed)

            async def leave() -> None:
                with pytest.raises(Exited):
                    await process.Tree._leave(ending(tree, driver, seen))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(leave)
                await trio.sleep(0.001)
                while not tree.keeper.idle.is_set():  # noqa: ASYNC110  # until the guardian is idle
                    await trio.sleep(0.001)
                pressed_ns = tree.node.clock.now_ns()
                report = await press(tree, "a person")
            assert report.safe_state == "off" and report.confirmed and report.at_ns >= pressed_ns
            assert seen["safe states before the end of the standby"][-1] == "off", (
                "the standby runs until the e-stop"
            )
            assert seen["code"] == 0

    run_virtual(run)
