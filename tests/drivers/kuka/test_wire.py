"""Test the wire on the twin's, in this process: its answers and their times."""

from __future__ import annotations

import socket
import time
from pathlib import Path

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import Monitoring, State, decode_command, encode_monitoring
from tests.ports import free_port

from .rig import PATIENCE_S, SLACK_S, TTL_S, Rig, all_safe, on_a_twin

# -- motion lives as long as its setpoint


def test_saf_004_a_setpoint_that_is_not_re_sent_ends(tmp_path: Path) -> None:
    """Gate or watchdog are frozen. The wire goes on answering, but stops moving the arm."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.write(1.0)
        written_ns = time.monotonic_ns()
        await trio.sleep(TTL_S + SLACK_S)
        moved = rig.log.host("setpoint", written_ns)
        assert moved and moved[-1].t_ns - written_ns < (TTL_S + SLACK_S / 2) * 1e9
        assert rig.controller.state == State.COMMANDING_ACTIVE, (
            "the session stays active, because it is still answered"
        )
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
        assert rig.setpoints() <= moved + 1, "arming holds, and one setpoint may have been under way"

    on_a_twin(tmp_path, test)


def test_saf_001_a_permit_that_is_taken_away_ends_the_motion_with_the_next_answer(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.permit.denied = True
        denied_ns = time.monotonic_ns()
        await rig.until(lambda: rig.log.host("safe", denied_ns))
        await trio.sleep(0.1)
        assert rig.setpoints(denied_ns) <= 1, "one setpoint may have been under way"
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
        assert rig.controller.state == State.COMMANDING_ACTIVE, (
            "a hold is also an answer, so the session stays active"
        )
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
    """The controller would abort at a step larger than speed x sample time."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        target = [*rig.controller.commanded]
        target[3] += 0.3
        while abs(rig.controller.commanded[3] - target[3]) > 1e-6:
            if rig.controller.state == State.COMMANDING_ACTIVE:
                await rig.wire.write((*target, 0.0), rig.permit)
            await trio.sleep(0.02)
        assert rig.controller.motion, "the motion was not aborted"

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
        assert not [entry for entry in rig.log.entries() if entry.sender == "host"], "the wire answered nothing"

    on_a_twin(tmp_path, test, {"sample_ms": sample_ms, "multiplier": multiplier})


def test_a_session_that_gets_too_quick_is_refused_before_it_is_answered(tmp_path: Path) -> None:
    """A sample time of 0 leaves no time to move. A huge one would allow a jump."""

    async def test(rig: Rig) -> None:
        await rig.wire.open()
        for sample_ms in (0, 1, 1000):
            rig.controller.sample_ms = sample_ms
            with pytest.raises(WireDown, match=f"FRI sample time {sample_ms} ms"), trio.fail_after(PATIENCE_S):
                await rig.wire.serve()

    on_a_twin(tmp_path, test)


def test_no_controller_sends(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        rig.server.unplug()
        with pytest.raises(WireDown, match=r"no FRI message from 127\.\S+ at UDP port \d+ within 0.2 s"):
            await rig.wire.open()

    on_a_twin(tmp_path, test, connect_timeout=0.2)


def test_only_messages_of_the_named_controller_are_read(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        with pytest.raises(WireDown, match=r"no FRI message from 127\.0\.0\.9"):
            await rig.wire.open()

    def another(server_port: str) -> str:
        return f"127.0.0.9:{server_port}"

    port = free_port(socket.SOCK_DGRAM)
    on_a_twin(tmp_path, test, {"port": port}, port=another(str(port)), connect_timeout=0.3)


def test_without_a_port_the_first_sender_is_the_controller(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        assert (await rig.wire.read()).sensors["fri_state"] == (State.COMMANDING_ACTIVE,)

    port = free_port(socket.SOCK_DGRAM)
    on_a_twin(tmp_path, test, {"port": port, "from_port": free_port(socket.SOCK_DGRAM)}, port="", fri_port=port)


def test_a_later_foreign_sender_is_not_answered(tmp_path: Path) -> None:
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
        with pytest.raises(WireDown, match=r"UDP port \d+ cannot be opened .* Another program may use it"):
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
