"""Wire and stop channel on the twin's wire, in this process: what is answered, when, and what is
said of it."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import MotorReport, Observation, PermitDenied, WireDown
from strands_actors.drivers.common.twin import WireLog as TwinLog
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import Monitoring, State, decode_command, encode_monitoring
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.stop_channel import KukaStopChannel
from strands_actors.drivers.kuka.twin import KukaServer
from strands_actors.drivers.kuka.wire import KukaWire
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.realtime import WIRE_PRIORITY, run_first, run_like_others
from strands_actors.testing import WireLog
from strands_actors.testing.wirelog import Entry

PATIENCE_S = 20.0
TTL_S = 0.1
"""A setpoint that is not re-sent for so long has ended."""
SLACK_S = 0.4
"""For a busy machine."""


class Permit:
    """May be taken away."""

    def __init__(self) -> None:
        self.denied = False

    def check(self) -> None:
        if self.denied:
            raise PermitDenied("a stop is waiting")


class Rig:
    """A twin and the wire that answers it, in one loop."""

    def __init__(self, server: KukaServer, driver: Kuka, log: WireLog, nursery: trio.Nursery) -> None:
        self.server = server
        self.controller = server.controller
        self.driver = driver
        self.log = log
        self.clock = MonotonicClock()
        wire = driver.open_wire(self.clock)
        assert isinstance(wire, KukaWire)
        self.wire = wire
        self.permit = Permit()
        self._nursery = nursery
        self._serving = trio.CancelScope()
        self._ended = trio.Event()
        self._ended.set()

    async def connect(self) -> None:
        """As the transport does, up to an active session."""
        await self.wire.open()
        self._serving = trio.CancelScope()
        await self._nursery.start(self._serve)
        await self.until(lambda: self.controller.state == State.COMMANDING_ACTIVE)
        await self.wire.arm(self.permit)

    async def _serve(self, task_status: trio.TaskStatus[None]) -> None:
        self._ended = trio.Event()
        with self._serving:
            await self.wire.serve(task_status)
        self._ended.set()

    async def lose(self) -> None:
        """As the transport does with a link that is lost: the wire stays open for a safe state that
        is owed."""
        self._serving.cancel()
        await self._ended.wait()

    async def stop_channel(self) -> KukaStopChannel:
        """End the wire as its process would; the root's channel with its duplicate."""
        fd = os.dup(self.wire.handover()[0])
        await self.release()
        return KukaStopChannel(self.driver.config, (fd,), self.clock)

    async def release(self) -> None:
        await self.lose()
        self.wire.close()
        self.driver.kept.release()

    async def write(self, rad: float) -> None:
        """Aim joint1 so far from where it is told to be."""
        target = list(self.controller.commanded)
        target[0] += rad
        await self.wire.write((*target, 0.02), self.permit)

    async def moving(self, setpoints: int) -> None:
        """Move joint1 until so many answers have shown it."""
        target = [*self.controller.commanded]
        target[0] += 1.0
        with trio.fail_after(PATIENCE_S):
            while self.setpoints() <= setpoints:
                await self.wire.write((*target, 0.02), self.permit)
                await trio.sleep(0.02)

    async def until(self, reached: Callable[[], Any], within_s: float = PATIENCE_S) -> None:
        with trio.fail_after(within_s):
            while not reached():  # noqa: ASYNC110  # the twin's doing
                await trio.sleep(0.002)

    async def hears(self, state: State, within_s: float = PATIENCE_S) -> None:
        """The wire has been told so: the controller knows it earlier."""
        with trio.fail_after(within_s):
            while (await self.wire.read()).sensors["fri_state"] != (float(state),):  # noqa: ASYNC110
                await trio.sleep(0.002)

    def last_setpoint(self) -> Entry:
        return self.log.host("setpoint")[-1]

    def setpoints(self, since_ns: int = 0) -> int:
        return len(self.log.host("setpoint", since_ns))


