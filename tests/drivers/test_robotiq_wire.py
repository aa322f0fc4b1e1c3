"""The Robotiq wire and its second path against the twin's gripper, in memory under virtual time."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

import pytest
import trio
from memory_port import MemoryPort
from trio.testing import MockClock

from strands_actors.drivers.common.modbus import SILENT_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.faults import Reply
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.robotiq.twin import ModbusSession, RobotiqTwin, twin_of
from strands_actors.drivers.robotiq.wire import READ_S, RobotiqSecondPath, RobotiqWire
from strands_actors.runtime.clock import VirtualClock
from strands_actors.runtime.contract import MotorReport, Observation, PermitDenied, WireDown

OPENS_WITHIN_S = 1.2
STOPS_WITHIN_S = 1.2


class Permission:
    def __init__(self, denied_at: int | None = None) -> None:
        self.checks = 0
        self._denied_at = denied_at

    def check(self) -> None:
        if self.checks == self._denied_at:
            raise PermitDenied
        self.checks += 1


class Rig:
    """A wire on the twin's gripper, in memory. ``written``: kinds of what the gripper was told, in order."""

    def __init__(self, options: dict[str, Any] | None = None, **bench: Any) -> None:
        self.driver = Robotiq("robotiq_2f85", "192.0.2.10", options or {})
        self.twin: RobotiqTwin = twin_of("robotiq_2f85", trio.current_time, **bench)
        self.clock = VirtualClock()
        self.wire = RobotiqWire(self.driver, self.clock, self.connect)
        self.ports: list[MemoryPort] = []
        self.written: list[str] = []
        self.questions = 0
        self.silent_from: int | None = None  # the number of the first question that is not answered
        self.delay_s: Callable[[int], float] = lambda _: 0.001

    async def connect(self, host: str, port: int) -> MemoryPort:
        assert (host, port) == ("192.0.2.10", 502)
        session = ModbusSession(self.twin)

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            for exchange in session.receive(data, None):
                if exchange.kind != "read":
                    self.written.append(exchange.kind)
                self.questions += 1
                if self.silent_from is not None and self.questions > self.silent_from:
                    continue
                for reply in exchange.replies:
                    yield self.delay_s(self.questions) + reply.late_s, reply.data

        await trio.lowlevel.checkpoint()
        self.ports.append(MemoryPort(peer))
        return self.ports[-1]

    async def armed(self) -> Rig:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.written.clear()
        return self

    async def go(self, closed: float, speed: float = 1.0, force: float = 1.0) -> None:
        await self.wire.write((closed, speed, force), Permission())

    async def observe_for(self, seconds: float) -> Observation:
        end_s = trio.current_time() + seconds
        while True:
            seen = await self.wire.read()
            if trio.current_time() >= end_s:
                return seen
            await trio.sleep(0.02)

    async def stop(self) -> MotorReport:
        (report,) = await self.wire.make_safe("hold")
        return report

    async def second_path(self) -> MotorReport:
        path = RobotiqSecondPath(self.driver, self.clock, self.connect)
        (report,) = await path.make_safe("hold")
        path.close()
        assert self.ports[-1].closed
        return report


def virtual(test: Callable[[], Awaitable[None]]) -> None:
    trio.run(test, clock=MockClock(autojump_threshold=0))


def sensor(seen: Observation, name: str) -> float:
    (value,) = seen.sensors[name]
    return value


async def refused(rig: Rig) -> str:
    with pytest.raises(WireDown) as down:
        await rig.wire.arm(Permission())
    return str(down.value)


# -- open


def test_open_moves_nothing_and_tells_who_is_there() -> None:
    async def main() -> None:
        rig = Rig()
        facts = await rig.wire.open()
        assert facts == {"port": "192.0.2.10", "unit_id": 9, "stroke_mm": 85.0}
        json.dumps(facts)
        assert rig.written == []
        seen = await rig.wire.read()
        assert (sensor(seen, "activation"), sensor(seen, "fault")) == (0, 0)
        assert rig.wire.handover() == ()

    virtual(main)


