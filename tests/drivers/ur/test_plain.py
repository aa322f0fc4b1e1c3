"""Test the ports without the SDK on the twin: reading, and the stop of the stop channel."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.ur import plain
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS
from strands_actors.drivers.ur.config import URConfig
from strands_actors.drivers.ur.driver import UR
from strands_actors.drivers.ur.stop_channel import WATCHED, stop
from strands_actors.drivers.ur.twin.rtde import WRONG_BY_RAD
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import Twin
from tests.answers import until


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("ur5e", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def host(twin: Twin) -> str:
    return twin.port.partition(":")[0]


def at(host: str) -> URConfig:
    return URConfig("ur5e", host)


async def play(host: str) -> None:
    """Start a program that this twin cannot interpret. It runs for ever."""
    stream = await trio.open_tcp_stream(host, p.SECONDARY_PORT)
    await stream.send_all(b"def forever():\n  while True:\n    sync()\n  end\nend\n")
    with contextlib.closing(await plain.open_samples(host, WATCHED, 125.0)) as samples:
        with trio.fail_after(10):
            while (await samples.next())["runtime_state"] != p.RuntimeState.PLAYING:
                pass
    await stream.aclose()


async def look(host: str) -> None:
    """Read as a wire does when it opens."""
    with contextlib.closing(await plain.open_samples(host, WATCHED, 125.0)) as samples:
        await samples.first()


def test_the_handshake_identifies_the_controller(host: str) -> None:
    facts = trio.run(plain.handshake, host)
    assert facts["remote_control"] == "true"
    assert facts["serial"].isdecimal()
    assert facts["robot_model"] == "UR5"


def test_the_clock_is_seen_to_advance(host: str) -> None:
    trio.run(look, host)


def test_saf_020_a_wire_without_a_link_ends_any_running_program(twin: Twin, host: str) -> None:
    trio.run(play, host)
    wire = UR("ur5e", host, {}).open_wire(MonotonicClock())
    began_ns = time.monotonic_ns()
    reports = trio.run(wire.reach, "stop")
    assert all(report.written and report.safe for report in reports)
    assert [entry.data for entry in twin.log.host("safe", began_ns)] == [b"stop\n"]


def test_a_port_in_addition_to_the_address_is_refused() -> None:
    with pytest.raises(ValueError, match="its ports are fixed"):
        Robot("ur5e", mode="real", port="192.0.2.10:99")


def test_saf_005_stop_ends_the_program_and_confirms_each_joint(twin: Twin, host: str) -> None:
    trio.run(play, host)
    began_ns = time.monotonic_ns()
    reports = trio.run(stop, at(host))
    assert [report.axis for report in reports] == list(JOINTS)
    assert all(report.written and report.acknowledged and report.safe for report in reports)
    assert [entry.data for entry in twin.log.host("safe", began_ns)] == [b"stop\n"]


def test_a_stop_without_a_running_program_is_confirmed(host: str) -> None:
    assert all(report.safe for report in trio.run(stop, at(host)))


def test_without_a_dashboard_a_script_stops(twin: Twin, host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some controllers have no dashboard."""
    trio.run(play, host)
    monkeypatch.setattr(p, "DASHBOARD_PORT", 29998)
    began_ns = time.monotonic_ns()
    reports = trio.run(stop, at(host))
    assert all(report.written and report.safe and not report.acknowledged for report in reports)
    assert [entry.data for entry in twin.log.host("safe", began_ns)] == [p.STOP_SCRIPT]


def test_saf_005_a_frozen_controller_confirms_nothing_in_bounded_time(twin: Twin, host: str) -> None:
    trio.run(play, host)
    twin.pause()
    frozen_ns = time.monotonic_ns()
    try:
        reports = trio.run(stop, at(host))
        assert time.monotonic_ns() - frozen_ns < 3e9
        assert not any(report.safe for report in reports)
        assert all("does not answer" in report.detail for report in reports)
        with pytest.raises(WireDown, match="did not answer"):
            trio.run(look, host)
    finally:
        twin.go_on()
    until(lambda: twin.log.host("safe", frozen_ns), "what was sent takes effect when it wakes up")
    assert all(report.safe for report in trio.run(stop, at(host)))


def test_a_clock_that_stands_still_confirms_nothing(twin: Twin, host: str) -> None:
    twin.fault("stuck")
    try:
        until(lambda: not any(report.safe for report in trio.run(stop, at(host))), "it stands still")
        with pytest.raises(WireDown, match="does not advance"):
            trio.run(look, host)
    finally:
        twin.fault("ok")