def on_a_twin(
    tmp_path: Path, test: Callable[[Rig], Awaitable[None]], options: dict[str, Any] | None = None, **keywords: Any
) -> None:
    async def main() -> None:
        path = tmp_path / "wire.ndjson"
        server = KukaServer(arm_of("kuka_iiwa"), TwinLog(str(path)), {"sample_ms": 5, **(options or {})})
        async with trio.open_nursery() as nursery:
            server.plug()
            nursery.start_soon(server.serve)
            driver = Kuka("kuka_iiwa", keywords.pop("port", server.address), {"connect_timeout": 1.0, **keywords})
            rig = Rig(server, driver, WireLog(path), nursery)
            try:
                await test(rig)
            finally:
                await rig.release()
                server.close()
                nursery.cancel_scope.cancel()

    run_first(WIRE_PRIORITY)  # where the system permits it: a hundred cycles in a row are to be answered in time
    try:
        trio.run(main)
    finally:
        run_like_others()


def all_safe(reports: tuple[MotorReport, ...]) -> bool:
    assert [report.axis for report in reports] == [f"joint{number}" for number in range(1, 8)]
    return all(report.safe for report in reports)


# -- motion lives as long as its setpoint


def test_saf_004_a_setpoint_that_nobody_re_sends_ends(tmp_path: Path) -> None:
    """Gate or watchdog are frozen: the wire goes on answering, and moves the arm no more."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.write(1.0)
        written_ns = time.monotonic_ns()
        await trio.sleep(TTL_S + SLACK_S)
        moved = rig.log.host("setpoint", written_ns)
        assert moved and moved[-1].t_ns - written_ns < (TTL_S + SLACK_S / 2) * 1e9
        assert rig.controller.state == State.COMMANDING_ACTIVE, "the session is answered all the same"
        rig.log.no_setpoint_after_safe(moved[0].t_ns)

    on_a_twin(tmp_path, test)


def test_saf_004_a_setpoint_that_is_re_sent_goes_on(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        began, target = rig.controller.commanded[0], [*rig.controller.commanded]
        target[0] += 0.3
        for _ in range(25):
            await rig.wire.write((*target, 0.02), rig.permit)
            await trio.sleep(0.02)
        assert rig.controller.commanded[0] - began == pytest.approx(0.3, abs=1e-6)
        await rig.wire.arm(rig.permit)
        moved = rig.setpoints()
        await trio.sleep(TTL_S / 2)
        assert rig.setpoints() <= moved + 1, "arming holds; one may have been on its way"

    on_a_twin(tmp_path, test)


def test_saf_001_a_permit_that_is_taken_away_ends_the_motion_with_the_next_answer(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.permit.denied = True
        denied_ns = time.monotonic_ns()
        await rig.until(lambda: rig.log.host("safe", denied_ns))
        await trio.sleep(0.1)
        assert rig.setpoints(denied_ns) <= 1, "one may have been on its way"
        rig.log.no_setpoint_after_safe(denied_ns)
        with pytest.raises(PermitDenied):
            await rig.write(1.0)

    on_a_twin(tmp_path, test)


def test_saf_002_after_a_stop_no_answer_moves_the_arm(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(10)
        began_ns = time.monotonic_ns()
        reports = await rig.wire.make_safe("hold")
        assert all_safe(reports) and reports[0].acknowledged
        await trio.sleep(0.1)
        rig.log.no_setpoint_after_safe(began_ns)
        assert rig.controller.state == State.COMMANDING_ACTIVE, "holding is answering"
        stood = rig.controller.plant.position_rad[0]
        await trio.sleep(0.2)
        assert rig.controller.plant.position_rad[0] == pytest.approx(stood, abs=0.002)

    on_a_twin(tmp_path, test)


def test_a_target_is_refused_while_the_session_is_not_active(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        rig.controller.motion = False
        await rig.hears(State.MONITORING_READY)
        await trio.sleep(0.05)
        with pytest.raises(PermitDenied, match="MONITORING_READY"):
            await rig.write(0.01)
        assert all(not decode_command(entry.data).position for entry in rig.log.host("safe")[-3:])

    on_a_twin(tmp_path, test)


@pytest.mark.parametrize("sample_ms", [2, 5, 10])
def test_a_motion_at_full_speed_is_taken_whole_by_the_controller(tmp_path: Path, sample_ms: int) -> None:
    """It would abort at a step past speed x sample time."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        target = [*rig.controller.commanded]
        target[3] += 0.3
        while abs(rig.controller.commanded[3] - target[3]) > 1e-6:
            if rig.controller.state == State.COMMANDING_ACTIVE:
                await rig.wire.write((*target, 0.0), rig.permit)
            await trio.sleep(0.02)
        assert rig.controller.motion, "it was not aborted"

    on_a_twin(tmp_path, test, {"sample_ms": sample_ms})


