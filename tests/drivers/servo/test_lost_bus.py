"""Test a tree with the real driver when it loses the link to a bus of servos in memory. The servos' registers
decide (SAF-020)."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import StopChannel, WireDown
from strands_actors.drivers.common.dynamixel import protocol as dynamixel
from strands_actors.drivers.common.dynamixel import table
from strands_actors.drivers.common.dynamixel.wire import DynamixelStopChannel, DynamixelWire
from strands_actors.drivers.common.ports.serial_port import BytePort
from strands_actors.drivers.common.twin.servo_bus import ServoBus
from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.drivers.dynamixel.twin import DynamixelBus
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.feetech.wire import FeetechStopChannel, FeetechWire
from strands_actors.kernel.clock import Clock
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Acquire,
    Lease,
    Resume,
    Resumed,
    Setpoint,
    Stop,
    StopReport,
)
from strands_actors.testing import InlineTree, open_inline_tree
from tests.drivers.common.memory_port import MemoryPort, Peer, servos, virtual

MUTE = 5


class Cable:
    """Servos behind a port that can be unplugged, with answers that can get lost."""

    def __init__(self, bus: ServoBus[Any, Any], protocol: Any, torque: Any) -> None:
        self.bus = bus
        self.protocol = protocol
        self.ports: list[MemoryPort] = []
        self.plugged = True
        self.deaf_to: set[int] = set()  # servos with answers that get lost
        self._torque = torque
        self._servos: Peer = servos(bus)

    def open_port(self, path: str, baud: int) -> BytePort:
        if not self.plugged:
            raise WireDown(f"{path}: cannot open")
        self.ports.append(MemoryPort(self._peer))
        return self.ports[-1]

    def _peer(self, data: bytes) -> Iterable[tuple[float, bytes]]:
        for at_s, reply in self._servos(data):
            (packet,) = self.protocol.Decoder().feed(reply)
            if packet.id not in self.deaf_to:
                yield at_s, reply

    def pull(self) -> None:
        self.plugged = False
        for port in self.ports:
            port.unplugged = True

    def torque(self) -> list[int]:
        self.bus.pass_time()
        return [servo.get(self._torque) for servo in self.bus.servos]

    def energise(self) -> None:
        for servo in self.bus.servos:
            servo.write(self._torque.address, b"\1")

    def first_frames(self, since_s: float) -> list[str]:
        """Return the kind of the first frame on each port that was written to since then."""
        kinds = []
        for port in self.ports:
            written = b"".join(data for at_s, data in port.written if at_s >= since_s)
            if packets := list(self.protocol.Decoder().feed(written)):
                kinds.append(
                    self.protocol.safe_state(packets[0], range(1, 7)) or self.protocol.classify(packets[0])
                )
        return kinds

    def limps(self, since_s: float) -> list[float]:
        return [
            at_s
            for port in self.ports
            for at_s, data in port.written
            if at_s >= since_s and self.protocol.LIMP in data
        ]


class LocalFeetech(FeetechWire):
    def handover(self) -> tuple[()]:
        return ()


class FeetechCable(Cable):
    def __init__(self) -> None:
        super().__init__(FeetechBus.for_robot("so101", trio.current_time), feetech, feetech.TORQUE_ENABLE)

    def driver(self) -> Feetech:
        cable = self

        class Arm(Feetech):
            def open_wire(self, clock: Clock) -> FeetechWire:
                return LocalFeetech(self.config, clock, cable.open_port)

            def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
                return FeetechStopChannel(self.config, (), clock, cable.open_port)

        return Arm("so101", "memory", Arm.resolve("so101", {}))


class LocalDynamixel(DynamixelWire):
    def handover(self) -> tuple[()]:
        return ()


class DynamixelCable(Cable):
    def __init__(self) -> None:
        super().__init__(DynamixelBus.for_robot("koch", trio.current_time), dynamixel, table.TORQUE_ENABLE)

    def driver(self) -> Dynamixel:
        cable = self

        class Arm(Dynamixel):
            def open_wire(self, clock: Clock) -> DynamixelWire:
                return LocalDynamixel(self.config, clock, cable.open_port)

            def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
                return DynamixelStopChannel(self.config, (), clock, cable.open_port)

        return Arm("koch", "memory", Arm.resolve("koch", {}))


both = pytest.mark.parametrize("cable_class", [FeetechCable, DynamixelCable])
NewCable = Callable[[], Any]


@contextlib.asynccontextmanager
async def moving(cable: Any) -> AsyncIterator[InlineTree]:
    async with open_inline_tree(driver=cable.driver()) as tree:
        assert isinstance(await tree.gate.ask(Resume("test"), 3.0), Resumed)
        lease = await tree.gate.ask(Acquire("test"), 1.0)
        assert isinstance(lease, Lease)
        deadline_ns = tree.node.clock.now_ns() + 10**8
        setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, {"shoulder_pan": 20.0}, 0.0, latched=True)
        assert isinstance(await tree.gate.ask(setpoint, 1.0), Accepted)
        await trio.sleep(0.2)
        assert cable.torque() == [1] * 6
        yield tree


async def stop(tree: InlineTree, reason: Reason = Reason.STOP) -> StopReport:
    report = await tree.gate.ask(Stop(reason), 2.0)
    assert isinstance(report, StopReport)
    return report


@both
def test_saf_020_replies_are_lost_and_writes_pass(cable_class: NewCable) -> None:
    async def main() -> None:
        cable = cable_class()
        async with moving(cable) as tree:
            cable.deaf_to.update(range(1, 7))
            deaf_s = trio.current_time()
            await tree.until("lost", within_s=1.5)
            await trio.sleep(0.05)
            assert cable.torque() == [0] * 6, "torque is off as soon as the link is given up"
            assert min(cable.limps(deaf_s)) - trio.current_time() < 0.1
            for pause_s in (0.0, 0.7, 1.9, 3.3):  # at any phase of the attempts to open it again
                await trio.sleep(pause_s)
                cable.energise()
                stopped_s = trio.current_time()
                report = await stop(tree)
                assert not report.confirmed and all(motor.written for motor in report.motors)
                assert min(cable.limps(stopped_s)) - stopped_s <= 0.02
                assert cable.torque() == [0] * 6
            assert len(tree.wires_made) == 1, "the wire did not count as frozen"

    virtual(main)


@both
@pytest.mark.parametrize("reason", [Reason.STOP, Reason.ESTOP, Reason.CALLER])
def test_saf_020_the_cable_is_back_and_one_servo_stays_mute(cable_class: NewCable, reason: Reason) -> None:
    async def main() -> None:
        cable = cable_class()
        async with moving(cable) as tree:
            cable.pull()
            await trio.sleep(1.5)
            assert cable.torque() == [1] * 6, "without a link the torque cannot be turned off"
            cable.deaf_to.add(MUTE)
            cable.plugged = True
            plugged_s = trio.current_time()
            await trio.sleep(2.5)
            assert set(cable.first_frames(plugged_s)) <= {"limp", "read"}
            assert cable.first_frames(plugged_s)[0] == "limp", "the safe frame is sent before any ping"
            assert cable.torque() == [0] * 6
            assert (await tree.status()).mode == "lost"
            cable.energise()
            report = await stop(tree, reason)
            assert [motor.id for motor in report.motors if not motor.safe] == [MUTE]
            assert cable.torque() == [0] * 6
            cable.deaf_to.clear()
            await tree.until("ended" if reason is Reason.CALLER else "disarmed", within_s=8.0)

    virtual(main)


@both
def test_saf_020_the_stop_channel_reopens_a_port_that_was_unplugged(cable_class: NewCable) -> None:
    async def main() -> None:
        cable = cable_class()
        async with moving(cable) as tree:
            path = tree.driver.stop_channel((), tree.node.clock)
            await path.make_safe("hold")
            cable.pull()
            for report in await path.make_safe("limp"):
                assert not report.written and "cannot open" in report.detail
            cable.deaf_to.add(MUTE)
            cable.plugged = True
            reports = await path.make_safe("limp")
            assert [report.id for report in reports if not report.safe] == [MUTE]
            assert cable.torque() == [0] * 6
            assert cable.first_frames(0.0)[-1] == "limp"
            cable.deaf_to.clear()
            assert all(report.safe for report in await path.make_safe("limp")), "another stop is confirmed, too"
            path.close()

    virtual(main)


@both
def test_nothing_is_written_to_servos_that_were_never_armed(cable_class: NewCable) -> None:
    async def main() -> None:
        cable = cable_class()
        async with open_inline_tree(driver=cable.driver()) as tree:
            cable.pull()
            await tree.until("down", within_s=1.0)
            cable.energise()  # by another program
            cable.plugged = True
            plugged_s = trio.current_time()
            await tree.until("disarmed", within_s=5.0)
            assert cable.limps(plugged_s) == []
            assert cable.torque() == [1] * 6

    virtual(main)