def test_another_unit_is_refused_by_name() -> None:
    async def main() -> None:
        rig = Rig({"unit_id": 0})
        with pytest.raises(WireDown, match="gateway no response") as down:
            await rig.wire.open()
        assert "unit_id" in str(down.value)
        assert rig.ports[0].closed, "a wire that did not open keeps no connection"

    virtual(main)


def test_a_silent_gripper_is_named_within_its_bound() -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.set_fault(Fault.OFF)
        began_s = trio.current_time()
        with pytest.raises(WireDown, match="no answer"):
            await rig.wire.open()
        assert trio.current_time() - began_s < OPENS_WITHIN_S
        assert rig.ports[0].closed

    virtual(main)


def test_a_port_that_is_no_address_is_told_as_such() -> None:
    async def main() -> None:
        rig = Rig()
        rig.driver.port = "/dev/ttyUSB0:x"
        with pytest.raises(WireDown, match="Give an address"):
            await rig.wire.open()

    virtual(main)


# -- arm


def test_arming_activates_and_waits_for_it() -> None:
    async def main() -> None:
        rig = Rig(activation_s=3.0)
        await rig.wire.open()
        began_s = trio.current_time()
        seen = await rig.wire.arm(Permission())
        assert 3.0 <= trio.current_time() - began_s < 3.2
        assert sensor(seen, "activation") == 3
        assert rig.written == ["safe", "enable", "safe"]

    virtual(main)


def test_arming_an_active_gripper_moves_nothing() -> None:
    async def main() -> None:
        rig = Rig(activated=True, object_mm=30)
        rig.twin.write(0, p.Command(go_to=True, position=200).registers())
        await rig.wire.open()
        await rig.observe_for(1.0)
        held = (await rig.wire.read()).position
        rig.written.clear()
        seen = await rig.wire.arm(Permission())
        assert rig.written == ["safe"]
        assert seen.position == held
        assert rig.twin.gripper.status().request == rig.twin.gripper.status().position

    virtual(main)


def test_activation_can_be_withheld() -> None:
    async def main() -> None:
        rig = Rig({"activate": False})
        await rig.wire.open()
        assert "whole stroke" in await refused(rig)
        assert rig.written == []

    virtual(main)


def test_an_activation_that_does_not_end_is_named() -> None:
    async def main() -> None:
        rig = Rig(activation_s=99.0)
        await rig.wire.open()
        began_s = trio.current_time()
        assert "did not finish its activation within 10 s (gSTA 1" in await refused(rig)
        assert trio.current_time() - began_s < rig.driver.timing.arm_s
        assert (await rig.stop()).safe
        assert rig.twin.gripper.status().activation == 0, "only a reset ends an activation"

    virtual(main)


def test_major_faults_are_cleared_by_activation() -> None:
    async def main() -> None:
        rig = Rig(activated=True, gflt=0x0E)
        await rig.wire.open()
        assert (await rig.wire.read()).faults == {"gripper": "over-current (gFLT 14)"}
        seen = await rig.wire.arm(Permission())
        assert seen.faults == {}
        assert "enable" in rig.written

    virtual(main)


def test_a_minor_fault_stays_and_is_named() -> None:
    async def main() -> None:
        rig = Rig(gflt=0x08)
        await rig.wire.open()
        assert (await rig.wire.arm(Permission())).faults == {"gripper": "over temperature (gFLT 8)"}

    virtual(main)


def test_an_automatic_release_is_waited_out_by_people() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        rig.twin.write(0, p.Command(go_to=True, position=200).registers())
        await rig.wire.open()
        await rig.observe_for(0.5)
        rig.twin.write(0, p.Command(release=True).registers())
        assert "automatic release is running" in await refused(rig)
        report = await rig.stop()
        assert (report.written, report.acknowledged, report.safe) == (True, True, False)
        assert "the fingers open" in report.detail

    virtual(main)


def test_arming_is_refused_when_the_gripper_does_not_take_the_position() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        await rig.wire.open()
        rig.twin.set_fault(Fault.WRONG)
        assert "does not take its position as target" in await refused(rig)

    virtual(main)


@pytest.mark.parametrize("denied_at", range(12))
def test_a_stop_during_arming_wins(denied_at: int) -> None:
    async def main() -> None:
        rig = Rig(activation_s=0.3)
        await rig.wire.open()
        with pytest.raises(PermitDenied):
            await rig.wire.arm(Permission(denied_at))
        assert (await rig.stop()).safe
        status = rig.twin.gripper.status()
        assert status.activation != p.Activation.ACTIVATING and not status.going

    virtual(main)


