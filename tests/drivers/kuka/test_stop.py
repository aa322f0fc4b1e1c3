"""Test what stops the arm, on the twin's wire in this process: a lost link, and the stop channel."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

import pytest
import trio

from strands_actors.contract.wire import Observation, WireDown
from strands_actors.drivers.kuka.protocol import Monitoring, State, decode_command, encode_monitoring
from strands_actors.drivers.kuka.wire import KukaWire

from .rig import PATIENCE_S, Rig, all_safe, on_a_twin

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
        fd = os.dup(rig.wire.handover()[0])  # the descriptor that the root has
        try:
            await rig.lose()
            rig.server.plug()
            rig.wire = KukaWire(rig.driver.config, rig.clock, rig.driver.kept)
            await rig.wire.open()
        finally:
            os.close(fd)

    on_a_twin(tmp_path, test)


def test_saf_020_a_stop_is_written_to_a_lost_link_and_again_when_it_is_back(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.server.set_fault("off")  # the controller sends nothing more
        await trio.sleep(0.05)
        await rig.lose()
        last = [entry for entry in rig.log.entries() if entry.sender == "host"][-1]
        rig.server.set_fault("delayed")  # the controller receives, and its messages come late
        lost_ns = time.monotonic_ns()
        reports = await rig.wire.reach("hold")
        assert reports[0].written
        first = decode_command(rig.log.host("safe", lost_ns)[0].data)
        assert first.reflected == decode_command(last.data).reflected, (
            "the hold is sent before a new message arrives"
        )
        rig.server.set_fault("ok")
        assert all_safe(await rig.wire.reach("hold"))
        rig.log.no_setpoint_after_safe(lost_ns)
        rig.server.unplug()
        reports = await rig.wire.reach("hold")
        assert not all_safe(reports) and reports[0].detail == "the controller sends no messages"

    on_a_twin(tmp_path, test)


def test_saf_020_a_wire_that_never_had_a_link_stops_any_sender(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        assert all_safe(await rig.wire.reach("hold"))
        assert await rig.wire.open()

    on_a_twin(tmp_path, test)


def test_saf_020_the_stop_channel_opens_a_socket_if_it_got_none(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        channel = rig.driver.stop_channel((), rig.clock)
        assert all_safe(await channel.make_safe("hold"))
        channel.close()
        await rig.wire.open()
        channel = rig.driver.stop_channel((), rig.clock)
        reports = await channel.make_safe("hold")
        channel.close()
        assert not all_safe(reports) and "Another program may use it" in reports[0].detail

    on_a_twin(tmp_path, test)


def test_saf_005_a_stop_without_a_controllers_message_is_sent_and_not_confirmed(tmp_path: Path) -> None:
    """The controller receives but its messages do not arrive. A silent peer may still receive."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(3)
        rig.server.set_fault("delayed")  # the messages arrive later than any wait lasts
        await trio.sleep(0.03)
        began_ns = time.monotonic_ns()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(rig.wire.make_safe, "hold")
            await trio.sleep(0.02)
            assert rig.log.host("safe", began_ns), "the hold is sent before any message arrives"
            rig.server.unplug()
        reports = await rig.wire.make_safe("hold")
        assert not all_safe(reports)
        assert "no FRI message for" in reports[0].detail

    on_a_twin(tmp_path, test)


def test_saf_005_an_arm_that_goes_on_moving_is_not_called_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The controller accepts the answers, but moves the arm in another way."""

    async def test(rig: Rig) -> None:
        await rig.connect()
        plant = rig.controller.plant
        monkeypatch.setattr(rig.controller, "set_targets", lambda position: None)

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
        assert reports[0].written and reports[0].detail == "the arm still moves"

    on_a_twin(tmp_path, test)


# -- the stop channel


def test_saf_003_the_root_answers_in_the_wires_place_and_moves_nothing(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        await rig.moving(10)
        command = decode_command(rig.last_setpoint().data)
        channel = await rig.stop_channel()
        began_ns = time.monotonic_ns()
        reports = await channel.make_safe("hold")
        assert all_safe(reports)
        assert "held by the root" in reports[0].detail
        assert rig.controller.state == State.COMMANDING_ACTIVE, "the session stays active while it is answered"
        answers = [decode_command(entry.data) for entry in rig.log.host("safe", began_ns)]
        assert len(answers) > 20
        assert {answer.position for answer in answers} == {rig.controller.commanded}
        numbers = [answer.sequence for answer in answers]
        assert numbers[0] > command.sequence and numbers == [*range(numbers[0], numbers[0] + len(numbers))]
        rig.log.no_setpoint_after_safe(began_ns)
        channel.close()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", rig.driver.config.address()[1]))
        await rig.until(lambda: rig.controller.state == State.MONITORING_WAIT)

    on_a_twin(tmp_path, test)


def test_saf_003_messages_that_waited_in_a_frozen_wire_are_not_answered(tmp_path: Path) -> None:
    """Only the newest message is answered. The cycles of the others are over, and their positions are old."""

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
    """The foreign sender used the same port before the controller did."""

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


def test_saf_005_a_stop_without_messages_to_the_root_is_not_confirmed(tmp_path: Path) -> None:
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


def test_a_session_that_only_monitors_is_reported_as_held_by_the_robots_program(tmp_path: Path) -> None:
    async def test(rig: Rig) -> None:
        await rig.connect()
        rig.controller.motion = False
        await rig.hears(State.MONITORING_READY)
        reports = await rig.wire.make_safe("hold")
        assert all_safe(reports)
        assert reports[0].detail == "FRI session is MONITORING_READY: the robot's own program holds it"

    on_a_twin(tmp_path, test)
