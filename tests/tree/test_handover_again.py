"""A standby that replaces another one gets its own stop channel, also when the first handover fails
(SAF-016). The guardian, gate and standby are the real ones. The robot is a fake, in virtual time.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import StopChannel, Wire, WireDown
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.health.heartbeat import Heartbeat, new_page, words_of
from strands_actors.kernel.node import Node
from strands_actors.kernel.supervisor import Budget, ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.failsafe import Mode, State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Resume, Resumed, Status, Stop
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, SafetyPage
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.standby_keeper import StandbyKeeper
from strands_actors.supervisors.standby.messages import WatchOver
from strands_actors.supervisors.standby.process import NO_CHANNEL, Standby
from strands_actors.supervisors.wire.group import InlineWire
from strands_actors.testing import FakeHardware, run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeStopChannel, FakeWire

ROBOT = "again"


class Session(FakeStopChannel):
    """A stop channel over a network session. It takes ``LONG_S`` to begin, and the robot may refuse it."""

    LONG_S = 0.2
    refusals = 0
    lack = ""

    @property
    def lacks(self) -> str:
        return self.lack

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await trio.sleep(self.LONG_S)
        if Session.refusals:
            Session.refusals -= 1
            raise WireDown("the controller has no free session")
        task_status.started()


class SessionWire(FakeWire):
    def handover(self) -> tuple[int, ...]:
        return (os.open(os.devnull, os.O_RDONLY),)


class SessionDriver(FakeDriver):
    def stop_channel(self, descriptors: tuple[int, ...], clock: Clock) -> StopChannel:
        for fd in descriptors:
            os.close(fd)
        return Session(self.hardware, clock)

    def open_wire(self, clock: Clock) -> Wire:
        return SessionWire(self.hardware, clock)


class NoProcess:
    """Stand in for the standby's process, because the standby runs in this process."""

    pid = 0

    async def fence(self) -> bool:
        return True


class Robot:
    """A robot whose standby can be replaced."""

    def __init__(self, guardian: Guardian, gate: Any, node: Node, wires: list[InlineWire]) -> None:
        self.guardian, self.gate, self.node, self.wires = guardian, gate, node, wires
        self.exit_codes: list[int] = []  # of its standbys

    async def until(self, mode: Mode, standby: bool) -> None:
        """Wait until the current gate has this mode, and has a standby or none."""
        with trio.fail_after(30.0):
            while True:
                if self.gate.address in self.node.cells:
                    status = await self.gate.ask(GetStatus(), 1.0)
                    if isinstance(status, Status) and status.mode == mode and (not status.no_standby) == standby:
                        return
                await trio.sleep(0.01)

    async def replace(self) -> None:
        self.guardian.lose_standby("the standby process ended with signal 9")
        self.guardian.begin_standby()
        await self.until(Mode.ARMED, standby=False)


@asynccontextmanager
async def robot(report: Path) -> AsyncIterator[Robot]:
    hardware = FakeHardware()
    HARDWARE[ROBOT] = hardware
    driver = SessionDriver("fake", ROBOT, {})
    paths, node = addresses.of(ROBOT), Node(ROBOT, VirtualClock())
    page = new_page()
    words = words_of(page)
    safety_page = SafetyPage(words)
    root = subprocess.Popen(["sleep", "60"])  # noqa: ASYNC220  # starts at once
    beats = Heartbeat(words, ROOT, STANDBY)
    keeper = StandbyKeeper(node, ROBOT, {}, page, safety_page, beats, driver.timing, None, None)  # type: ignore[arg-type]
    keeper.process = NoProcess()  # type: ignore[assignment]
    keeper._watching = True
    wires: list[InlineWire] = []
    try:
        async with trio.open_nursery() as nursery:

            def start_wire(state: State, cause: str) -> InlineWire:
                beat = Heartbeat(words, WIRE, ROOT)
                wires.append(InlineWire(node, nursery, driver, ROBOT, state, cause, beat, safety_page))
                return wires[-1]

            await nursery.start(node.run)
            guardian = Guardian(
                driver,
                Heartbeat(words, ROOT, WIRE),
                start_wire,
                gate=paths.gate,
                transport=paths.transport,
                safety_page=safety_page,
                standby=keeper,
            )
            await nursery.start(node.cell(paths.path("guardian"), lambda: guardian).run)
            watched = WatchOver(root.pid, 0, (os.dup(page),))
            made = Robot(guardian, node.ref(paths.gate, Gate), node, wires)
            standby = Standby(driver, ROBOT, ROBOT, report, watched, made.exit_codes.append)
            await nursery.start(node.cell(paths.path("standby"), lambda: standby).run)
            async with trio.open_nursery() as tree:
                tree.start_soon(Supervisor([ChildSpec("wire", guardian.keep)], budget=Budget(100, 5.0)).run)
                await made.until(Mode.DISARMED, standby=True)
                assert isinstance(await made.gate.ask(Resume("a test"), 1.0), Resumed)
                yield made
                # before the standby ends, because the end of the tree asks the standby
                tree.cancel_scope.cancel()
            nursery.cancel_scope.cancel()
    finally:
        root.kill()
        root.wait()
        os.close(page)
        del HARDWARE[ROBOT]


def test_saf_016_a_handover_ends_with_its_wire(tmp_path: Path) -> None:
    """Otherwise the refusal of its session, which comes seconds later, would be sent to the next gate."""

    async def run() -> None:
        async with robot(tmp_path / "report") as made:
            await made.replace()
            await trio.sleep(Session.LONG_S / 2)
            made.wires[0]._scope.cancel()
            while len(made.wires) < 2:  # noqa: ASYNC110  # until the next wire starts
                await trio.sleep(0.001)
            await made.until(Mode.DISARMED, standby=True)
            await trio.sleep(20.0)
            assert isinstance(await made.gate.ask(Resume("a test"), 1.0), Resumed)

    run_virtual(run)


def test_saf_016_a_standby_whose_session_was_refused_tries_again(tmp_path: Path) -> None:
    """The controller still counts the session of the earlier standby. A moving robot continues meanwhile."""

    async def run() -> None:
        async with robot(tmp_path / "report") as made:
            Session.refusals = 1
            await made.replace()
            await made.until(Mode.ARMED, standby=True)
            await made.gate.ask(Stop(Reason.STOP, "a test"), 3.0)
            await made.until(Mode.DISARMED, standby=True)
            assert isinstance(await made.gate.ask(Resume("a test"), 1.0), Resumed)

    run_virtual(run)


def test_saf_016_a_standby_whose_stop_processes_have_ended_ends_and_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def run() -> None:
        async with robot(tmp_path / "report") as made:
            assert made.exit_codes == []
            monkeypatch.setattr(Session, "lack", "no process of UsbStop is ready to stop the robot")
            await trio.sleep(0.1)
            assert made.exit_codes and set(made.exit_codes) == {NO_CHANNEL}

    run_virtual(run)
