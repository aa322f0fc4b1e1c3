"""Test soft limits, which a service sends to the boards during readings and setpoints; in virtual time."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.wire import WireDown
from tests.drivers.common.memory_port import Permission, virtual

from .rig import ANSWER_S, LIFT, Rig
from .test_wire import LIFT_ALONE, target

ARM_ALONE = 2


def test_soft_limits_are_sent_to_the_boards_of_lift_and_arm() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        reported = await wire.perform("set_soft_limits", {"joint": "arm", "low": 0.1, "high": 0.3}, Permission())
        assert reported == {"joint": "arm", "low": 0.1, "high": 0.3}
        scale = rig.config.parameters.arm.rad_per_m
        assert rig.world.steppers["arm"].limits == pytest.approx((0.1 * scale, 0.3 * scale))
        sensors = (await wire.read()).sensors
        assert (sensors["limit_low"][1], sensors["limit_high"][1]) == (0.1, 0.3)

    virtual(test)


@pytest.mark.parametrize("joint", ["lift", "arm"])
def test_soft_limits_are_sent_during_readings_and_setpoints(joint: str) -> None:
    """A service runs at the same time as both. Each gets the answer to its own request."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        reads = 0

        async def read_and_write() -> None:
            nonlocal reads
            while True:
                seen = await wire.read()
                assert not {"lift", "arm"} & seen.faults.keys(), seen.faults
                reads += 1
                await wire.write(target(LIFT_ALONE | ARM_ALONE, lift=0.5, arm=0.1), Permission())
                await trio.sleep(0.0007)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(read_and_write)
            for at in range(120):
                high = 0.4 + 1e-4 * at
                limits = {"joint": joint, "low": 0.1, "high": high}
                assert await wire.perform("set_soft_limits", limits, Permission()) == limits
                scale = rig.config.motors[joint].rad_per_m
                assert rig.world.steppers[joint].limits == pytest.approx((0.1 * scale, high * scale))
                await trio.sleep(0.0003)
            nursery.cancel_scope.cancel()
        assert reads > 20, "readings go on meanwhile"

    virtual(test)


def test_soft_limits_without_an_acknowledgement_are_not_set_and_delay_nothing() -> None:
    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        rig.mute.add(LIFT)
        limits = {"joint": "lift", "low": 0.3, "high": 0.6}
        longest_s = 0.0

        async def read() -> None:
            nonlocal longest_s
            while True:
                began_s = trio.current_time()
                seen = await wire.read()
                assert (seen.sensors["limit_low"][0], seen.sensors["limit_high"][0]) == (0.0, 1.1)
                longest_s = max(longest_s, trio.current_time() - began_s)
                await trio.sleep(0.02)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(read)
            with pytest.raises(WireDown, match="lift did not acknowledge its motion limits"):
                await wire.perform("set_soft_limits", limits, Permission())
            nursery.cancel_scope.cancel()
        assert longest_s < 0.09, "a wire that does not answer for 0.1 s counts as frozen"

    virtual(test)


@pytest.mark.parametrize("is_cut", [True, False], ids=["cut", "goes_on"])
@pytest.mark.parametrize("safe_state", ["hold", "stop"])
def test_saf_006_a_stop_does_not_wait_for_soft_limits_being_sent(safe_state: str, is_cut: bool) -> None:
    """With ``is_cut`` the service is cancelled, as the transport does when a stop comes."""

    async def test() -> None:
        rig = Rig()
        wire = rig.wire()
        await wire.open()
        await wire.arm(Permission())
        await wire.write(target(LIFT_ALONE, lift=0.9), Permission())
        await trio.sleep(0.2)
        await wire.read()
        limits = {"joint": "lift", "low": 0.1, "high": 1.0}

        async def tell() -> None:
            await wire.perform("set_soft_limits", limits, Permission())

        async with trio.open_nursery() as nursery:
            nursery.start_soon(tell)
            await trio.sleep(ANSWER_S / 2)
            assert rig.kinds[-1][:2] == (LIFT, "config"), "the last frame is the one with a pending acknowledgement"
            rig.kinds.clear()
            began_s = trio.current_time()
            if is_cut:
                nursery.cancel_scope.cancel()
            with trio.CancelScope(shield=True):
                reports = await wire.make_safe(safe_state)
        assert all(report.safe for report in reports), reports
        assert trio.current_time() - began_s < 0.2
        told_s = [at_s for at_s, _ in rig.ports[LIFT][0].written if at_s >= began_s]
        assert told_s[0] == began_s and next(kind for name, kind, _ in rig.kinds if name == LIFT) == "safe"
        assert rig.ports_written("setpoint", "config") == [], "the cancelled service sends nothing after the stop"
        assert rig.world.safe_state == safe_state

    virtual(test)