# -- moving


def test_a_move_arrives_at_its_speed() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.8, speed=0.0)
        assert (await rig.observe_for(1.0)).position[0] == pytest.approx(0.01 + 20 / 85, abs=0.02)
        seen = await rig.observe_for(3.0)
        assert seen.position == (0.8,)
        assert sensor(seen, "aperture_mm") == pytest.approx(17.0)
        assert (sensor(seen, "moving"), sensor(seen, "contact")) == (0.0, 0.0)
        assert rig.written == ["setpoint"]

    virtual(main)


def test_an_object_is_felt_and_held() -> None:
    async def main() -> None:
        rig = await Rig(object_mm=42.5).armed()
        await rig.go(1.0, force=0.5)
        seen = await rig.observe_for(1.0)
        assert seen.position[0] == pytest.approx(0.5, abs=0.01)
        assert sensor(seen, "contact") == 1.0
        assert sensor(seen, "current_a") == pytest.approx(0.64, abs=0.01)
        await rig.go(0.0)
        seen = await rig.observe_for(1.0)
        assert sensor(seen, "contact") == 0.0

    virtual(main)


def test_objects_are_not_believed_before_the_echo() -> None:
    async def main() -> None:
        rig = await Rig(object_mm=42.5, echo_s=0.03).armed()
        await rig.go(1.0)
        assert sensor(await rig.observe_for(1.0), "contact") == 1.0
        await rig.go(0.2, speed=0.0)
        seen = await rig.wire.read()
        assert rig.twin.gripper.status().contact == p.Contact.CLOSING, "it still tells of the last command"
        assert math.isnan(sensor(seen, "contact")) and math.isnan(sensor(seen, "moving"))
        seen = await rig.observe_for(0.1)
        assert sensor(seen, "moving") == 1.0
        assert seen.faults == {}

    virtual(main)


def test_a_write_stops_at_the_permit() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        with pytest.raises(PermitDenied):
            await rig.wire.write((0.5, 1.0, 1.0), Permission(0))
        assert rig.written == []

    virtual(main)


