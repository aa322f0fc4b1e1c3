"""Send samples to the matched readers, and send them again on request.

Pure: the time is an argument, and datagrams are sent by the callback ``send``.

A best-effort writer keeps no samples. A reliable writer keeps its last samples, and answers a request for older
ones with a GAP. A reader that is matched late receives earlier samples only if writer and reader are both
transient-local. Otherwise a sample that the reader has acknowledged is never sent again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from . import messages
from .discovery import VOLATILE, EndpointData
from .messages import FRAGMENT_SIZE, AckNack, Frame, Send
from .wire_types import PREFIX_SIZE, UNKNOWN, Address, Buffer

HEARTBEAT_NS = 50_000_000
"""Period of the heartbeats to a reader that has not acknowledged everything."""


class _Reader:
    """The state of one remote reader, as this writer sees it."""

    def __init__(self, data: EndpointData, address: Address, reliable: bool, late: bool, last: int) -> None:
        """Note a new reader. With ``late``, it does not receive the samples up to ``last``, which were written
        before."""
        self.prefix = data.guid[:PREFIX_SIZE]
        self.entity = data.guid[PREFIX_SIZE:]
        self.address = address
        self.reliable = reliable
        self.late = late
        self.start = last + 1 if late else 1  # number of the first sample that the reader may receive
        self.acknowledged = self.start - 1
        self.serial: int | None = None  # number of the reader's last ACKNACK


class Writer:
    def __init__(self, data: EndpointData, send: Send, depth: int | None) -> None:
        """Create a writer without readers.

        Args:
            depth: Number of samples that a reliable writer keeps. None keeps all samples, and the caller must limit
                their number.
        """
        self.data = data
        self.mismatch = ""  # why the last reader of this topic was not compatible
        self.is_acknowledged_by: Callable[[bytes], bool] = lambda prefix: True
        """Return whether a participant has acknowledged that this writer exists."""
        self._send = send
        self._prefix = data.guid[:PREFIX_SIZE]
        self._entity = data.guid[PREFIX_SIZE:]
        self._header = messages.header(self._prefix)
        self._frame = Frame(self._prefix, self._entity, data.reliable)
        self._kept: deque[bytes] | None = deque(maxlen=depth) if data.reliable else None
        self._sequence = 0
        self._heartbeats = 0
        self._heartbeat_ns = 0
        self._readers: dict[bytes, _Reader] = {}
        self._addresses: tuple[Address, ...] = ()
        self._parted: tuple[Address, ...] = ()  # addresses of the last readers, while no reader is matched

    @property
    def has_parted(self) -> bool:
        """Return True if readers were matched and all of them have left. A stop command is still sent to their
        last addresses."""
        return bool(self._parted)

    @property
    def matched(self) -> int:
        """Number of readers that will receive every sample written from now on."""
        return sum(
            self.is_acknowledged_by(reader.prefix) and (reader.serial is not None or not reader.reliable)
            for reader in self._readers.values()
        )

    def acknowledged_by(self, guid: bytes) -> int:
        """Return the number of the last sample up to which this reader has all samples; 0 if it is not matched."""
        reader = self._readers.get(guid)
        return 0 if reader is None else reader.acknowledged

    @property
    def unacknowledged(self) -> int:
        """Number of samples that at least one reliable reader has not acknowledged."""
        waiting = [reader.acknowledged for reader in self._readers.values() if reader.reliable]
        return self._sequence - min(waiting, default=self._sequence)

    def write(self, payload: Buffer) -> int:
        """Send a sample to every matched reader.

        Args:
            payload: The sample with its encapsulation header.

        Returns:
            The number of addresses to which the sample was sent without an error.
        """
        return self._write(payload, self._addresses)

    def write_stop(self, payload: Buffer) -> int:
        """Send a sample that contains a stop command to every matched reader. If no reader is left, send it to the
        last known addresses, because a reader may still exist although its end was announced (SAF-022)."""
        return self._write(payload, self._addresses or self._parted)

    def _write(self, payload: Buffer, addresses: Sequence[Address]) -> int:
        self._sequence += 1
        kept = self._kept
        if kept is not None:
            kept.append(bytes(payload))
        if len(payload) > FRAGMENT_SIZE:
            return self._write_fragments(payload, addresses)
        self._heartbeats += 1
        parts = self._frame.parts(self._sequence, payload, self._first(), self._heartbeats)
        send = self._send
        sent = 0
        for address in addresses:
            sent += send(parts, address)
        return sent

    def _write_fragments(self, payload: Buffer, addresses: Sequence[Address]) -> int:
        """Send all fragments of a sample. An address counts only if every fragment was sent to it without an
        error."""
        sent = dict.fromkeys(addresses, True)
        for piece in messages.fragments(UNKNOWN, self._entity, self._sequence, payload):
            for address in addresses:
                sent[address] &= self._send((self._header, piece), address)
        return sum(sent.values())

    # -- matched readers

    def has_room(self, guid: bytes, most: int) -> bool:
        """Return True if this reader is matched already, or fewer than ``most`` readers are matched."""
        return guid in self._readers or len(self._readers) < most

    def match(self, data: EndpointData, address: Address) -> None:
        """Add a compatible reader of this topic. If it is known, update its address."""
        existing = self._readers.get(data.guid)
        if existing is not None:
            existing.address = address
        else:
            late = self.data.durability == VOLATILE or data.durability == VOLATILE
            reader = _Reader(data, address, self.data.reliable and data.reliable, late, self._sequence)
            self._readers[data.guid] = reader
            if reader.reliable:
                for sequence in range(max(reader.start, self._first()), self._sequence + 1):
                    self._resend(reader, sequence)
                self._beat(reader, final=False)
        self._readdress()

    def unmatch(self, guid: bytes) -> bool:
        removed = self._readers.pop(guid, None) is not None
        if removed:
            self._readdress()
        return removed

    def unmatch_participant(self, prefix: bytes) -> None:
        for guid in [guid for guid in self._readers if guid.startswith(prefix)]:
            self.unmatch(guid)

    def _readdress(self) -> None:
        self._parted = () if self._readers else self._addresses or self._parted
        self._addresses = tuple(dict.fromkeys(reader.address for reader in self._readers.values()))

    # -- reliability

    @property
    def sequence(self) -> int:
        """Sequence number of the last sample."""
        return self._sequence

    def on_acknack(self, part: AckNack) -> None:
        reader = self._readers.get(part.reader)
        if reader is None or not reader.reliable:
            return
        if part.serial is not None:
            if part.serial == reader.serial:
                # The network has delivered this ACKNACK twice.
                return
            reader.serial = part.serial
        reader.acknowledged = max(reader.acknowledged, min(part.base - 1, self._sequence))
        if reader.late:
            # A reader forgets this participant if it is silent for longer than its lease. The reader then requests
            # all samples again, but must not get a sample twice.
            reader.start = reader.acknowledged + 1
        first = max(reader.start, self._first())
        missing = [number for number in part.missing if number <= self._sequence]
        for sequence in missing:
            if sequence >= first:
                self._resend(reader, sequence)
        if lost := [number for number in missing if number < first]:
            self._to(reader, *(messages.gap(reader.entity, self._entity, *span) for span in _spans(lost)))
        if not part.final:
            self._beat(reader, final=True)

    def tick(self, now_ns: int) -> None:
        """Send a heartbeat to each reader that has not acknowledged all samples, or has not sent an ACKNACK yet."""
        if self._kept is None or now_ns - self._heartbeat_ns < HEARTBEAT_NS:
            return
        self._heartbeat_ns = now_ns
        for reader in self._readers.values():
            if reader.reliable and (reader.acknowledged < self._sequence or reader.serial is None):
                self._beat(reader, final=False)

    def _first(self) -> int:
        """Return the number of the oldest kept sample. If no sample is kept, return the number of the next
        sample."""
        return self._sequence + 1 - len(self._kept or ())

    def _resend(self, reader: _Reader, sequence: int) -> None:
        assert self._kept is not None
        payload = self._kept[sequence - self._first()]
        if len(payload) <= FRAGMENT_SIZE:
            self._to(reader, messages.data(reader.entity, self._entity, sequence, payload))
            return
        for piece in messages.fragments(reader.entity, self._entity, sequence, payload):
            self._to(reader, piece)

    def _beat(self, reader: _Reader, final: bool) -> None:
        self._heartbeats += 1
        first = max(reader.start, self._first())
        beat = messages.heartbeat(reader.entity, self._entity, first, self._sequence, self._heartbeats, final)
        self._to(reader, beat)

    def _to(self, reader: _Reader, *parts: bytes) -> None:
        self._send((self._header, messages.info_destination(reader.prefix), *parts), reader.address)


def _spans(numbers: Iterable[int]) -> list[tuple[int, int]]:
    """Combine ascending numbers into ranges ``start <= n < end``."""
    spans: list[tuple[int, int]] = []
    for number in numbers:
        if spans and spans[-1][1] == number:
            spans[-1] = (spans[-1][0], number + 1)
        else:
            spans.append((number, number + 1))
    return spans
