"""Test the half-duplex master in virtual time: how it matches answers to requests, and the effect of a late
reply."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.half_duplex import (
    BACKOFF_S,
    MARGIN_S,
    QUIET_S,
    HalfDuplexBus,
    Health,
    Quiet,
)
from strands_actors.drivers.feetech import protocol
from strands_actors.kernel.clock import NS, VirtualClock

from .memory_port import MemoryPort, Peer, virtual

Bus = HalfDuplexBus[protocol.Packet]


def status(motor: int, *params: int) -> bytes:
    return protocol.frame(motor, 0, bytes(params))


def bus_of(
    answer: Callable[[protocol.Packet], Iterable[tuple[float, bytes]]], quiet_s: float = QUIET_S
) -> tuple[Bus, MemoryPort]:
    decoder = protocol.Decoder()

    def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
        for packet in decoder.feed(data):
            yield from answer(packet)

    port = MemoryPort(peer)
    return Bus(port, protocol.Decoder(), VirtualClock(), 1_000_000, quiet_s=quiet_s), port


def test_replies_are_matched_by_id_and_length() -> None:
    async def main() -> None:
        bus, _ = bus_of(
            lambda _: [
                (0.001, status(9, 1, 2)),  # another id
                (0.001, status(1, 7)),  # another length
                (0.002, b"\x00\x17\xff"),  # noise
                (0.003, status(2, 3, 4)),
                (0.003, status(1, 5, 6)),
                (0.003, status(1, 8, 9)),  # a second answer with the same id has no effect
            ]
        )
        replies = await bus.transact(protocol.sync_read((1, 2), 56, 2), {1: 2, 2: 2})
        assert {motor: tuple(reply.params) for motor, reply in replies.items()} == {1: (5, 6), 2: (3, 4)}
        assert not bus.quiet
        assert bus.stray_bytes == len(status(9, 1, 2) + status(1, 7)) + 3

    virtual(main)


def test_a_reply_in_pieces_is_one_reply() -> None:
    async def main() -> None:
        frame = status(1, 5, 6)
        bus, _ = bus_of(lambda _: [(0.001 * at, frame[at : at + 1]) for at in range(len(frame))])
        replies = await bus.transact(protocol.read(1, 56, 2), {1: 2})
        assert replies[1].params == b"\x05\x06"

    virtual(main)


def test_the_timeout_is_the_time_of_the_bytes_and_a_margin() -> None:
    async def main() -> None:
        bus, _ = bus_of(lambda _: [])
        request = protocol.sync_read(range(1, 7), 56, 11)
        began = trio.current_time()
        assert await bus.transact(request, dict.fromkeys(range(1, 7), 11)) == {}
        wire_s = (len(request) + 6 * 17) * 10e-6
        assert trio.current_time() - began == pytest.approx(wire_s + MARGIN_S)
        with pytest.raises(Quiet):
            await bus.transact(protocol.ping(1), {1: 0})

    virtual(main)


class StarvedPort(MemoryPort):
    """A port on a host that does not run for ``starved_s`` during each of its first ``times`` waits for an
    answer."""

    def __init__(self, peer: Peer, starved_s: float, times: int = 1) -> None:
        super().__init__(peer)
        self._starved_s = starved_s
        self._times = times

    async def read(self) -> bytes:
        if self._times:
            self._times -= 1
            clock = trio.lowlevel.current_clock()
            assert isinstance(clock, MockClock)
            clock.jump(self._starved_s)
            await trio.lowlevel.checkpoint()
        return await super().read()


def test_an_answer_that_came_in_time_is_taken_however_late_this_host_looks() -> None:
    async def main() -> None:
        decoder = protocol.Decoder()
        port = StarvedPort(lambda data: [(0.001, status(1, 5, 6)) for _ in decoder.feed(data)], 0.3)
        bus = Bus(port, protocol.Decoder(), VirtualClock(), 1_000_000)
        replies = await bus.transact(protocol.read(1, 56, 2), {1: 2})
        assert replies[1].params == b"\x05\x06"
        assert not bus.quiet
        assert bus.starved and bus.late_s > 0.2
        await bus.transact(protocol.read(1, 56, 2), {1: 2})
        assert not bus.starved, "the property belongs to the last request only"

    virtual(main)


def test_a_motor_that_is_silent_is_not_a_host_that_is_late() -> None:
    async def main() -> None:
        bus, _ = bus_of(lambda _: [])
        assert await bus.transact(protocol.ping(1), {1: 0}) == {}
        assert not bus.starved

    virtual(main)


def test_the_quiet_time_delays_requests_but_no_setpoints() -> None:
    async def main() -> None:
        bus, port = bus_of(lambda _: [])
        await bus.transact(protocol.ping(1), {1: 0})
        silent_from = trio.current_time()
        with pytest.raises(Quiet):
            await bus.transact(protocol.ping(1), {1: 0})
        assert trio.current_time() == silent_from, "the setpoint did not wait for the quiet time"
        assert len(port.written) == 1

        bus.send(protocol.LIMP)
        assert port.written[-1] == (silent_from, protocol.LIMP)

        await bus.transact(protocol.ping(2), {2: 0}, wait=True)
        at, frame = port.written[-1]
        assert frame == protocol.ping(2)
        assert at == pytest.approx(silent_from + QUIET_S)

    virtual(main)


def test_a_torn_reply_starts_the_quiet_time() -> None:
    async def main() -> None:
        bus, _ = bus_of(lambda _: [(0.001, status(1, 5, 6)[:-1])])
        assert await bus.transact(protocol.read(1, 56, 2), {1: 2}) == {}
        assert bus.quiet
        assert bus.stray_bytes == 7

    virtual(main)


def test_the_next_request_waits_for_the_answer_to_a_cancelled_one() -> None:
    """A stop gives up a reading. Its own request waits no longer than that reading would have."""

    async def main() -> None:
        bus, port = bus_of(lambda packet: [(0.010, status(1, packet.params[0]))])
        for given_up_s in (0.0, 0.005, 0.003):
            with trio.move_on_after(0.005):
                await bus.transact(protocol.read(1, 40, 1), {1: 1})
            began_s = trio.current_time()
            with trio.move_on_after(given_up_s):
                await bus.transact(protocol.read(1, 41, 1), {1: 1}, wait=True)
            replies = await bus.transact(protocol.read(1, 42, 1), {1: 1}, wait=True)
            assert replies[1].params == b"\x2a", "the reply does not answer another request"
            assert trio.current_time() - began_s < 0.04
            bus.send(protocol.LIMP)
            assert port.written[-1][1] == protocol.LIMP

    virtual(main)


def test_a_question_that_was_given_up_and_is_not_answered_starts_the_quiet_time() -> None:
    async def main() -> None:
        bus, _ = bus_of(lambda packet: [] if packet.params[0] == 40 else [(0.001, status(1, 7))])
        with trio.move_on_after(0.005):
            await bus.transact(protocol.read(1, 40, 1), {1: 1})
        began_s = trio.current_time()
        with pytest.raises(Quiet):
            await bus.transact(protocol.read(1, 41, 1), {1: 1})
        await bus.transact(protocol.read(1, 41, 1), {1: 1}, wait=True)
        assert trio.current_time() - began_s > QUIET_S

    virtual(main)


async def _late_replies(quiet_s: float) -> tuple[int, int]:
    """Send sixty requests, alternately for two registers of one size. Every tenth answer is 60 ms late.

    Returns:
        The number of answers, and how many of them have the value of the other register.
    """
    values = {62: 74, 63: 30}
    asked = 0

    def answer(packet: protocol.Packet) -> Iterable[tuple[float, bytes]]:
        nonlocal asked
        asked += 1
        return [(0.060 if asked % 10 == 0 else 0.001, status(1, values[packet.params[0]]))]

    bus, _ = bus_of(answer, quiet_s)
    answered = wrong = 0
    for number in range(60):
        register = 62 + number % 2
        replies = await bus.transact(protocol.read(1, register, 1), {1: 1}, 0.0125, wait=True)
        if 1 in replies:
            answered += 1
            wrong += replies[1].params[0] != values[register]
            await trio.sleep(0.01075)  # so that the fifth request after a late one is sent 59.5 ms after it
    return answered, wrong


def test_a_late_reply_is_never_the_next_answer() -> None:
    async def main() -> None:
        assert await _late_replies(QUIET_S) == (54, 0)

    virtual(main)


def test_without_the_quiet_time_late_replies_are_taken_for_answers() -> None:
    """The reason for the quiet time: without it, the same bus takes late replies for answers to other requests."""

    async def main() -> None:
        answered, wrong = await _late_replies(0.0)
        assert answered and wrong

    virtual(main)


def test_a_dead_port_is_reported() -> None:
    async def main() -> None:
        bus, port = bus_of(lambda _: [])
        port.unplugged = True
        with pytest.raises(WireDown):
            await bus.transact(protocol.ping(1), {1: 0})
        with pytest.raises(WireDown):
            bus.send(protocol.LIMP)

    virtual(main)


def test_listening_receives_all_peers_and_ends_on_a_noisy_line() -> None:
    async def main() -> None:
        bus, _ = bus_of(lambda _: [(0.001 * motor, status(motor)) for motor in (1, 2, 2, 7)])
        received = await bus.listen(protocol.ping(protocol.BROADCAST), 0.05, 0.01)
        assert [packet.id for packet in received] == [1, 2, 2, 7]
        assert bus.stray_bytes == 0

        babbling, _ = bus_of(lambda _: [(0.001 * at, b"\x55") for at in range(5000)])
        began = trio.current_time()
        assert await babbling.listen(protocol.ping(1), 0.05, 0.01) == []
        assert trio.current_time() - began < 2

    virtual(main)


# -- health


def test_a_motor_is_left_out_after_two_misses_and_asked_again_with_backoff() -> None:
    health = Health((1, 2, 3))
    now = 0
    health.update((1, 2, 3), (1, 3), now)
    assert health.to_ask(now) == (1, 2, 3), "a motor is not left out after one miss"
    assert health.silent() == (2,)
    health.update((1, 2, 3), (1, 3), now)
    waits = []
    for _ in range(6):
        assert health.to_ask(now) == (1, 3)
        began = now
        while health.to_ask(now) == (1, 3):
            now += NS // 100
        waits.append((now - began) / NS)
        assert health.to_ask(now) == (1, 3, 2), "a suspected motor is read last"
        health.update((1, 3, 2), (1, 3), now)
    assert waits == pytest.approx([*BACKOFF_S, BACKOFF_S[-1], BACKOFF_S[-1]])

    while 2 not in health.to_ask(now):
        now += NS // 100
    health.update((1, 3, 2), (1, 2, 3), now)
    assert health.to_ask(now) == (1, 2, 3), "a motor that answered is read in its usual place"
    assert health.silent() == ()


def test_a_miss_is_forgiven_by_an_answer() -> None:
    health = Health((1, 2))
    for _ in range(10):
        health.update((1, 2), (1,), 0)
        health.update((1, 2), (1, 2), 0)
        assert health.to_ask(0) == (1, 2)


def test_only_one_suspect_is_asked_at_a_time_unless_all_are() -> None:
    health = Health((1, 2, 3))
    for _ in range(2):
        health.update((1, 2, 3), (1,), 0)
    assert health.to_ask(NS) == (1, 2)
    for _ in range(2):
        health.update((1,), (), 0)
    assert health.to_ask(0) == (1, 2, 3), "if all motors are suspected, all are read"
    health.update((1, 2, 3), (1,), 0)
    assert health.to_ask(0) == (1,)


def test_one_dead_servo_leaves_the_others_half_their_rate() -> None:
    async def rate(dead: frozenset[int], seconds: float) -> float:
        """Return the readings of working servos per second at 100 Hz."""

        def answer(packet: protocol.Packet) -> Iterable[tuple[float, bytes]]:
            motors = [motor for motor in packet.params[2:] if motor not in dead]
            return [(0.0002 * place, status(motor, *bytes(11))) for place, motor in enumerate(motors, 1)]

        bus, _ = bus_of(answer)
        clock = VirtualClock()
        health = Health(range(1, 7))
        fresh = 0
        began = trio.current_time()
        while trio.current_time() - began < seconds:
            await trio.sleep(0.01)
            asked = health.to_ask(clock.now_ns())
            if bus.quiet or not asked:
                continue
            replies = await bus.transact(protocol.sync_read(asked, 56, 11), dict.fromkeys(asked, 11))
            health.update(asked, replies, clock.now_ns())
            fresh += len(replies) >= 5
        return fresh / seconds

    async def main() -> None:
        for seconds in (2.0, 5.0, 20.0):
            whole = await rate(frozenset(), seconds)
            assert await rate(frozenset({3}), seconds) > whole / 2

    virtual(main)
