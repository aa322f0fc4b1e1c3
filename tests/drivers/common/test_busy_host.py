"""Test that a busy host, which has no time to read answers, is distinguished from servos that do not answer.
The tests run in virtual time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import WireDown
from tests.drivers.servo.rig import VICTIM, DynamixelRig, FeetechRig, Rig, refused

from .memory_port import Permission, virtual

both = pytest.mark.parametrize("rig_class", [FeetechRig, DynamixelRig])


def starve(rig: Rig, code: int, motor: int, times: int) -> None:
    """Lose this number of answers to such a request. The host does not run while it waits for them."""
    port, peer, read = rig.port, rig.port.peer, rig.port.read
    left, hungry = times, False

    def loses(data: bytes) -> Iterable[tuple[float, bytes]]:
        nonlocal left, hungry
        packets: list[Any] = list(rig.protocol.Decoder().feed(data))
        if left and any((packet.code, packet.id) == (code, motor) for packet in packets):
            left, hungry = left - 1, True
            return []
        return peer(data)

    async def late() -> bytes:
        nonlocal hungry
        if hungry:
            hungry = False
            clock = trio.lowlevel.current_clock()
            assert isinstance(clock, MockClock)
            clock.jump(0.6)
        return await read()

    port.peer = loses
    port.read = late  # type: ignore[method-assign]


@both
@pytest.mark.parametrize("code", ["PING", "READ"])
def test_it_asks_once_more_before_it_blames_the_robot(rig_class: type[Rig], code: str) -> None:
    async def main() -> None:
        rig = rig_class()
        starve(rig, getattr(rig.protocol, code), VICTIM, times=1)
        await rig.wire.open()
        await rig.wire.arm(Permission())
        assert rig.torque() == [1] * 6

    virtual(main)


@both
@pytest.mark.parametrize("code", ["PING", "READ"])
def test_a_busy_host_is_named_as_the_cause_and_not_the_cable(rig_class: type[Rig], code: str) -> None:
    async def main() -> None:
        rig = rig_class()
        starve(rig, getattr(rig.protocol, code), VICTIM, times=9)
        text = await refused(rig)
        assert "this host was too busy to read the answer" in text
        assert "ms late" in text
        assert "able" not in text and "two servos" not in text

    virtual(main)


@both
def test_arming_on_a_busy_host_names_the_cause(rig_class: type[Rig]) -> None:
    async def main() -> None:
        rig = rig_class()
        await rig.wire.open()
        starve(rig, rig.protocol.READ, VICTIM, times=9)
        with pytest.raises(WireDown, match=r"arming: this host was too busy to read its position of elbow_flex"):
            await rig.wire.arm(Permission())

    virtual(main)
