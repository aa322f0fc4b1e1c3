"""SAF-010: a stop that the gate refuses has not stopped the robot, so the wire is fenced and the root
makes safe. The tests read the simulated robot's wire log.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes import directory
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.root.locks import Locks
from strands_actors.supervisors.stop_result import Confirmed, StopResult
from strands_actors.testing import Twin
from tests.answers import json_of

from .helpers import limps

CODES = ("gone", "crashed", "mailbox_full")


class Refuses:
    """A gate that refuses each stop, because its mailbox is full or it has crashed."""

    def __init__(self, gate: Any, code: str) -> None:
        self._gate = gate
        self._refusal = Refused(code, "the gate has not read this")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._gate, name)

    async def ask(self, message: Message, deadline_s: float) -> Message | None:
        return self._refusal

    def ask_here(self, message: Message, deadline_s: float) -> Message | None:
        return self._refusal


@pytest.mark.parametrize("code", CODES)
def test_saf_010_a_stop_that_the_gate_refuses_is_carried_out_by_the_root(
    arm: RealRobot, twin: Twin, run_dir: Path, code: str
) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    tree = arm._tree
    assert tree is not None
    processes: Any = tree._processes
    processes.gate = Refuses(processes.gate, code)
    began_ns = time.monotonic_ns()
    report = json_of(arm.stop())
    assert (report["safe_state"], report["path"], report["unconfirmed"]) == ("limp", "stop_channel", [])
    assert limps(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    assert isinstance(portal().call(tree.stop, Reason.ESTOP, True), Confirmed)
    assert Locks(run_dir / "data" / "locks", "so101", twin.port).find() is not None


@pytest.mark.parametrize("code", CODES)
def test_saf_010_a_refused_stop_of_another_process_is_carried_out_by_the_root(
    arm: RealRobot, twin: Twin, run_dir: Path, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    ask = directory.Directory._ask

    async def refusing(
        self: Any, address: str, protocol: Any, message: Message, deadline_s: float
    ) -> Message | None:
        if protocol is Gate:
            return Refused(code, "the gate has not read this")
        return await ask(self, address, protocol, message, deadline_s)

    monkeypatch.setattr(directory.Directory, "_ask", refusing)

    async def press() -> StopResult:
        async with directory.join() as joined:
            (note,) = joined.notes
            assert note.port == twin.port
            return await joined.stop(note, Reason.ESTOP, "the button", lock=True)

    began_ns = time.monotonic_ns()
    assert isinstance(portal().call(press), Confirmed)
    assert limps(twin.log, began_ns)
    assert Locks(run_dir / "data" / "locks", "so101", twin.port).find() is not None