def test_a_gripper_that_was_reset_is_never_told_to_go() -> None:
    """A setpoint has rACT set: it would activate the gripper, through its whole stroke."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.5)
        await rig.observe_for(1.0)
        rig.twin.power_cycle()
        rig.written.clear()
        with pytest.raises(WireDown, match="no longer activated"):
            await rig.observe_for(1.0)
        with pytest.raises(WireDown, match="not activated"):
            await rig.go(0.7)
        assert (await rig.stop()).safe
        assert rig.written == ["safe"]
        assert rig.twin.gripper.status().activation == 0

    virtual(main)


# -- answers that are late or missing


@pytest.mark.parametrize("late", range(1, 20))
def test_one_late_answer_shifts_nothing(late: int) -> None:
    """The reference never came back from it: every command and every stop was refused from then on."""

    async def main() -> None:
        rig = Rig(activated=True)
        rig.delay_s = lambda number: 0.2 if number == late else 0.001
        await rig.armed()
        await rig.go(0.4)
        await rig.observe_for(0.5)
        await rig.go(0.6)
        seen = await rig.observe_for(1.0)
        assert seen.position == (0.6,)
        assert seen.faults == {}
        report = await rig.stop()
        assert report.safe and report.detail == ""
        assert len(rig.ports) == 1

    virtual(main)


def test_with_every_answer_late_it_still_drives() -> None:
    async def main() -> None:
        rig = Rig(activated=True)
        await rig.wire.open()
        rig.twin.set_fault(Fault.DELAYED)
        await rig.wire.arm(Permission())
        await rig.go(0.6)
        began_s = trio.current_time()
        seen = await rig.observe_for(1.0)
        assert seen.position == (0.6,)
        assert trio.current_time() - seen.t_ns / 1e9 < rig.driver.timing.state_ttl_s
        assert (await rig.stop()).safe
        assert trio.current_time() - began_s < 1.5

    virtual(main)


def test_a_reading_is_never_waited_for_long() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.silent_from = rig.questions
        first = await rig.wire.read()
        began_s = trio.current_time()
        while True:
            asked_s = trio.current_time()
            try:
                seen = await rig.wire.read()
            except WireDown as down:
                assert "no answer for" in str(down)
                break
            assert trio.current_time() - asked_s <= READ_S + 0.001
            assert seen.t_ns == first.t_ns, "an old reading keeps its age"
        assert trio.current_time() - began_s < SILENT_S + 0.2

    virtual(main)


def test_a_gripper_that_answers_two_of_three_is_driven() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.INTERMITTENT)
        await rig.go(0.6)
        assert (await rig.observe_for(2.0)).position == (0.6,)
        assert (await rig.stop()).safe

    virtual(main)


def test_damaged_answers_end_the_connection() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.GARBAGE)
        with pytest.raises(WireDown):
            await rig.observe_for(1.0)

    virtual(main)


def test_what_was_not_taken_is_told() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.STUCK)
        await rig.go(0.5)
        seen = await rig.observe_for(0.2)
        assert seen.faults == {"gripper": "unconfirmed: asked for 128, it repeats 3"}
        assert math.isnan(sensor(seen, "contact"))
        rig.twin.set_fault(Fault.OK)
        assert (await rig.observe_for(1.0)).faults == {}

    virtual(main)


@pytest.mark.parametrize("silent_from", range(40))
def test_silence_at_any_point_of_connect_and_of_a_move_is_bounded(silent_from: int) -> None:
    async def main() -> None:
        rig = Rig(activation_s=0.5)
        rig.silent_from = silent_from
        began_s = trio.current_time()
        with pytest.raises(WireDown):
            await rig.wire.open()
            with trio.fail_after(rig.driver.timing.arm_s):
                await rig.wire.arm(Permission())
            await rig.go(0.5)
            await rig.observe_for(60)
        silent_s = trio.current_time() - began_s
        assert silent_s < 4.0
        began_s = trio.current_time()
        report = await rig.stop()
        assert not report.safe and report.detail
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        rig.silent_from = None
        rig.wire.close()
        await rig.armed()
        await rig.go(0.3)
        assert (await rig.observe_for(2.0)).position[0] == pytest.approx(0.3, abs=0.003)

    virtual(main)


# -- stop


def test_a_stop_holds_where_it_is_and_is_read_back() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(1.0)
        began_s = trio.current_time()
        report = await rig.stop()
        assert report == MotorReport("gripper", 9, True, True, True)
        assert trio.current_time() - began_s < 0.01
        assert rig.written == ["setpoint", "safe"]
        held = (await rig.observe_for(0.1)).position
        assert (await rig.observe_for(2.0)).position == held
        assert rig.twin.gripper.status().activation == 3, "it keeps its grip"

    virtual(main)


def test_the_stop_leaves_before_anything_is_waited_for() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9)
        rig.silent_from = rig.questions
        await rig.wire.read()
        before = len(rig.ports[0].written)
        began_s = trio.current_time()
        await rig.stop()
        at_s, frame = rig.ports[0].written[before]
        assert at_s == began_s
        assert frame[7:10] == b"\x10\x03\xe8"
        assert rig.written[-1] == "safe"

    virtual(main)


def test_a_stop_that_is_not_taken_is_not_called_success() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9)
        await rig.observe_for(0.1)
        rig.twin.set_fault(Fault.STUCK)
        report = await rig.stop()
        assert report == MotorReport("gripper", 9, True, True, False, "still going to its position")

    virtual(main)


def test_a_stop_without_a_connection_names_why() -> None:
    async def main() -> None:
        rig = Rig()
        assert (await rig.stop()).detail == "not connected"
        await rig.armed()
        rig.ports[0].unplugged = True
        report = await rig.stop()
        assert not report.written and "the port is gone" in report.detail
        with pytest.raises(WireDown):
            await rig.wire.read()

    virtual(main)


# -- the second path


@pytest.mark.parametrize("number", range(3), ids=["noise", "a lost end", "a wrong byte"])
def test_saf_005_a_stop_is_written_to_a_gripper_that_is_not_understood(number: int) -> None:
    """Its connection is gone, over nonsense; and what it says on a new one is none the better."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(1.0, speed=0.0)
        await rig.observe_for(0.2)
        rig.twin.set_fault(Fault.GARBAGE)
        rig.wire.close()
        rig.written.clear()
        for _ in range(number):  # the next answer is damaged in the next way
            rig.twin.faults.apply(Reply(0.0, b"answer"))
        (report,) = await rig.wire.reach("hold")
        assert rig.written[:1] == ["safe"]
        assert (report.written, report.safe) == (True, False), "it is not understood, so it is not confirmed"
        assert rig.ports[-1].closed

    virtual(main)


