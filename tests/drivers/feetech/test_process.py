"""Test the Feetech wire against the twin's own process, on a pty."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.serial_port import adopt_serial, open_serial
from strands_actors.drivers.feetech import protocol
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.wire import FeetechWire
from strands_actors.kernel.clock import MonotonicClock
from tests.answers import until
from tests.drivers.common.memory_port import Permission
from tests.drivers.common.twin_process import TwinProcess
from tests.drivers.servo.rig import JOINTS, VICTIM, read_until, verdicts


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path) as process:
        yield process


async def connected(wire: FeetechWire) -> dict[str, Any]:
    """Open the wire, with retries as a supervisor does. On a busy machine the twin may miss a ping."""
    for _ in range(9):
        with contextlib.suppress(WireDown):
            return await wire.open()
    return await wire.open()


def host_kinds(twin: TwinProcess) -> list[str]:
    return [kind for kind, _ in twin.logged("host")]


def on(twin: TwinProcess) -> tuple[Feetech, FeetechWire]:
    driver = Feetech("so101", twin.port, Feetech.resolve("so101", {}))
    return driver, driver.open_wire(MonotonicClock())


def test_the_process_opens_arms_moves_and_stops(twin: TwinProcess) -> None:
    async def main() -> None:
        _, wire = on(twin)
        facts = await connected(wire)
        assert facts["port"] == twin.port
        seen = await wire.arm(Permission())
        target = list(seen.position)
        target[0] += 15.0
        with trio.fail_after(20):
            while abs((await wire.read()).position[0] - target[0]) > 3.0:
                await wire.write(tuple(target), Permission())
                await trio.sleep(0.02)
        assert all(verdicts(await wire.make_safe("hold")).values())
        assert all(verdicts(await wire.make_safe("limp")).values())
        wire.close()

        kinds = host_kinds(twin)
        assert kinds.index("safe") < kinds.index("enable") < kinds.index("setpoint")
        stopped = len(kinds) - kinds[::-1].index("setpoint")
        assert "safe" in kinds[stopped:] and "enable" not in kinds[stopped:]

    trio.run(main)


@pytest.mark.parametrize("fault", ["off", "delayed", "garbage"])
def test_the_process_with_a_faulty_servo_stops_the_other_five(twin: TwinProcess, fault: str) -> None:
    async def main() -> None:
        _, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        twin.command(f"fault {fault}:{VICTIM}")
        seen = await read_until(wire, lambda seen: "silent" in seen.faults.get("elbow_flex", ""))
        later = await read_until(wire, lambda now: now.stamp_ns[0] > seen.stamp_ns[0] + 1_000_000_000)
        assert set(later.faults) == {"elbow_flex"}, "the other servos work on"
        reports = await wire.make_safe("limp")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        assert reports[VICTIM - 1].detail
        twin.command(f"fault ok:{VICTIM}")
        await read_until(wire, lambda seen: not seen.faults)
        await wire.arm(Permission())
        assert all(verdicts(await wire.make_safe("limp")).values())
        wire.close()

    trio.run(main)


def test_the_stop_channel_makes_the_robot_of_a_dead_owner_limp(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        descriptors = [os.dup(fd) for fd in wire.handover()]
        setpoint = protocol.sync_write(protocol.GOAL_POSITION, dict.fromkeys(driver.ids, 3000))
        os.write(wire.handover()[0], setpoint[:13])  # it died in the middle of a frame
        os.close(wire.handover()[0])  # as the kernel does, without a goodbye

        second = driver.stop_channel(descriptors, MonotonicClock())
        before = len(host_kinds(twin))
        reports = await second.make_safe("limp")
        assert all(report.safe and report.written for report in reports), reports
        assert "setpoint" not in host_kinds(twin)[before:]
        second.close()

        again = driver.open_wire(MonotonicClock())
        facts = await connected(again)
        assert not any(facts["energised"].values())
        again.close()

    trio.run(main)


def test_the_stop_channel_can_hold_too(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        second = driver.stop_channel([os.dup(fd) for fd in wire.handover()], MonotonicClock())
        assert all(verdicts(await second.make_safe("hold")).values())
        second.close()
        wire.close()

    trio.run(main)


def test_two_masters_are_refused_and_a_closed_port_can_be_opened_again(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        other = driver.open_wire(MonotonicClock())
        with pytest.raises(WireDown, match="in use"):
            await other.open()
        kept = os.dup(wire.handover()[0])  # the root's descriptor: must not keep us out
        wire.close()
        await connected(other)
        other.close()
        os.close(kept)

    trio.run(main)


def test_an_unplugged_cable_is_a_lost_link_and_comes_back(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        twin.command("unplug")
        until(lambda: not os.path.exists(twin.port), "the port is gone")
        with pytest.raises(WireDown, match="the port is gone"):
            await wire.read()
        for report in await wire.make_safe("limp"):
            assert not report.safe and not report.written and "the port is gone" in report.detail
        wire.close()

        again = driver.open_wire(MonotonicClock())
        with pytest.raises(WireDown, match="cannot open"):
            await again.open()
        twin.command("plug")
        until(lambda: os.path.exists(twin.port), "the port is back")
        await connected(again)
        assert all(verdicts(await again.make_safe("limp")).values())
        again.close()

    trio.run(main)


def test_an_invalid_serial_port_is_refused(tmp_path: Path) -> None:
    async def main() -> None:
        for path in (tmp_path / "none", tmp_path):
            wire = Feetech("so101", str(path), Feetech.resolve("so101", {})).open_wire(MonotonicClock())
            with pytest.raises(WireDown, match="cannot open"):
                await wire.open()

    trio.run(main)


def test_a_port_that_hangs_up_differs_from_one_with_data() -> None:
    async def main() -> None:
        master, slave = os.openpty()
        port = open_serial(os.ttyname(slave), 1_000_000)
        os.close(slave)
        adopted = adopt_serial(os.dup(port.fileno()))
        gone = trio.Event()

        async def watch() -> None:
            await adopted.hung_up()
            gone.set()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(watch)
            os.write(master, b"data that nobody takes here")
            await trio.sleep(0.1)
            assert not gone.is_set()
            assert port.take() == b"data that nobody takes here"
            assert port.take() == b""
            os.close(master)
            with trio.fail_after(5):
                await gone.wait()
        adopted.close()
        port.close()

    trio.run(main)


def test_saf_020_the_root_lets_go_of_a_port_that_was_pulled_and_opens_it_again_when_it_is_needed(
    twin: TwinProcess,
) -> None:
    """A process that kept it open would give the adapter another name when it comes back."""

    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        path = driver.stop_channel([os.dup(fd) for fd in wire.handover()], MonotonicClock())
        with trio.fail_after(10):
            async with trio.open_nursery() as nursery:
                await nursery.start(path.serve)
                twin.command("unplug")
                wire.close()
        assert path.port is None  # type: ignore[attr-defined]
        for report in await path.make_safe("limp"):
            assert not report.written and not report.safe and twin.port in report.detail
        twin.command("plug")
        until(lambda: os.path.exists(twin.port), "it is plugged in")
        assert all(verdicts(await path.make_safe("limp")).values())
        path.close()

    trio.run(main)
