"""The logic of an RTPS participant, without sockets and without a clock.

Its inputs are datagrams and the time, its outputs are datagrams and samples. It receives only requested topics,
and only from compatible writers. Every table is bounded. Input that is malformed, unknown or in excess is counted
and otherwise ignored. A peer is removed when its lease (the announced time within which it must send again) ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from . import discovery, messages, parameters
from .discovery import TRANSIENT_LOCAL, VOLATILE, EndpointData, ParticipantData
from .matching import Matching
from .messages import AckNack, Data, Fragment, Heartbeat, Send, Submessage
from .peer_address import PeerAddress
from .reader import MAX_SAMPLE, Reader, Sample
from .reassembly import Reassembly
from .wire_types import (
    MAX_ENTITIES,
    MULTICAST_GROUP,
    PARTICIPANT,
    PREFIX_SIZE,
    PUBLICATIONS_READER,
    PUBLICATIONS_WRITER,
    SPDP_READER,
    SPDP_WRITER,
    SUBSCRIPTIONS_READER,
    SUBSCRIPTIONS_WRITER,
    UNKNOWN,
    Address,
    Buffer,
    reader_id,
    writer_id,
)
from .writer import Writer

FEW = 4
"""A datagram with at most so many parts is not searched for repeats."""
MOST_PROCESSED = 64
"""Parts of a datagram that are processed. Reliable writers send the rest again."""
MAX_PEERS = 64
RESERVED = 16
"""Places kept for hosts that were configured as peers, so that strangers cannot fill the table."""
MOST_CHANGES = 4
"""Peers that may leave or change their data between two ticks. Each meeting costs as much as a hundred
samples, so a peer that repeats it could keep us busy. A peer whose farewell is refused ends with its
lease."""
EAGER = 20
"""Number of announcements at the quick pace, before the steady pace."""
EAGER_NS = 100_000_000
STEADY_NS = 1_000_000_000

OnSample = Callable[[memoryview, bytes, int], None]
"""Gets the payload with its encapsulation header (valid during the call), the GUID of the writer, and
the time of arrival (ns)."""


@dataclass(slots=True)
class Counters:
    """Counts of received datagrams, of input that was dropped for each reason, and of datagrams that could not be
    sent."""

    datagrams: int = 0
    malformed: int = 0  # datagrams and discovery samples that could not be decoded
    unmatched: int = 0  # samples from writers that match no reader here
    strangers: int = 0  # announcements of participants that the argument ``only`` excludes
    misplaced: int = 0  # datagrams with a peer's GUID from an address that is not the peer's
    # Number of peers, endpoints, changes and submessages beyond a bound, and of samples too long for their reader.
    refused: int = 0
    unsent: int = 0  # datagrams that could not be sent


class _Peer:
    def __init__(self, data: ParticipantData, host: str, own_host: str, only: PeerAddress | None) -> None:
        self.data = data
        self.host = host  # host from which the peer's announcement came
        self._only = only
        # A peer may send from each address that it has announced.
        self._hosts = {host, *(its_host for its_host, _ in (*data.discovery, *data.user))}
        self.discovery = discovery.nearest(data.discovery, host, own_host)
        self.user = discovery.nearest(data.user, host, own_host)
        self.last_received_ns = 0

    def may_send_from(self, sender: Address) -> bool:
        """Return True if the peer may send from this address."""
        return sender[0] in self._hosts if self._only is None else self._only.holds(sender)


class Engine:
    def __init__(
        self,
        data: ParticipantData,
        announce_to: Sequence[Address],
        send: Send,
        on_match: Callable[[], object] = lambda: None,
        only: PeerAddress | None = None,
    ) -> None:
        """Create the endpoints for discovery. No datagram is sent before the first ``tick``.

        Args:
            data: Our own identity and addresses.
            announce_to: Addresses at which unknown participants may listen: the multicast group and the ports of
                configured peers.
            send: Sends a datagram.
            on_match: Called whenever a match may have changed, so it is called often.
            only: The only address that peers may have and send from. None accepts all participants.
        """
        self.data = data
        self.counters = Counters()
        self._own = data.prefix
        self._host = data.discovery[0][0]
        self._announce_to = tuple(announce_to)
        self._configured_hosts = {host for host, _ in announce_to if host != MULTICAST_GROUP}
        self._network = send
        self._on_match = on_match
        self._only = only
        self._peers: dict[bytes, _Peer] = {}
        self._changes = 0  # number of peers that have left or changed since the last tick
        self._matching = Matching(self._locate, on_match)
        self._reassembly = Reassembly()
        self._endpoints = 0
        self._announced = 0
        self._announced_ns = 0
        self._header = messages.header(self._own)
        self._handshake = messages.data(SPDP_READER, SPDP_WRITER, 1, discovery.encode_participant(data))
        self._publications = self._builtin_writer(PUBLICATIONS_WRITER)
        self._subscriptions = self._builtin_writer(SUBSCRIPTIONS_WRITER)
        self._publications_reader = self._builtin_reader(PUBLICATIONS_READER, self._on_publication)
        self._subscriptions_reader = self._builtin_reader(SUBSCRIPTIONS_READER, self._on_subscription)

    @property
    def peers(self) -> int:
        return len(self._peers)

    def address_of(self, prefix: bytes) -> Address | None:
        """Return the address to which data for a peer is sent; None if the peer is unknown."""
        peer = self._peers.get(prefix)
        return None if peer is None else peer.user

    # -- our endpoints

    def writer(self, topic: str, type_name: str, reliable: bool, transient_local: bool, depth: int) -> Writer:
        """Create and announce a writer. Raise ``ValueError`` if there are ``MAX_ENTITIES`` writers and readers
        already."""
        data = self._endpoint(writer_id, topic, type_name, reliable, transient_local)
        writer = Writer(data, self._send, depth)
        writer.is_acknowledged_by = _acknowledging(self._publications, PUBLICATIONS_READER)
        self._matching.add_writer(writer)
        self._publications.write(discovery.encode_endpoint(data))
        return writer

    def reader(
        self,
        topic: str,
        type_name: str,
        reliable: bool,
        transient_local: bool,
        on_sample: OnSample,
        max_bytes: int = MAX_SAMPLE,
    ) -> Reader:
        """Create and announce a reader. Raise ``ValueError`` if there are ``MAX_ENTITIES`` writers and readers
        already."""

        def deliver(sample: Sample) -> None:
            if len(sample.payload) >= 4 and not sample.disposed:
                on_sample(sample.payload, sample.writer, sample.t_ns)

        data = self._endpoint(reader_id, topic, type_name, reliable, transient_local)
        reader = Reader(data, self._send, deliver, max_bytes)
        reader.is_acknowledged_by = _acknowledging(self._subscriptions, SUBSCRIPTIONS_READER)
        self._matching.add_reader(reader)
        self._subscriptions.write(discovery.encode_endpoint(data))
        return reader

    def _endpoint(
        self, name: Callable[[int], bytes], topic: str, type_name: str, reliable: bool, transient_local: bool
    ) -> EndpointData:
        if self._endpoints == MAX_ENTITIES:
            raise ValueError(f"a participant has at most {MAX_ENTITIES} writers and readers")
        self._endpoints += 1
        durability = TRANSIENT_LOCAL if transient_local else VOLATILE
        guid = self._own + name(self._endpoints)
        return EndpointData(guid, topic, type_name, reliable, durability, self.data.user)

    def _builtin_writer(self, entity: bytes) -> Writer:
        writer = Writer(_builtin(self._own, entity), self._send, MAX_ENTITIES)
        self._matching.writers[entity] = writer
        return writer

    def _builtin_reader(self, entity: bytes, learn: Callable[[Sample], None]) -> Reader:
        def deliver(sample: Sample) -> None:
            try:
                learn(sample)
            except MalformedFrame:
                self.counters.malformed += 1

        return Reader(_builtin(self._own, entity), self._send, deliver)

    # -- input

    def receive(self, datagram: memoryview, sender: Address, now_ns: int) -> int:
        """Process one datagram. The caller may reuse the datagram's buffer afterwards.

        A GUID proves nothing, because every program on the network can read it. So a datagram with a peer's GUID is
        accepted only from an address of that peer.

        Returns:
            The number of submessages in the datagram, as a measure of the time spent.
        """
        self.counters.datagrams += 1
        peer = self._peers.get(bytes(datagram[8 : messages.HEADER_SIZE]))
        if peer is not None and not peer.may_send_from(sender):
            self.counters.misplaced += 1
            return 0
        try:
            parts = messages.decode(datagram, self._own)
        except MalformedFrame:
            self.counters.malformed += 1
            return 0
        if peer is not None:
            peer.last_received_ns = now_ns
        count = len(parts)
        if count > FEW:
            parts = _without_repeats(parts)
        processed = 0
        for part in parts:
            processed += self._on_part(part, sender, now_ns)
            if processed >= MOST_PROCESSED:
                self.counters.refused += 1
                break
        return count

    def _on_part(self, part: Submessage, sender: Address, now_ns: int) -> bool:
        """Process one submessage. Return True if it was for one of our endpoints."""
        matching = self._matching
        if isinstance(part, Data):
            return self._on_data(part, sender, now_ns)
        if isinstance(part, AckNack):
            writer = matching.writers.get(part.writer)
            if writer is None:
                return False
            writer.on_acknack(part)
            # An ACKNACK also means that the peer knows our endpoint, so a match may have changed.
            self._on_match()
            return True
        if isinstance(part, Fragment):
            return self._on_fragment(part, now_ns)
        readers = matching.hearing.get(part.writer, ())
        for reader in readers:
            if part.reader not in (UNKNOWN, reader.entity):
                continue
            if isinstance(part, Heartbeat):
                reader.on_heartbeat(part, now_ns)
                self._on_match()
            else:
                reader.on_gap(part, now_ns)
        return bool(readers)

    def _on_data(self, part: Data, sender: Address, now_ns: int) -> bool:
        sample = Sample(part.payload, part.writer, now_ns, part.disposed, part.key)
        if part.writer[PREFIX_SIZE:] == SPDP_WRITER:
            try:
                self._on_participant(sample, sender)
            except MalformedFrame:
                self.counters.malformed += 1
            return True
        readers = self._matching.hearing.get(part.writer)
        if readers is None:
            self.counters.unmatched += 1
            return False
        for reader in readers:
            if part.reader in (UNKNOWN, reader.entity):
                reader.on_sample(part.sequence, sample)
        return True

    def _on_fragment(self, part: Fragment, now_ns: int) -> bool:
        readers = [
            reader
            for reader in self._matching.hearing.get(part.writer, ())
            if part.reader in (UNKNOWN, reader.entity) and reader.wants(part.writer, part.sequence, now_ns)
        ]
        if not readers:
            self.counters.unmatched += 1
            return False
        # Check the size before memory is allocated for the whole sample.
        readers = [reader for reader in readers if part.total <= reader.max_bytes]
        if not readers:
            self.counters.refused += 1
            return False
        try:
            whole = self._reassembly.add(part, now_ns)
        except MalformedFrame:
            self.counters.malformed += 1
            return True
        if whole is not None:
            sample = Sample(memoryview(whole), part.writer, now_ns, part.disposed, b"")
            for reader in readers:
                reader.on_sample(part.sequence, sample)
        return True

    # -- discovery

    def _on_participant(self, sample: Sample, sender: Address) -> None:
        prefix = sample.writer[:PREFIX_SIZE]
        if sample.disposed:
            guid = discovery.ended_guid(sample.payload, sample.key, parameters.PARTICIPANT_GUID)
            if guid == prefix + PARTICIPANT and prefix in self._peers and self._may_change():
                self._part(prefix)
            return
        data = discovery.decode_participant(sample.payload)
        if data.prefix != prefix:
            raise MalformedFrame("a participant that speaks for another")
        existing = self._peers.get(prefix)
        if existing and existing.data == data:
            return
        if self._only is not None and not self._only.has(data, sender):
            self.counters.strangers += 1
            return
        if existing:
            if self._may_change():
                self._move(prefix, data)
            return
        room = MAX_PEERS if sender[0] in self._configured_hosts else MAX_PEERS - RESERVED
        if len(self._peers) >= room:
            self.counters.refused += 1
            return
        peer = self._peers[prefix] = _Peer(data, sender[0], self._host, self._only)
        peer.last_received_ns = sample.t_ns
        self._meet(prefix, peer.discovery)

    def _meet(self, prefix: bytes, address: Address) -> None:
        """Announce our participant, writers and readers to a new peer at once."""
        self._send((self._header, self._handshake), address)
        join = self._matching
        join.join_reader(self._publications, _builtin(prefix, PUBLICATIONS_READER), address)
        join.join_reader(self._subscriptions, _builtin(prefix, SUBSCRIPTIONS_READER), address)
        join.join_writer(self._publications_reader, _builtin(prefix, PUBLICATIONS_WRITER), address)
        join.join_writer(self._subscriptions_reader, _builtin(prefix, SUBSCRIPTIONS_WRITER), address)

    def _move(self, prefix: bytes, data: ParticipantData) -> None:
        """Use the new addresses or the new lease (time within which it must send again) of a peer. Its endpoints
        stay matched, because a stop command must not wait until the peer has announced them again."""
        previous = self._peers[prefix]
        peer = self._peers[prefix] = _Peer(data, previous.host, self._host, self._only)
        peer.last_received_ns = previous.last_received_ns
        self._meet(prefix, peer.discovery)
        self._matching.relocate(prefix)

    def _may_change(self) -> bool:
        self._changes += 1
        if self._changes > MOST_CHANGES:
            self.counters.refused += 1
        return self._changes <= MOST_CHANGES

    def _part(self, prefix: bytes) -> None:
        if self._peers.pop(prefix, None):
            self._matching.forget_peer(prefix)
            self._reassembly.forget(prefix)

    def _on_publication(self, sample: Sample) -> None:
        matching = self._matching
        self._on_endpoint(sample, True, matching.learn_writer, matching.forget_writer)

    def _on_subscription(self, sample: Sample) -> None:
        matching = self._matching
        self._on_endpoint(sample, False, matching.learn_reader, matching.forget_reader)

    def _on_endpoint(
        self,
        sample: Sample,
        is_writer: bool,
        learn: Callable[[EndpointData], bool],
        forget: Callable[[bytes], None],
    ) -> None:
        if sample.disposed:
            guid = discovery.ended_guid(sample.payload, sample.key, parameters.ENDPOINT_GUID)
        else:
            data = discovery.decode_endpoint(sample.payload, is_writer)
            guid = data.guid
        if guid[:PREFIX_SIZE] != sample.writer[:PREFIX_SIZE]:
            raise MalformedFrame("an endpoint of somebody else")
        if sample.disposed:
            forget(guid)
        elif not learn(data):
            self.counters.refused += 1

    def _locate(self, remote: EndpointData) -> Address | None:
        peer = self._peers.get(remote.guid[:PREFIX_SIZE])
        if peer is None:
            return None
        return discovery.nearest(remote.locators or (peer.user,), peer.host, self._host)

    # -- time

    def tick(self, now_ns: int) -> None:
        """Send announcements and heartbeats that are due, and remove peers that have sent nothing for their lease
        (the time that they have announced).

        Call it often (20 times a second), after ``receive`` has processed the waiting datagrams.
        """
        self._changes = 0
        if not self._announced or now_ns - self._announced_ns >= (
            EAGER_NS if self._announced < EAGER else STEADY_NS
        ):
            self._announced += 1
            self._announced_ns = now_ns
            self._announce()
        for prefix, peer in list(self._peers.items()):
            if now_ns - peer.last_received_ns > peer.data.lease_s * 1e9:
                self._part(prefix)
        for writer in self._matching.writers.values():
            writer.tick(now_ns)
        self._publications_reader.tick(now_ns)
        self._subscriptions_reader.tick(now_ns)
        for reader in self._matching.readers.values():
            reader.tick(now_ns)
        self._reassembly.tick(now_ns)

    def _announce(self) -> None:
        peer_addresses = [peer.discovery for peer in self._peers.values()]
        for address in dict.fromkeys((*self._announce_to, *peer_addresses)):
            self._send((self._header, self._handshake), address)

    def say_goodbye(self) -> None:
        """Inform every peer that this participant ends."""
        guid = self._own + PARTICIPANT
        key = discovery.encode_ended(guid, parameters.PARTICIPANT_GUID)
        farewell = messages.disposal(SPDP_READER, SPDP_WRITER, 2, guid, key)
        for peer in self._peers.values():
            self._send((self._header, farewell), peer.discovery)

    def _send(self, parts: Sequence[Buffer], address: Address) -> bool:
        if self._network(parts, address):
            return True
        self.counters.unsent += 1
        return False


def _without_repeats(parts: list[Submessage]) -> list[Submessage]:
    """Drop repeated HEARTBEAT and ACKNACK messages of one datagram: of each sender and receiver only the last is
    kept.

    The last message includes the content of the earlier ones. Each message would be answered by a datagram, or by
    all requested samples. A datagram full of such messages would keep this process busy for a quarter of a second.
    """
    last = {(type(part), part.writer, part.reader): index for index, part in enumerate(parts)}
    return [
        part
        for index, part in enumerate(parts)
        if not isinstance(part, Heartbeat | AckNack) or last[type(part), part.writer, part.reader] == index
    ]


def _acknowledging(announcements: Writer, reader: bytes) -> Callable[[bytes], bool]:
    """Return a function that takes the GUID prefix of a participant. It returns True if this participant has
    acknowledged the announcement that the writer ``announcements`` will send next."""
    number = announcements.sequence + 1
    return lambda prefix: announcements.acknowledged_by(prefix + reader) >= number


def _builtin(prefix: bytes, entity: bytes) -> EndpointData:
    return EndpointData(prefix + entity, "", "", True, TRANSIENT_LOCAL, ())
