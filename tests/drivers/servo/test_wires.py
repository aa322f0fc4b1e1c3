"""Test what all wires of servos have in common when they make the robot safe, on the twin's servos in memory."""

from __future__ import annotations

import pytest
import trio

from tests.drivers.common.memory_port import virtual

from .rig import JOINTS, DynamixelRig, FeetechRig, Rig

both = pytest.mark.parametrize("rig_class", [FeetechRig, DynamixelRig])


@both
def test_limp_is_confirmed_motor_by_motor(rig_class: type[Rig]) -> None:
    async def main() -> None:
        rig = await rig_class().armed()
        began = trio.current_time()
        reports = await rig.wire.make_safe("limp")
        assert rig.port.written[0][0] == began, "the first frame is written without any wait"
        assert rig.port.written[0][1].startswith(rig.protocol.RESYNC + rig.protocol.LIMP)
        assert [report.id for report in reports] == [1, 2, 3, 4, 5, 6]
        assert all(report.safe and report.written and report.acknowledged for report in reports)
        assert rig.torque() == [0] * 6
        assert rig.requests("setpoint", "enable") == []
        assert trio.current_time() - began < 0.05

    virtual(main)


@both
def test_a_motor_that_missed_the_broadcasts_gets_a_separate_frame(rig_class: type[Rig]) -> None:
    async def main() -> None:
        rig = await rig_class().armed()
        broadcast, write = rig.protocol.BROADCAST, rig.protocol.WRITE
        rig.filter(lambda packet: not (packet.id == broadcast and packet.code == write))
        reports = await rig.wire.make_safe("limp")
        assert all(report.safe for report in reports)
        assert rig.torque() == [0] * 6

    virtual(main)


@both
@pytest.mark.parametrize("safe_state", ["hold", "limp", "a safe state nobody knows"])
def test_a_dead_link_gives_a_report_and_no_error(rig_class: type[Rig], safe_state: str) -> None:
    async def main() -> None:
        rig = rig_class()
        for report in await rig.wire.make_safe(safe_state):
            assert (report.written, report.safe, report.detail) == (False, False, "not connected")
        await rig.armed()
        rig.port.unplugged = True
        reports = await rig.wire.make_safe(safe_state)
        assert [report.axis for report in reports] == list(JOINTS)
        for report in reports:
            assert (report.written, report.acknowledged, report.safe) == (False, False, False)
            assert "the port is gone" in report.detail
        rig.wire.close()

    virtual(main)
