"""SAF-016: the processes that the standby watches. Real processes stand for root and wire, and the robot
is a fake.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.heartbeat import new_page, words_of
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.standby.messages import WatchOver
from strands_actors.supervisors.standby.process import Standby
from strands_actors.supervisors.standby.report import read
from tests.fake_kinds import PEERS, FakeBase
from tests.kernel.kernel import real_time, until

ROBOT = "fake_base"
LOOKS_S = 0.2
"""Time for many looks of the standby."""


class Pair:
    """A root and a wire that run, and the shared page of a robot that may be energised."""

    def __init__(self) -> None:
        self.root, self.wire = subprocess.Popen(["sleep", "60"]), subprocess.Popen(["sleep", "60"])
        self.page = new_page()
        self.safety_page = SafetyPage(words_of(self.page))
        self.safety_page.may_be_energised = True

    @asynccontextmanager
    async def watched(self, wire: int, report: Path) -> AsyncIterator[None]:
        """Run a standby that watches the root and ``wire``."""
        exit_codes: list[int] = []
        port = str(report)
        driver = FakeBase(ROBOT, port, {})
        watched = WatchOver(self.root.pid, wire, (os.dup(self.page),))
        node = Node(ROBOT, MonotonicClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            standby = Standby(driver, ROBOT, port, report, watched, exit_codes.append)
            await nursery.start(node.cell(addresses.of(ROBOT).path("standby"), lambda: standby).run)
            yield
            await until(lambda: exit_codes == [0])
            nursery.cancel_scope.cancel()
        (safe,) = PEERS[port].of("safe")
        assert safe.path == "stop_channel"


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    for process in (made.root, made.wire):
        process.kill()
        process.wait()
    os.close(made.page)


@real_time
async def test_saf_016_the_standby_acts_when_root_and_wire_have_ended(pair: Pair, tmp_path: Path) -> None:
    report = tmp_path / "report"
    pair.safety_page.wire_pid = pair.wire.pid
    async with pair.watched(pair.wire.pid, report):
        pair.wire.kill()
        await trio.sleep(LOOKS_S)
        assert not report.exists(), "the root still runs"
        pair.root.kill()
    result = read(report)
    assert result is not None and result.confirmed and result.over


@real_time
async def test_saf_016_the_standby_waits_for_a_wire_that_the_dead_root_had_not_announced(
    pair: Pair, tmp_path: Path
) -> None:
    """Otherwise there were two writers. The wire makes the robot safe by itself."""
    report = tmp_path / "report"
    async with pair.watched(0, report):
        pair.safety_page.wire_pid = pair.wire.pid
        pair.root.kill()
        await trio.sleep(LOOKS_S)
        assert not report.exists()
        pair.wire.kill()
    assert read(report) is not None
