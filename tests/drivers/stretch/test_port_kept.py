"""Test a stop on ports that another process has open, so that they cannot be opened again."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.serial_port import BytePort
from strands_actors.drivers.stretch.chains import ChainStopChannel
from strands_actors.drivers.stretch.config import StretchConfig
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import Permission, virtual

from .rig import WRIST, Rig


class Adopted(ChainStopChannel):
    """A stop channel with a duplicate of the wire's port."""

    def __init__(self, rig: Rig, config: StretchConfig) -> None:
        self._rig = rig

        def locked(path: str, baud: int) -> BytePort:
            raise WireDown(f"{path}: in use by the standby")

        (chain,) = [one for one in config.chains if one.usb.endswith(WRIST)]
        super().__init__(config, chain, (0,), VirtualClock(), locked)

    def adopt(self, descriptor: int) -> BytePort:
        return self._rig.open_port(WRIST, 115_200)


@pytest.mark.parametrize("armed", [True, False])
def test_saf_018_servos_without_torque_do_not_cost_the_way_to_them(armed: bool) -> None:
    """Otherwise servos that are not armed are never confirmed, and the root keeps the port for a minute."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        if armed:
            await wire.arm(Permission())
        channel = Adopted(rig, rig.config)
        for _ in range(2):
            reports = await channel.make_safe("stop")
            assert all(report.safe for report in reports), reports

    virtual(test)


def test_saf_018_servos_that_are_silent_for_a_while_are_confirmed_when_they_are_back() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        channel = Adopted(rig, rig.config)
        rig.mute.add(WRIST)
        reports = await channel.make_safe("stop")
        assert {(report.safe, report.detail) for report in reports} == {(False, "silent")}
        rig.mute.clear()
        await trio.sleep(0.5)
        assert all(report.safe for report in await channel.make_safe("stop"))

    virtual(test)
