"""Test two participants on a network that loses, repeats, reorders, truncates, damages and invents datagrams.

``STRANDS_ACTORS_FUZZ`` is the number of disturbed datagrams in each test, ``STRANDS_ACTORS_RTPS_SEED`` the
first seed.
"""

from __future__ import annotations

import os
import random
import struct
import zlib
from collections.abc import Iterable
from itertools import pairwise

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import messages, wire_types
from strands_actors.drivers.common.rtps.engine import MAX_PEERS, Engine
from strands_actors.drivers.common.rtps.matching import MAX_ENDPOINTS
from strands_actors.drivers.common.rtps.reassembly import MAX_BYTES, MAX_SAMPLES
from strands_actors.drivers.common.rtps.writer import Writer
from tests.drivers.disturbed import DISTURBED

from .pair import MS, TRAVEL_NS, Log, Network, number_of, sample, undisturbed

SEED = int(os.environ.get("STRANDS_ACTORS_RTPS_SEED", "1"))

A, B = "10.0.0.1", "10.0.0.2"
FAST, SURE, LARGE = "rt/fast", "rt/sure", "rt/large"
TYPES = {FAST: "t::Fast_", SURE: "t::Sure_", LARGE: "t::Large_"}
LARGE_BYTES = 40_000


class Talk:
    """A writes three topics and B reads them: best effort, reliable, and reliable in fragments. They start as
    strangers."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.network = Network()
        self.a = self.network.participant(A, [B])
        self.b = self.network.participant(B, [A])
        self.logs = {topic: Log() for topic in TYPES}
        self.written = dict.fromkeys(TYPES, 0)
        self.disturbed = 0
        self.writers: dict[str, Writer] = {}
        for topic, type_name in TYPES.items():
            reliable = topic != FAST
            self.writers[topic] = self.a.writer(topic, type_name, reliable, False, 400)
            self.b.reader(topic, type_name, reliable, False, self.logs[topic])
        # There is traffic in the other direction, too: B's own writer must survive the datagrams for A.
        self.back = self.b.writer("rt/back", "t::Back_", True, False, 8)
        self.a.reader("rt/back", "t::Back_", True, False, Log())

    def until_matched(self) -> None:
        for _ in range(400):
            if all(writer.matched == 1 for writer in self.writers.values()) and self.back.matched == 1:
                return
            self.network.run(0.1)
        raise AssertionError("never matched")

    def write(self, topic: str) -> None:
        self.written[topic] += 1
        size = LARGE_BYTES if topic == LARGE else self.random.choice((1, 63, 400))
        self.writers[topic].write(sample(topic, self.written[topic], size))

    def step(self) -> None:
        self.write(FAST)
        if self.random.random() < 0.5:
            self.write(SURE)
            self.back.write(sample("rt/back", 1))
        if self.random.random() < 0.02:
            self.write(LARGE)
        self.network.run(0.002)

    def numbers(self, topic: str) -> list[int | None]:
        return [number_of(payload, topic) for payload in self.logs[topic].payloads]

    def is_bounded(self) -> bool:
        return all(_is_bounded(engine) for engine in (self.a, self.b))


def _is_bounded(engine: Engine) -> bool:
    matching, reassembly = engine._matching, engine._reassembly
    waiting = [
        (len(writer.early), writer.waiting)
        for reader in matching.readers.values()
        for writer in reader._writers.values()
    ]
    return (
        engine.peers <= MAX_PEERS
        and len(matching._remote_writers) <= MAX_ENDPOINTS
        and len(matching._remote_readers) <= MAX_ENDPOINTS
        and len(reassembly) <= MAX_SAMPLES
        and reassembly._bytes <= MAX_BYTES
        and all(count <= 256 and size <= 1 << 20 for count, size in waiting)
    )


def test_a_bad_network_costs_time_but_no_sample_and_no_order() -> None:
    """The network loses, repeats, reorders and truncates datagrams and adds noise. This may happen to datagrams
    with a valid checksum."""
    talk = Talk(SEED)

    def fate(datagram: bytes) -> Iterable[tuple[int, bytes]]:
        dice = talk.random.random()
        if dice < 0.7:
            return ((TRAVEL_NS, datagram),)
        talk.disturbed += 1
        if dice < 0.8:
            return ()
        if dice < 0.86:
            return ((TRAVEL_NS, datagram), (talk.random.randrange(50 * MS), datagram))
        if dice < 0.93:
            return ((talk.random.randrange(20 * MS), datagram),)
        if dice < 0.97:
            return ((TRAVEL_NS, datagram[: talk.random.randrange(len(datagram))]),)
        noise = talk.random.randbytes(talk.random.randrange(200))
        return ((TRAVEL_NS, noise), (TRAVEL_NS, b"RTPS\x02\x02" + noise), (TRAVEL_NS, datagram))

    talk.network.fate = fate
    talk.until_matched()
    while talk.disturbed < DISTURBED:
        talk.step()
        if talk.writers[SURE].unacknowledged > 300 or talk.writers[LARGE].unacknowledged > 20:
            talk.network.run(0.2)  # a writer that outruns its own history may lose samples
        assert talk.is_bounded()
    talk.network.fate = undisturbed
    talk.network.run(2.0)
    for topic in (SURE, LARGE):
        assert talk.numbers(topic) == list(range(1, talk.written[topic] + 1))
        assert talk.writers[topic].unacknowledged == 0
    fast = talk.numbers(FAST)
    assert all(one is not None and other is not None and one < other for one, other in pairwise(fast))
    assert len(fast) > talk.written[FAST] / 2
    assert talk.b.counters.malformed > 0


EPISODE = 500
"""Disturbed datagrams before both start again. One with a senseless number may deafen a reader until then."""


def test_damaged_and_forged_datagrams_never_raise_and_never_make_a_sample() -> None:
    """Bytes are changed, datagrams spliced, and valid submessages sent with senseless numbers in a peer's name.
    A damaged payload in an intact frame is left to the robot's own checksum. Nothing else may result."""
    disturbed = damaged = delivered = malformed = 0
    while disturbed < DISTURBED:
        talk = Talk(SEED + disturbed)
        talk.until_matched()
        damaged += disturb(talk, min(EPISODE, DISTURBED - disturbed))
        disturbed += talk.disturbed
        delivered += sum(len(log.payloads) for log in talk.logs.values())
        malformed += talk.b.counters.malformed
        recover(talk)
    assert damaged < delivered / 10
    assert delivered > disturbed / 10
    assert malformed > disturbed / 10