def test_nothing_is_written_to_a_gripper_that_says_nothing() -> None:
    """It may have been without power: being told to hold would activate it, and moves its fingers."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.wire.close()
        rig.written.clear()
        rig.silent_from = rig.questions
        (report,) = await rig.wire.reach("hold")
        assert (rig.written, report.written, report.safe) == ([], False, False)
        assert await RobotiqWire(rig.driver, rig.clock, rig.connect).reach("hold") == (), "never connected"

    virtual(main)


def test_a_gripper_that_answers_again_is_held_by_what_it_says() -> None:
    """Without power meanwhile, it is not activated by a stop."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.wire.close()
        rig.twin.power_cycle()
        rig.written.clear()
        await rig.wire.reach("hold")
        assert "enable" not in rig.written
        assert "setpoint" not in rig.written

    virtual(main)


def test_the_second_path_stops_a_move_on_its_own_connection() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.9, speed=0.0)
        await rig.observe_for(0.5)
        assert (await rig.second_path()).safe
        assert len(rig.ports) == 2
        assert rig.written == ["setpoint", "safe"]
        status = rig.twin.gripper.status()
        assert not status.going and status.activation == 3

    virtual(main)


def test_the_second_path_ends_an_activation() -> None:
    async def main() -> None:
        rig = Rig(activation_s=5.0)
        await rig.wire.open()
        with trio.move_on_after(0.5):
            await rig.wire.arm(Permission())
        assert rig.twin.gripper.status().activation == p.Activation.ACTIVATING
        assert (await rig.second_path()).safe
        assert rig.twin.gripper.status().activation == p.Activation.RESET

    virtual(main)


def test_the_second_path_never_activates() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.power_cycle()
        assert (await rig.second_path()).safe
        assert "enable" not in rig.written
        assert rig.twin.gripper.status().activation == p.Activation.RESET

    virtual(main)


def test_the_second_path_to_a_silent_gripper_is_bounded_and_honest() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.OFF)
        began_s = trio.current_time()
        report = await rig.second_path()
        assert not report.safe and not report.written and report.detail
        assert trio.current_time() - began_s < STOPS_WITHIN_S

    virtual(main)


def test_the_second_path_without_a_way_is_honest() -> None:
    async def main() -> None:
        rig = Rig()

        async def no_way(host: str, port: int) -> MemoryPort:
            raise WireDown("192.0.2.10:502: cannot connect (refused)")

        (report,) = await RobotiqSecondPath(rig.driver, rig.clock, no_way).make_safe("hold")
        assert report == MotorReport("gripper", 9, False, False, False, "192.0.2.10:502: cannot connect (refused)")

    virtual(main)


def test_a_target_that_somebody_else_changes_is_told() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0.4)
        assert (await rig.observe_for(1.0)).faults == {}
        rig.twin.write(0, p.Command(go_to=True, position=7).registers())
        assert "unconfirmed" in (await rig.observe_for(0.1)).faults["gripper"]
        await rig.go(0.4)
        assert (await rig.observe_for(0.1)).faults == {}

    virtual(main)


# -- what it costs

LEAN = """
import sys
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.runtime.clock import MonotonicClock
driver = Robotiq("robotiq_2f85", "192.0.2.10", {})
before = "pymodbus" in sys.modules
driver.open_wire(MonotonicClock())
driver.second_path((), MonotonicClock())
print(before, *sorted(name for name in ("pymodbus", "numpy", "mujoco", "serial") if name in sys.modules))
"""


def test_pymodbus_is_loaded_when_it_is_needed_and_nothing_heavy_ever() -> None:
    done = subprocess.run([sys.executable, "-c", LEAN], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "pymodbus"]
