"""SAF-025 on DDS: test that a peer's datagrams take bounded time, and that nothing grows. Only counts are
asserted, not times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import discovery, messages, parameters, participant, wire_types
from strands_actors.drivers.common.rtps.discovery import EndpointData
from strands_actors.drivers.common.rtps.engine import MOST_CHANGES, MOST_PROCESSED
from strands_actors.drivers.common.rtps.matching import MAX_MATCHED
from strands_actors.drivers.common.rtps.participant import Participant
from strands_actors.drivers.common.rtps.wire_types import PUBLICATIONS_WRITER, SUBSCRIPTIONS_WRITER, Address
from strands_actors.kernel.clock import MonotonicClock

from .pair import A, B, Log, Pair, payloads

PARTS = 200
"""Submessages of one datagram."""


def settled(reliable: bool = True) -> Pair:
    """Return two participants that know each other and have nothing to send."""
    pair = Pair(reliable)
    pair.read()
    pair.network.run(0.5)
    pair.network.keep_sent = True
    return pair


def told(pair: Pair, *parts: bytes) -> int:
    """Deliver a datagram in the name of A to B. Return its cost."""
    datagram = memoryview(messages.header(pair.a.data.prefix) + b"".join(parts))
    return pair.b.receive(datagram, (A, 7410), pair.network.now_ns)


def endpoint(pair: Pair, number: int, kind: int, topic: str, port: int = 7411) -> bytes:
    """Return A's announcement of one more reader or writer."""
    guid = pair.a.data.prefix + number.to_bytes(3, "big") + bytes((kind,))
    return discovery.encode_endpoint(EndpointData(guid, topic, "T_", False, 0, ((A, port),)))


def test_saf_025_a_datagram_full_of_questions_is_answered_once() -> None:
    """Otherwise each would be answered by a datagram, or by every sample that is kept."""
    pair = Pair()
    pair.read()
    pair.network.run(0.3)
    writer, reader = pair.writer.data.guid, pair.reader.data.guid
    beats = b"".join(
        messages.heartbeat(reader[12:], writer[12:], 1, 9, 1000 + at, final=False)
        for at in range(messages.MOST_SUBMESSAGES)
    )
    pair.network.keep_sent = True
    pair.b.receive(memoryview(messages.header(writer[:12]) + beats), (A, 7410), pair.network.now_ns)
    assert len(pair.network.sent) == 1


def test_saf_025_a_datagram_of_more_parts_than_any_has_is_refused_at_once() -> None:
    pair = Pair()
    writer = pair.writer.data.guid
    beat = messages.heartbeat(wire_types.UNKNOWN, writer[12:], 1, 1, 1, final=True)
    datagram = messages.header(writer[:12]) + beat * (messages.MOST_SUBMESSAGES + 1)
    with pytest.raises(MalformedFrame, match="submessages"):
        messages.decode(memoryview(datagram), pair.b.data.prefix)


def test_saf_025_ignored_parts_of_a_datagram_count_as_cost() -> None:
    """A turn that counted only answers would process a hundred such datagrams."""
    pair = settled()
    writer = pair.writer.data.guid
    beat = messages.heartbeat(wire_types.UNKNOWN, writer[12:], 1, 9, 1000, final=True)
    assert told(pair, beat * PARTS) == PARTS


@pytest.mark.parametrize("says", ["it is another one", "it goes, and is back"])
def test_saf_025_a_peer_is_rediscovered_only_a_few_times_between_two_ticks(says: str) -> None:
    pair = settled()
    data = pair.a.data
    here = [
        messages.data(
            wire_types.SPDP_READER,
            wire_types.SPDP_WRITER,
            1,
            discovery.encode_participant(data._replace(lease_s=10.0 + at)),
        )
        for at in range(2)
    ]
    parts = here if says == "it is another one" else [goodbye(pair), here[0]]
    for _ in range(10):
        told(pair, *parts[::-1], *parts[::-1])
    handshakes = sum(b"\x01\x00\xc2" in datagram for datagram, _ in pair.network.sent)
    assert 0 < handshakes <= MOST_CHANGES
    assert pair.b.counters.refused
    pair.network.run(3.0)
    assert pair.writer.matched == pair.reader.matched == 1, "the peer is matched again"


def test_saf_025_only_a_limited_number_of_parts_of_a_datagram_is_read() -> None:
    pair = settled()
    for at in range(PARTS):
        pair.a._publications.write(endpoint(pair, at, 0x03, "rt/else"))
    kept = list(pair.a._publications._kept or ())
    first = pair.a._publications.sequence - PARTS + 1
    pair.network.drop_all()
    entity = wire_types.PUBLICATIONS_READER
    told(
        pair,
        *(
            messages.data(entity, PUBLICATIONS_WRITER, first + at, payload)
            for at, payload in enumerate(kept[-PARTS:])
        ),
    )
    known = pair.b._matching._remote_writers
    assert len(known) == 1 + MOST_PROCESSED
    pair.network.run(2.0)
    assert len(known) == 1 + PARTS


