"""A wire that is ready before its root has announced its actors."""

from __future__ import annotations

import trio

from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.health.heartbeat import pair
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.failsafe import Mode, State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Status
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.wire.group import InlineWire
from strands_actors.testing import FakeHardware, run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver

AT = addresses.of("late")


async def status_with_a_root_after(late_s: float) -> Status:
    """Return the gate's status a moment after the guardian has started."""
    hardware = HARDWARE["late"] = FakeHardware()
    driver = FakeDriver("fake", "late", {})
    node = Node("late", VirtualClock())
    roots, wires = pair()
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            InlineWire(node, nursery, driver, "late", State(Mode.DOWN, 1, ""), "", wires)
            await trio.sleep(late_s)
            guardian = Guardian(driver, roots, lambda *_: None)  # type: ignore[arg-type, return-value]
            await nursery.start(node.cell(AT.path("guardian"), lambda: guardian).run)
            await trio.sleep(0.05)
            answer = await node.ref(AT.gate, Gate).ask(GetStatus(), 1.0)
            assert isinstance(answer, Status)
            assert hardware.of("setpoint") == []
            nursery.cancel_scope.cancel()
            return answer
    finally:
        del HARDWARE["late"]


def test_the_wire_waits_for_a_late_root() -> None:
    async def run() -> None:
        status = await status_with_a_root_after(1.0)
        assert (status.mode, status.connect_error) == (Mode.DISARMED, "")

    run_virtual(run)


def test_the_wire_does_not_wait_for_ever() -> None:
    async def run() -> None:
        status = await status_with_a_root_after(FakeDriver.timing.handover_s + 0.05)
        assert "the root process did not answer" in status.connect_error

    run_virtual(run)
