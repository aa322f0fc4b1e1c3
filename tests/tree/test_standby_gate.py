"""SAF-016: nothing is armed without a standby, or while the root could not stop the robot. A robot that
moves already continues. In virtual time.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Resume, Resumed, StandbyIs, Stop, StopReport
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeStopChannel

from .writer import armed


def test_saf_016_nothing_is_armed_without_a_standby() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            tree.gate.tell(StandbyIs("it has ended"))
            answer = await tree.gate.ask(Resume("a test"), 1.0)
            assert isinstance(answer, Refused) and answer.code == "no_standby", answer
            assert "it has ended" in answer.reason and answer.remedy
            assert tree.hardware.of("enable") == []
            assert (await tree.status()).mode == "disarmed"
            assert (await tree.status()).no_standby == "it has ended"
            tree.gate.tell(StandbyIs())
            assert isinstance(await tree.gate.ask(Resume("a test"), 1.0), Resumed)

    run_virtual(run)


def test_saf_016_a_robot_that_moves_continues_without_a_standby_and_is_not_armed_again() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            tree.gate.tell(StandbyIs("it has ended"))
            assert isinstance(await writer.send(a=1.0), Accepted)
            assert isinstance(await tree.gate.ask(Stop(Reason.STOP, "a test"), 2.0), StopReport)
            answer = await tree.gate.ask(Resume("a test"), 1.0)
            assert isinstance(answer, Refused) and answer.code == "no_standby", answer
            await trio.sleep(1.0)
            assert (await tree.status()).mode == "disarmed"

    run_virtual(run)


def test_saf_016_nothing_is_armed_while_no_stop_process_of_the_root_is_ready(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lacks = [""]
    monkeypatch.setattr(FakeStopChannel, "lacks", property(lambda _: lacks[0]))

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            lacks[0] = "no process of UsbStop is ready to stop the robot"
            await trio.sleep(0.03)
            assert isinstance(await writer.send(a=1.0), Accepted), (
                "the wire and the standby can still stop the robot"
            )
            assert isinstance(await tree.gate.ask(Stop(Reason.STOP, "a test"), 2.0), StopReport)
            answer = await tree.gate.ask(Resume("a test"), 1.0)
            assert isinstance(answer, Refused) and answer.code == "no_standby" and lacks[0] in answer.reason, answer
            lacks[0] = ""
            await trio.sleep(0.03)
            assert isinstance(await tree.gate.ask(Resume("a test"), 1.0), Resumed)

    run_virtual(run)