@pytest.mark.parametrize("reads", [True, False])
def test_saf_025_an_endpoint_is_matched_with_so_many_of_a_peer_and_no_more(reads: bool) -> None:
    """Otherwise each sample would be sent a thousand times, to any address that the peer names."""
    pair = settled(reliable=False)
    ours = pair.b.writer("rt/back", "T_", False, False, 1)
    reader = pair.b.reader("rt/forth", "T_", False, False, lambda *_: None)
    builtin = SUBSCRIPTIONS_WRITER if reads else PUBLICATIONS_WRITER
    announced = (pair.a._subscriptions if reads else pair.a._publications).sequence
    for at in range(PARTS):
        said = endpoint(pair, at, 0x04 if reads else 0x03, "rt/back" if reads else "rt/forth", 1000 + at)
        told(pair, messages.data(wire_types.UNKNOWN, builtin, announced + 1 + at, said))
    pair.network.run(0.1)
    pair.network.sent.clear()
    ours.write(b"\0\1\0\0")
    if reads:
        assert ours.matched == len(pair.network.sent) == MAX_MATCHED
    else:
        assert reader.matched == MAX_MATCHED


def goodbye(pair: Pair) -> bytes:
    guid = pair.a.data.prefix + wire_types.PARTICIPANT
    key = discovery.encode_ended(guid, parameters.PARTICIPANT_GUID)
    return messages.disposal(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 2, guid, key)


def test_saf_022_a_stop_is_sent_to_where_the_last_reader_was() -> None:
    """A reader that has announced its end may still exist. Only a stop is sent there."""
    pair = settled(reliable=False)
    log = Log()
    ours = pair.b.writer("rt/back", "T_", False, False, 1)
    assert not ours.has_parted and ours.write_stop(b"\0\1\0\0") == 0, "no reader ever existed"
    pair.a.reader("rt/back", "T_", False, False, log)
    pair.network.run(0.5)
    assert ours.matched == 1 and ours.write(payloads(1)[0]) == 1
    pair.network.run(0.01)
    told(pair, goodbye(pair))
    assert ours.matched == 0 and ours.has_parted
    assert ours.write(payloads(2)[0]) == 0
    assert ours.write_stop(payloads(3)[0]) == 1
    pair.network.run(0.01)
    assert log.payloads == payloads(1, 3)
    pair.network.run(2.0)
    assert ours.matched == 1 and not ours.has_parted


def test_saf_022_a_stop_is_also_sent_to_a_restarted_peer() -> None:
    """The stop goes to the peer's present address, although it has not announced its readers again."""
    pair = settled(reliable=False)
    log = Log()
    ours = pair.b.writer("rt/back", "T_", False, False, 1)
    pair.a.reader("rt/back", "T_", False, False, log)
    pair.network.run(0.5)
    moved = pair.a.data._replace(lease_s=20.0, discovery=((A, 7420),), user=((A, 7421),))
    told(
        pair,
        messages.data(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 1, discovery.encode_participant(moved)),
    )
    assert ours.matched == 1 and ours.write(payloads(1)[0]) == 1
    assert pair.b.address_of(pair.a.data.prefix) == (A, 7421)


class _Socket:
    """A socket that always has another datagram. Each takes ``cost_ns``."""

    def __init__(self, clock: _Clock, cost_ns: int) -> None:
        self.clock, self.cost_ns, self.reads = clock, cost_ns, 0

    def recvmsg_into(self, buffers: Sequence[bytearray], room: int) -> tuple[int, list[Any], int, Address]:
        self.reads += 1
        self.clock.t_ns += self.cost_ns
        return 20, [], 0, (A, 7410)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *_: (B, 7410)


class _Clock(MonotonicClock):
    t_ns = 10**9

    def now_ns(self) -> int:
        return self.t_ns


@pytest.mark.parametrize("cost_ns", [0, 10_000, 300_000])
def test_saf_025_a_turn_ends_after_a_number_of_datagrams_and_after_a_time(
    cost_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = _Clock()
    sockets = [_Socket(clock, cost_ns) for _ in range(2)]
    monkeypatch.setattr(participant, "open_sockets", lambda *_: tuple(sockets))
    one = Participant(address=B, multicast=False, clock=clock)
    one.poll()
    for sock in sockets:
        took_ns = sock.reads * cost_ns
        assert 1 < sock.reads <= participant._ROUND
        assert took_ns <= participant._ROUND_NS + 2 * cost_ns