def disturb(talk: Talk, count: int) -> int:
    """Follow every other datagram by a hostile one. Return how many damaged payloads were delivered."""

    def fate(datagram: bytes) -> Iterable[tuple[int, bytes]]:
        if talk.random.random() < 0.5:
            return ((TRAVEL_NS, datagram),)
        talk.disturbed += 1
        return ((TRAVEL_NS, datagram), (TRAVEL_NS, hostile(talk, datagram)))

    talk.network.fate = fate
    while talk.disturbed < count:
        talk.step()
        assert talk.is_bounded()
    damaged = 0
    for topic in TYPES:
        numbers = talk.numbers(topic)
        damaged += numbers.count(None)
        assert all(number is None or 1 <= number <= talk.written[topic] for number in numbers)
    return damaged


def recover(talk: Talk) -> None:
    """Assert that the harm does not last: after the leases have expired the participants find each other again."""
    talk.network.fate = lambda datagram: ()
    while talk.a.peers or talk.b.peers:
        talk.network.run(5.0)
        assert talk.network.now_ns < 700e9
    talk.network.fate = undisturbed
    talk.until_matched()
    for topic in TYPES:
        talk.logs[topic].payloads.clear()
        talk.write(topic)
        talk.network.run(0.2)
        assert talk.numbers(topic) == [talk.written[topic]]


def hostile(talk: Talk, datagram: bytes) -> bytes:
    dice = talk.random.randrange(5)
    changed = bytearray(datagram)
    if dice == 0:
        for _ in range(talk.random.randrange(1, 4)):
            changed[talk.random.randrange(len(changed))] = talk.random.randrange(256)
    elif dice == 1:
        at = talk.random.randrange(len(changed))
        del changed[at : at + talk.random.randrange(1, 9)]
    elif dice == 2:
        at = talk.random.randrange(20, len(changed) + 1)
        changed[at:at] = talk.random.randbytes(talk.random.randrange(1, 40))
    elif dice == 3:
        changed += datagram[talk.random.randrange(len(datagram)) :]
    else:
        changed = bytearray(messages.header(datagram[8:20]) + forged(talk))
    return bytes(changed)


KINDS = (0x01, 0x06, 0x07, 0x08, 0x09, 0x0C, 0x0E, 0x0F, 0x12, 0x13, 0x16, 0x30, 0x80, 0xFF)
ENTITIES = (
    wire_types.UNKNOWN,
    wire_types.PUBLICATIONS_READER,
    wire_types.PUBLICATIONS_WRITER,
    wire_types.SUBSCRIPTIONS_READER,
    wire_types.SUBSCRIPTIONS_WRITER,
    wire_types.SPDP_WRITER,
    *(wire_types.writer_id(number) for number in range(1, 5)),
    *(wire_types.reader_id(number) for number in range(1, 5)),
)


def forged(talk: Talk) -> bytes:
    """Return submessages of known entities with random numbers. DATA is left out, since it would be a valid
    sample."""
    made = b""
    for _ in range(talk.random.randrange(1, 5)):
        kind, flags = talk.random.choice(KINDS), talk.random.choice((0x01, 0x01, 0x01, 0x03, 0x05, 0x00))
        body = talk.random.choice(ENTITIES) + talk.random.choice(ENTITIES)
        if kind == 0x16:
            body = struct.pack("<HH", 0, 28) + body
        while talk.random.random() < 0.85:
            body += struct.pack(
                "<I", talk.random.choice((0, 1, 2, 5, 200, 2**31, 2**32 - 1, talk.random.getrandbits(9)))
            )
        length = len(body) if talk.random.random() < 0.9 else talk.random.getrandbits(8)
        made += bytes((kind, flags)) + struct.pack("<H", length) + body
    return made


def test_random_submessages_decode_or_are_malformed() -> None:
    """The decoder alone: every structure with every length."""
    dice = random.Random(SEED + 2)
    prefix = zlib.crc32(b"peer").to_bytes(12, "big")
    malformed = 0
    for _ in range(DISTURBED):
        body = dice.randbytes(dice.randrange(64))
        kind = dice.choice((*KINDS, 0x15))
        submessage = bytes((kind, dice.getrandbits(8))) + struct.pack("<H", len(body)) + body
        try:
            messages.decode(memoryview(messages.header(prefix) + submessage), bytes(12))
        except MalformedFrame:
            malformed += 1
    assert 0 < malformed < DISTURBED