# -- connecting


@pytest.mark.parametrize(("sample_ms", "multiplier"), [(1, 1), (1, 5), (100, 1), (10, 3)])
def test_a_cycle_that_cannot_be_kept_is_refused_by_name(tmp_path: Path, sample_ms: int, multiplier: int) -> None:
    async def test(rig: Rig) -> None:
        why = (
            rf"FRI sample time {sample_ms} ms, receive multiplier {multiplier}\. Set a sample time of 2 ms or more"
        )
        with pytest.raises(WireDown, match=why):
            await rig.wire.open()
        assert not [entry for entry in rig.log.entries() if entry.sender == "host"], "nothing was answered"

    on_a_twin(tmp_path, test, {"sample_ms": sample_ms, "multiplier": multiplier})


def test_a_session_that_gets_too_quick_is_refused_before_it_is_answered(tmp_path: Path) -> None:
    """Sample time 0 would be no time to move in, a huge one a jump."""

    async def test(rig: Rig) -> None:
        await rig.wire.open()
        for sample_ms in (0, 1, 1000):
            rig.controller.sample_ms = sample_ms
            with pytest.raises(WireDown, match=f"FRI sample time {sample_ms} ms"), trio.fail_after(PATIENCE_S):
                await rig.wire.serve()

    on_a_twin(tmp_path, test)