def test_saf_005_a_speed_that_is_no_number_confirms_nothing(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tell = plain.Samples.next

    async def tell_nan(samples: plain.Samples) -> dict[str, Any]:
        return {**await tell(samples), "actual_qd": (0.0, *(math.nan,) * 5)}

    monkeypatch.setattr(plain.Samples, "next", tell_nan)
    reports = trio.run(stop, at(host))
    assert [report.safe for report in reports] == [True, *(False,) * 5]
    assert reports[1].detail == "the joint moves"


@pytest.mark.parametrize("names", [("actual_q",), ("actual_q", "robot_status_bits")], ids=" and ".join)
def test_wrong_readings_are_the_same_for_every_client(twin: Twin, host: str, names: tuple[str, ...]) -> None:
    async def run() -> list[float]:
        async with (
            await trio.open_tcp_stream(host, p.RTDE_PORT) as one,
            await trio.open_tcp_stream(host, p.RTDE_PORT) as other,
        ):
            await other.send_all(p.outputs_request(500.0, ["actual_q"]) + p.frame(p.Kind.START))
            await one.send_all(p.outputs_request(500.0, names))
            decoder, recipe, pans = p.Decoder(), None, list[float]()
            with trio.fail_after(10):
                while len(pans) < 50:
                    for packet in decoder.feed(await one.receive_some(4096)):
                        if packet.kind == p.Kind.OUTPUTS:
                            recipe = p.outputs_answer(packet.payload, names)
                            await one.send_all(p.frame(p.Kind.START))
                        elif packet.kind == p.Kind.DATA:
                            assert recipe is not None
                            read = recipe.unpack(packet.payload)["actual_q"]
                            assert isinstance(read, tuple)
                            pans.append(read[0])
            return pans

    right = trio.run(run)
    twin.fault("wrong")
    try:
        wrong = trio.run(run)
    finally:
        twin.fault("ok")
    assert all(abs(pan - right[-1] - WRONG_BY_RAD) < 0.01 for pan in wrong)


def test_no_peer_is_found() -> None:
    with pytest.raises(WireDown, match=r"127.0.0.1:29999: cannot connect .* Check port="):
        trio.run(plain.handshake, "127.0.0.1")
    assert not any(report.written for report in trio.run(stop, at("127.0.0.1")))


def test_two_clients_cannot_write_the_same_input(host: str) -> None:
    async def ask(stream: trio.SocketStream) -> bytes:
        await stream.send_all(p.frame(p.Kind.INPUTS, b"input_int_register_30"))
        (packet,) = p.Decoder().feed(await stream.receive_some(4096))
        return packet.payload

    async def run() -> None:
        first = await trio.open_tcp_stream(host, p.RTDE_PORT)
        second = await trio.open_tcp_stream(host, p.RTDE_PORT)
        assert await ask(first) == b"\x01INT32"
        assert await ask(second) == b"\x00IN_USE"
        await first.aclose()
        with trio.fail_after(10):
            while await ask(second) != b"\x01INT32":  # noqa: ASYNC110  # there is no event for its own close
                await trio.sleep(0.01)
        await second.aclose()

    trio.run(run)


@pytest.mark.parametrize(
    "packet",
    [
        p.frame(p.Kind.OUTPUTS, b"\0\0"),
        p.frame(p.Kind.DATA, b"\x07\0\0\0\0"),
        p.frame(ord("x")),
        b"\0\x01V",
    ],
    ids=["outputs without a rate", "a recipe that was not agreed", "an unknown kind", "a size that cannot be"],
)
def test_a_malformed_request_is_logged_and_refused(host: str, twin: Twin, packet: bytes) -> None:
    async def run() -> bytes:
        async with await trio.open_tcp_stream(host, p.RTDE_PORT) as stream:
            await stream.send_all(packet)
            with trio.fail_after(10):
                return await stream.receive_some(4096)

    began_ns = time.monotonic_ns()
    (reported,) = p.Decoder().feed(trio.run(run))
    assert reported.kind == p.Kind.TEXT and b"RTDE" in reported.payload
    entries = list(twin.log.entries(began_ns))
    assert [entry.data for entry in entries if entry.kind == "malformed"] == [packet]
    assert [entry.kind for entry in entries if entry.kind == "error"]


def test_the_dashboard_hangs_up_on_request(host: str) -> None:
    async def run() -> bytes:
        said = b""
        async with await trio.open_tcp_stream(host, p.DASHBOARD_PORT) as stream:
            await stream.send_all(b"quit\n")
            with trio.fail_after(10):
                while chunk := await stream.receive_some(4096):
                    said += chunk
        return said

    assert trio.run(run).endswith(b"Disconnected\n")
