"""SAF-024: when no thread can be started, a stop and its reports still work."""

from __future__ import annotations

import threading
from pathlib import Path

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.processes.process import _reap_in_thread
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.supervisors.root.process import Unconfirmed
from strands_actors.supervisors.standby.messages import WatchOver
from strands_actors.supervisors.standby.process import Standby
from strands_actors.supervisors.standby.report import StandbyReport
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeHardware
from tests.answers import until


def no_thread(self: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_saf_024_a_report_that_could_not_be_written_is_written_with_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = tmp_path / "so101.json"
    note.write_text("{}")
    motor = MotorReport("gripper", 6, True, False, False)
    report = StopReport(Reason.WIRE, SafeState.LIMP, 2, False, (motor,))
    unconfirmed = Unconfirmed(str(note))
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", no_thread)
        unconfirmed.tell(report)
    assert note.read_text() == "{}"
    unconfirmed.tell(report)
    until(lambda: msgspec.json.decode(note.read_bytes()).get("unconfirmed"), "the report is written")


def test_saf_024_a_child_that_has_ended_is_reaped_without_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    class Child:
        pid = 0
        polled = False

        def poll(self) -> int:
            self.polled = True
            return 0

        def wait(self) -> int:
            raise AssertionError("it would stop this process")

    monkeypatch.setattr(threading.Thread, "start", no_thread)
    child = Child()
    _reap_in_thread(child)
    assert child.polled


@pytest.mark.parametrize("error", [RuntimeError("can't start new thread"), MemoryError(), OSError(28, "full")])
def test_saf_024_a_standby_continues_when_its_report_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """It still stops the robot."""

    async def run_sync(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(trio.to_thread, "run_sync", run_sync)
    report = StandbyReport("so101", "", "why", SafeState.LIMP, False, (), 0, False)
    watched = WatchOver(0, 0, ())
    monkeypatch.setitem(HARDWARE, "standby", FakeHardware())
    standby = Standby(FakeDriver("fake", "standby", {}), "so101", "", tmp_path / "report", watched, lambda _: None)
    trio.run(standby._tell, report)
