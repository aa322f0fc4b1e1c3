"""Test participants over real sockets on the loopback."""

from __future__ import annotations

import os
import time
from types import SimpleNamespace

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.rtps import Participant, open_participant, sockets, wire_types
from strands_actors.drivers.common.rtps.participant import FRESH_NS

from .pair import Log

PATIENCE_S = 20.0
DOMAIN = 50 + os.getpid() % 50  # two runs of these tests on one machine use different domains
LOW_CMD = ("rt/lowcmd", "unitree_hg::msg::dds_::LowCmd_")
LOW_STATE = ("rt/lowstate", "unitree_hg::msg::dds_::LowState_")
COMMAND = b"\x00\x01\x00\x00" + bytes(range(250)) * 4
STATE = b"\x00\x01\x00\x00" + bytes(range(232)) * 9


def run(main):  # type: ignore[no-untyped-def]
    async def bounded() -> None:
        with trio.fail_after(PATIENCE_S):
            await main()

    trio.run(bounded)


@pytest.mark.parametrize("multicast", [True, False])
@pytest.mark.parametrize("reliable", [True, False])
def test_command_and_state_go_both_ways(multicast: bool, reliable: bool) -> None:
    async def main() -> None:
        commands, states = Log(), Log()
        peers = () if multicast else ("127.0.0.21",)
        async with (
            open_participant(DOMAIN, "127.0.0.20", peers, multicast) as driver,
            open_participant(DOMAIN, "127.0.0.21", (), multicast) as robot,
        ):
            command = driver.writer(*LOW_CMD, reliable=reliable)
            state_reader = driver.reader(*LOW_STATE, states, reliable=reliable)
            command_reader = robot.reader(*LOW_CMD, commands, reliable=reliable)
            state = robot.writer(*LOW_STATE, reliable=reliable)
            await driver.wait_matched(command, state_reader)
            await robot.wait_matched(state, command_reader)
            while not commands.payloads or not states.payloads:
                assert command.write(COMMAND) == 1
                assert state.write(memoryview(bytearray(STATE))) == 1
                await trio.sleep(0.002)
            assert set(commands.payloads) == {COMMAND}
            assert set(states.payloads) == {STATE}
            assert commands.writers[0] == command.data.guid
            assert driver.counters.malformed == robot.counters.malformed == driver.counters.unsent == 0

    run(main)


def test_without_multicast_and_peers_no_participant_is_found() -> None:
    async def main() -> None:
        async with (
            open_participant(DOMAIN, "127.0.0.22", (), False) as one,
            open_participant(DOMAIN, "127.0.0.23", (), False) as other,
        ):
            await trio.sleep(0.3)
            assert one.peers == other.peers == 0

    run(main)


def test_several_participants_share_an_address() -> None:
    async def main() -> None:
        log = Log()
        async with (
            open_participant(DOMAIN, "127.0.0.24", (), False) as one,
            open_participant(DOMAIN, "127.0.0.24", ("127.0.0.24",), False) as other,
        ):
            assert one.address == f"127.0.0.24:{wire_types.discovery_port(DOMAIN, 0)}"
            assert other.address == f"127.0.0.24:{wire_types.discovery_port(DOMAIN, 1)}"
            writer, reader = one.writer(*LOW_CMD), other.reader(*LOW_CMD, log)
            await one.wait_matched(writer)
            await other.wait_matched(reader)

    run(main)


