"""A writer: what it has sent, who hears it, and what those who ask again get. Pure: time is an
argument, datagrams leave through ``send``.

Best effort keeps nothing. A reliable writer keeps its last samples; what fell out of these is
declared gone. A reader that came late gets old samples only if both sides are transient-local;
otherwise no sample is sent again once it was acknowledged.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from . import messages
from .discovery import VOLATILE, EndpointData
from .messages import FRAGMENT_SIZE, AckNack, Frame, Send
from .wire_types import PREFIX_SIZE, UNKNOWN, Address, Buffer

HEARTBEAT_NS = 50_000_000
"""As long as a reader has not acknowledged everything."""


class _Reader:
    """A remote reader, seen from here."""

    def __init__(self, data: EndpointData, address: Address, reliable: bool, late: bool, last: int) -> None:
        """``late``: what has been written (up to ``last``) is none of its business."""
        self.prefix = data.guid[:PREFIX_SIZE]
        self.entity = data.guid[PREFIX_SIZE:]
        self.address = address
        self.reliable = reliable
        self.late = late
        self.start = last + 1 if late else 1  # it gets nothing from before this one
        self.acknowledged = self.start - 1
        self.serial: int | None = None  # of its last ACKNACK


class Writer:
    def __init__(self, data: EndpointData, send: Send, depth: int | None) -> None:
        """``depth``: samples kept, None for all (then the caller bounds them); unused for best
        effort."""
        self.data = data
        self.mismatch = ""  # why the last reader of this topic did not fit
        self.is_known_to: Callable[[bytes], bool] = lambda prefix: True
        """Whether a participant has acknowledged that we exist."""
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
        self._parted: tuple[Address, ...] = ()  # of those that were there last, while there are none

    @property
    def has_parted(self) -> bool:
        """Return whether nobody reads it any more who did. A stop is still sent to where they were."""
        return bool(self._parted)

    @property
    def matched(self) -> int:
        """Readers that fit and know of us: they hear what is written from now on."""
        return sum(
            self.is_known_to(reader.prefix) and (reader.serial is not None or not reader.reliable)
            for reader in self._readers.values()
        )

    def acknowledged_by(self, guid: bytes) -> int:
        """Return the sample up to which this reader has everything; 0 when it is no reader of
        ours."""
        reader = self._readers.get(guid)
        return 0 if reader is None else reader.acknowledged

    @property
    def unacknowledged(self) -> int:
        """Samples that some reliable reader has not confirmed yet."""
        waiting = [reader.acknowledged for reader in self._readers.values() if reader.reliable]
        return self._sequence - min(waiting, default=self._sequence)

    def write(self, payload: Buffer) -> int:
        """Send a sample, with its encapsulation header, to every reader. Returns how many addresses
        took it."""
        return self._write(payload, self._addresses)

    def write_stop(self, payload: Buffer) -> int:
        """As ``write``; where no reader is left, send it to where the last ones were. Who said that they
        have gone may be there all the same (SAF-022)."""
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
        taken = 0
        for address in addresses:
            taken += send(parts, address)
        return taken

    def _write_fragments(self, payload: Buffer, addresses: Sequence[Address]) -> int:
        """An address has taken it if it took every piece."""
        taken = dict.fromkeys(addresses, True)
        for piece in messages.fragments(UNKNOWN, self._entity, self._sequence, payload):
            for address in addresses:
                taken[address] &= self._send((self._header, piece), address)
        return sum(taken.values())

    # -- who hears it

    def has_room(self, guid: bytes, most: int) -> bool:
        """Return whether this reader is matched, or would be one of ``most``."""
        return guid in self._readers or len(self._readers) < most

    def match(self, data: EndpointData, address: Address) -> None:
        """``data`` is of this topic and fits. Told again, it may have moved."""
        known = self._readers.get(data.guid)
        if known is not None:
            known.address = address
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
        found = self._readers.pop(guid, None) is not None
        if found:
            self._readdress()
        return found

    def unmatch_participant(self, prefix: bytes) -> None:
        for guid in [guid for guid in self._readers if guid.startswith(prefix)]:
            self.unmatch(guid)

    def _readdress(self) -> None:
        self._parted = () if self._readers else self._addresses or self._parted
        self._addresses = tuple(dict.fromkeys(reader.address for reader in self._readers.values()))

    # -- reliability

    @property
    def sequence(self) -> int:
        """Of the last sample."""
        return self._sequence

    def on_acknack(self, part: AckNack) -> None:
        reader = self._readers.get(part.reader)
        if reader is None or not reader.reliable:
            return
        if part.serial is not None:
            if part.serial == reader.serial:
                return  # the network's copy of the last one
            reader.serial = part.serial
        reader.acknowledged = max(reader.acknowledged, min(part.base - 1, self._sequence))
        if reader.late:
            # One that forgot us (we were silent for longer than our lease) asks for everything: not
            # twice.
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
        """Remind those who have not acknowledged everything, or have never said a word."""
        if self._kept is None or now_ns - self._heartbeat_ns < HEARTBEAT_NS:
            return
        self._heartbeat_ns = now_ns
        for reader in self._readers.values():
            if reader.reliable and (reader.acknowledged < self._sequence or reader.serial is None):
                self._beat(reader, final=False)

    def _first(self) -> int:
        """Return the oldest sample kept; one past the last if there is none."""
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
    """Ascending numbers as ``start <= n < end``."""
    found: list[tuple[int, int]] = []
    for number in numbers:
        if found and found[-1][1] == number:
            found[-1] = (found[-1][0], number + 1)
        else:
            found.append((number, number + 1))
    return found