def test_nobody_speaks(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        rig.server.unplug()
        with pytest.raises(WireDown, match=r"no FRI message of 127\.\S+ at UDP port \d+ within 0.2 s"):
            await rig.wire.open()

    on_a_twin(tmp_path, test, connect_timeout=0.2)


def test_only_the_controller_that_was_named_is_heard(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        with pytest.raises(WireDown, match=r"no FRI message of 127\.0\.0\.9"):
            await rig.wire.open()

    def another(server_port: str) -> str:
        return f"127.0.0.9:{server_port}"

    port = free_port()
    on_a_twin(tmp_path, test, {"port": port}, port=another(str(port)), connect_timeout=0.3)


def test_without_a_port_whoever_speaks_first_is_the_controller(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        assert (await rig.wire.read()).sensors["fri_state"] == (State.COMMANDING_ACTIVE,)

    port = free_port()
    on_a_twin(tmp_path, test, {"port": port, "from_port": free_port()}, port="", fri_port=port)


def test_a_stranger_that_speaks_later_is_not_answered(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        said = Monitoring(1, state=State.COMMANDING_WAIT, sample_ms=5, interpolated=(1.0,) * 7)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.1", 0))
            stranger.setblocking(False)
            for _ in range(20):
                stranger.sendto(encode_monitoring(said), ("127.0.0.1", rig.driver.config.address()[1]))
                await trio.sleep(0.005)
            with pytest.raises(BlockingIOError):
                stranger.recv(100)
        assert rig.controller.state == State.COMMANDING_ACTIVE

    on_a_twin(tmp_path, test)


def test_saf_009_a_second_program_on_the_port_is_refused(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        second = Kuka("kuka_iiwa", rig.server.address, {}).open_wire(rig.clock)
        with pytest.raises(WireDown, match=r"UDP port \d+ cannot be opened .* Check who else has it"):
            await second.open()

    on_a_twin(tmp_path, test)


def test_saf_009_a_stop_ends_the_wait_for_an_active_session(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        rig.controller.motion = False
        await rig.hears(State.MONITORING_READY)
        async with trio.open_nursery() as nursery:

            async def stop() -> None:
                await trio.sleep(0.1)
                rig.permit.denied = True

            nursery.start_soon(stop)
            with pytest.raises(PermitDenied), trio.fail_after(1.5):
                await rig.wire.arm(rig.permit)

    on_a_twin(tmp_path, test)


def test_a_session_that_is_only_monitored_is_armed_all_the_same(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        rig.controller.safety = 1
        await rig.wire.open()
        with trio.fail_after(1.0):
            seen = await rig.wire.arm(rig.permit)
        assert seen.sensors["safety_state"] == (1,)

    on_a_twin(tmp_path, test)


# -- the link


def test_saf_012_silence_is_a_lost_link_and_the_port_stays_ours(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        rig.server.unplug()
        last: Observation = await rig.wire.read()
        with trio.fail_after(PATIENCE_S), pytest.raises(WireDown, match=r"no FRI message for 0\.5 s"):
            while True:
                assert await rig.wire.read() == last
                await trio.sleep(0.01)
        fd = os.dup(rig.wire.handover()[0])  # as the root has it
        try:
            await rig.lose()
            rig.server.plug()
            rig.wire = KukaWire(rig.driver.config, rig.clock, rig.driver.kept)
            await rig.wire.open()
        finally:
            os.close(fd)

    on_a_twin(tmp_path, test)


def test_saf_020_a_lost_link_is_written_to_unasked_and_answered_when_it_is_back(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.server.set_fault("off")  # it says nothing more
        await trio.sleep(0.05)
        await rig.lose()
        last = [entry for entry in rig.log.entries() if entry.sender == "host"][-1]
        rig.server.set_fault("delayed")  # it hears, and what it says comes late
        lost_ns = time.monotonic_ns()
        reports = await rig.wire.reach("hold")
        assert reports[0].written
        first = decode_command(rig.log.host("safe", lost_ns)[0].data)
        assert first.reflected == decode_command(last.data).reflected, "before anything new was heard"
        rig.server.set_fault("ok")
        assert all_safe(await rig.wire.reach("hold"))
        rig.log.no_setpoint_after_safe(lost_ns)
        rig.server.unplug()
        reports = await rig.wire.reach("hold")
        assert not all_safe(reports) and reports[0].detail == "the controller says nothing"

    on_a_twin(tmp_path, test)


def test_saf_020_a_wire_that_never_had_a_link_stops_whoever_speaks(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        assert all_safe(await rig.wire.reach("hold"))
        assert await rig.wire.open()

    on_a_twin(tmp_path, test)


def test_saf_020_the_stop_channel_opens_a_socket_of_its_own_when_it_was_given_none(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        channel = rig.driver.stop_channel((), rig.clock)
        assert all_safe(await channel.make_safe("hold"))
        channel.close()
        await rig.wire.open()
        channel = rig.driver.stop_channel((), rig.clock)
        reports = await channel.make_safe("hold")
        channel.close()
        assert not all_safe(reports) and "Check who else has it" in reports[0].detail

    on_a_twin(tmp_path, test)


def test_saf_005_a_stop_that_nobody_asks_for_is_sent_and_is_not_confirmed(tmp_path: Path) -> None:
    """The controller hears and is not heard: who is not heard may hear."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.server.set_fault("delayed")  # what it says comes later than anything waits
        await trio.sleep(0.03)
        began_ns = time.monotonic_ns()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(rig.wire.make_safe, "hold")
            await trio.sleep(0.02)
            assert rig.log.host("safe", began_ns), "before anything was heard"
            rig.server.unplug()
        reports = await rig.wire.make_safe("hold")
        assert not all_safe(reports)
        assert "no FRI message for" in reports[0].detail

    on_a_twin(tmp_path, test)


def test_saf_005_an_arm_that_goes_on_moving_is_not_called_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes the answers and does something else."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        plant = rig.controller.plant
        monkeypatch.setattr(rig.controller, "aim", lambda position: None)

        async def drift() -> None:
            rad = plant.position_rad[0]
            while True:
                rad += 0.005
                plant.set_target(0, rad)
                await trio.sleep(0.01)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(drift)
            await trio.sleep(0.2)
            reports = await rig.wire.make_safe("hold")
            nursery.cancel_scope.cancel()
        assert not all_safe(reports)
        assert reports[0].written and reports[0].detail == "it still moves"

    on_a_twin(tmp_path, test)


# -- the stop channel


def test_saf_003_the_root_answers_in_the_wires_place_and_moves_nothing(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(10)
        told = decode_command(rig.last_setpoint().data)
        channel = await rig.stop_channel()
        began_ns = time.monotonic_ns()
        reports = await channel.make_safe("hold")
        assert all_safe(reports)
        assert "held by the root" in reports[0].detail
        assert rig.controller.state == State.COMMANDING_ACTIVE, "the session lives as long as it is answered"
        answers = [decode_command(entry.data) for entry in rig.log.host("safe", began_ns)]
        assert len(answers) > 20
        assert {answer.position for answer in answers} == {rig.controller.commanded}
        numbers = [answer.sequence for answer in answers]
        assert numbers[0] > told.sequence and numbers == [*range(numbers[0], numbers[0] + len(numbers))]
        rig.log.no_setpoint_after_safe(began_ns)
        channel.close()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", rig.driver.config.address()[1]))
        await rig.until(lambda: rig.controller.state == State.MONITORING_WAIT)

    on_a_twin(tmp_path, test)


def test_saf_003_what_waited_while_the_wire_was_frozen_is_not_answered(tmp_path: Path) -> None:
    """Only the newest message is: the others are over, and their positions old."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(10)
        channel = await rig.stop_channel()
        await trio.sleep(0.04)
        said = rig.controller.commanded
        began_ns = time.monotonic_ns()
        assert all_safe(await channel.make_safe("hold"))
        first = decode_command(rig.log.host("safe", began_ns)[0].data)
        assert first.position == said
        second = decode_command(rig.log.host("safe", began_ns)[1].data)
        assert 0 < second.reflected - first.reflected <= 3
        rig.log.no_setpoint_after_safe(began_ns)
        channel.close()

    on_a_twin(tmp_path, test)


def test_the_root_does_not_answer_a_stranger_in_its_place(tmp_path: Path) -> None:
    """It spoke at the same port before the controller did."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        said = Monitoring(1, state=State.COMMANDING_ACTIVE, sample_ms=5, commanded=(1.0,) * 7)
        channel = await rig.stop_channel()
        rig.server.freeze(0.03)
        await trio.sleep(0.02)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.1", 0))
            stranger.setblocking(False)
            stranger.sendto(encode_monitoring(said), ("127.0.0.1", rig.driver.config.address()[1]))
            assert all_safe(await channel.make_safe("hold"))
            with pytest.raises(BlockingIOError):
                stranger.recv(100)
        channel.close()

    on_a_twin(tmp_path, test)


def test_saf_005_a_controller_that_says_nothing_to_the_root_is_not_confirmed(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        channel = await rig.stop_channel()
        rig.server.unplug()
        await trio.sleep(0.02)
        with trio.fail_after(PATIENCE_S):
            reports = await channel.make_safe("hold")
        channel.close()
        assert not all_safe(reports)

    on_a_twin(tmp_path, test)


def test_a_session_that_only_monitors_is_reported_as_held_by_its_own_program(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        rig.controller.motion = False
        await rig.hears(State.MONITORING_READY)
        reports = await rig.wire.make_safe("hold")
        assert all_safe(reports)
        assert reports[0].detail == "FRI session is MONITORING_READY: the robot's own program holds it"

    on_a_twin(tmp_path, test)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("0.0.0.0", 0))
        return int(sock.getsockname()[1])