def test_it_is_served_by_polling_too_and_a_sample_has_its_true_age() -> None:
    """SAF-012: a sample keeps its true age when it has waited in the socket."""
    robot = Participant(DOMAIN, "127.0.0.25", (), False)
    driver = Participant(DOMAIN, "127.0.0.26", (robot.address,), False)
    seen: list[tuple[bytes, int]] = []
    writer = robot.writer(*LOW_STATE)
    reader = driver.reader(*LOW_STATE, lambda payload, _, t_ns: seen.append((bytes(payload), t_ns)))
    deadline = time.monotonic() + PATIENCE_S
    while not (writer.matched and reader.matched):
        assert time.monotonic() < deadline
        driver.poll()
        robot.poll()
    before = time.monotonic_ns()
    assert writer.write(STATE) == 1
    time.sleep(0.2)
    driver.poll()
    ((payload, t_ns),) = seen
    assert payload == STATE
    assert before - 5_000_000 <= t_ns < before + 100_000_000
    robot.close()
    deadline = time.monotonic() + PATIENCE_S
    while (reader.matched, driver.peers) != (0, 0):
        assert time.monotonic() < deadline
        driver.poll()
    driver.close()
    driver.close()
    driver.poll()


def test_waiting_datagrams_are_read_at_once_and_fresh_ones_one_by_one() -> None:
    """After a robot's one message per period, the socket is not read a second time. No datagram remains behind."""
    robot = Participant(DOMAIN, "127.0.0.32", (), False)
    driver = Participant(DOMAIN, "127.0.0.33", (robot.address,), False)
    states = Log()
    writer, reader = robot.writer(*LOW_STATE), driver.reader(*LOW_STATE, states)
    deadline = time.monotonic() + PATIENCE_S
    while not (writer.matched and reader.matched):
        assert time.monotonic() < deadline
        driver.poll()
        robot.poll()
    one_by_one = 0
    while not one_by_one:  # a pause of this machine makes fresh datagrams old
        assert time.monotonic() < deadline
        driver.poll()
        states.payloads.clear()
        for _ in range(3):
            writer.write(STATE)
        seen = []
        while len(states.payloads) < 3:
            driver.poll()
            seen.append(len(states.payloads))
            assert len(seen) <= 3
        one_by_one = seen == [1, 2, 3]
    states.payloads.clear()
    for _ in range(3):
        writer.write(STATE)
    time.sleep(2 * FRESH_NS / 1e9)
    driver.poll()
    assert states.payloads == [STATE] * 3
    robot.close()
    driver.close()


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_a_wall_clock_that_is_set_ages_a_sample_by_no_more_than_the_time_it_can_have_waited(
    step_s: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SAF-012: the kernel stamps arrivals with the wall clock. When that clock is set forward, a sample must
    not become an hour old, which would stop the robot. When it is set back, a sample that has waited must not
    become new."""
    robot = Participant(DOMAIN, "127.0.0.27", (), False)
    driver = Participant(DOMAIN, "127.0.0.28", (robot.address,), False)
    seen: list[int] = []
    writer = robot.writer(*LOW_STATE)
    reader = driver.reader(*LOW_STATE, lambda payload, writer, t_ns: seen.append(t_ns))
    deadline = time.monotonic() + PATIENCE_S
    while not (writer.matched and reader.matched):
        assert time.monotonic() < deadline
        driver.poll()
        robot.poll()
    driver.poll()
    empty_ns = time.monotonic_ns()
    time.sleep(0.1)
    assert writer.write(STATE) == 1
    now_ns = time.time_ns
    stepped = SimpleNamespace(time_ns=lambda: now_ns() + step_s * 1_000_000_000)
    monkeypatch.setattr(sockets, "time", stepped)
    driver.poll()
    (t_ns,) = seen
    assert empty_ns - 50_000_000 <= t_ns <= empty_ns
    robot.close()
    driver.close()


@pytest.mark.parametrize("only_host", [True, False])
def test_a_driver_has_no_other_peer_than_its_robot(only_host: bool) -> None:
    """SAF-009: another robot that knows the driver's address receives no command of it.

    Once, the wire of a restarted robot had the address of another wire that was killed before. The other robot
    still sent to that address.
    """
    others_host = "127.0.0.30" if only_host else "127.0.0.29"
    robot = Participant(DOMAIN, "127.0.0.29", (), False)
    only = "127.0.0.29" if only_host else robot.address
    driver = Participant(DOMAIN, "127.0.0.31", (robot.address,), False, only=only)
    other = Participant(DOMAIN, others_host, (driver.address,), False)
    commands, stolen, states = Log(), Log(), Log()
    writer, reader = driver.writer(*LOW_CMD), driver.reader(*LOW_STATE, states)
    received, overheard = robot.reader(*LOW_CMD, commands), other.reader(*LOW_CMD, stolen)
    own_state, others_state = robot.writer(*LOW_STATE), other.writer(*LOW_STATE)
    deadline = time.monotonic() + PATIENCE_S
    while not (writer.matched and reader.matched and received.matched and driver.counters.strangers > 2):
        assert time.monotonic() < deadline
        for each in (driver, robot, other):
            each.poll()
    for _ in range(20):
        writer.write(COMMAND)
        own_state.write(STATE)
        others_state.write(COMMAND)
        for each in (driver, robot, other):
            each.poll()
    assert commands.payloads == [COMMAND] * 20
    assert states.payloads == [STATE] * 20
    assert not stolen.payloads and not overheard.matched
    assert driver.peers == writer.matched == reader.matched == 1
    for each in (driver, robot, other):
        each.close()


def test_closing_ends_its_service_and_its_writers_take_nothing() -> None:
    async def main() -> None:
        participant = Participant(DOMAIN, "127.0.0.27", (), False)
        writer = participant.writer(*LOW_CMD)
        async with trio.open_nursery() as nursery:
            await nursery.start(participant.run)
            participant.close()
        assert writer.write(COMMAND) == 0

    run(main)


def test_noise_on_the_sockets_is_counted() -> None:
    async def main() -> None:
        async with open_participant(DOMAIN, "127.0.0.28", (), False) as participant:
            with trio.socket.socket(trio.socket.AF_INET, trio.socket.SOCK_DGRAM) as noise:
                for datagram in (b"", b"RTPS", b"RTPS\x02\x02" + bytes(14) + b"\x15\x05\xff\xff", bytes(65507)):
                    await noise.sendto(datagram, ("127.0.0.28", wire_types.user_port(DOMAIN, 0)))
                while participant.counters.datagrams < 4:  # noqa: ASYNC110
                    await trio.sleep(0.005)
            assert participant.counters.malformed == 4

    run(main)


def test_a_write_to_an_address_that_cannot_be_reached_is_reported() -> None:
    robot = Participant(DOMAIN, "127.0.0.29", (), False)
    driver = Participant(DOMAIN, "127.0.0.30", (robot.address,), False)
    writer, _ = driver.writer(*LOW_CMD), robot.reader(*LOW_CMD, Log())
    deadline = time.monotonic() + PATIENCE_S
    while not writer.matched:
        assert time.monotonic() < deadline
        driver.poll()
        robot.poll()
    driver._out.close()
    assert writer.write(COMMAND) == 0
    assert driver.counters.unsent > 0
    assert "127.0.0.29" in driver.trouble
    robot.close()
    driver.close()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"domain": 233}, "0..232"),
        ({"peers": ("robot",)}, "IPv4"),
        ({"address": "0.0.0.0"}, "IPv4"),
        ({"address": "127.1"}, "IPv4"),
        ({"peers": ("127.0.0.1:0",)}, "port"),
        ({"peers": ("127.0.0.1:x",)}, "port"),
    ],
)
def test_senseless_arguments_are_refused(arguments: dict, word: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(ValueError, match=word):
        Participant(**arguments)


def test_the_address_of_another_host_is_refused() -> None:
    with pytest.raises(WireDown, match=r"192\.0\.2\.77"):
        Participant(DOMAIN, "192.0.2.77", (), False)


def test_an_address_without_free_ports_is_refused() -> None:
    last = wire_types.MAX_DOMAIN
    taken = []
    with pytest.raises(WireDown, match="all ports are in use"):
        while True:
            taken.append(Participant(last, "127.0.0.31", (), False))
    assert len(taken) == wire_types.indices(last) == 63
    for participant in taken:
        participant.close()
