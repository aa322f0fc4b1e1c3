"""Send samples to the matched readers, and send them again on request.

Pure: time is an argument, and datagrams leave through ``send``.

A best-effort writer keeps nothing. A reliable writer keeps its last samples, and answers requests
for older ones with a GAP. A reader that is matched late gets earlier samples only if both sides are
transient-local. Otherwise an acknowledged sample is never sent again.
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
    """The state of one remote reader."""

    def __init__(self, data: EndpointData, address: Address, reliable: bool, late: bool, last: int) -> None:
        """``late``: do not send it samples that were written before (up to ``last``)."""
        self.prefix = data.guid[:PREFIX_SIZE]
        self.entity = data.guid[PREFIX_SIZE:]
        self.address = address
        self.reliable = reliable
        self.late = late
        self.start = last + 1 if late else 1  # the first sample that it may get
        self.acknowledged = self.start - 1
        self.serial: int | None = None  # of its last ACKNACK


class Writer:
    def __init__(self, data: EndpointData, send: Send, depth: int | None) -> None:
        """Create a writer without readers.

        Args:
            depth: Number of samples kept. None keeps all, and the caller must bound them. Unused
                for best effort.
        """
        self.data = data
        self.mismatch = ""  # why the last reader of this topic did not fit
        self.is_known_to: Callable[[bytes], bool] = lambda prefix: True
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
        self._parted: tuple[Address, ...] = ()  # of the last readers, while no reader is matched

    @property
    def has_parted(self) -> bool:
        """Return whether all readers have left. A stop is still sent to their last addresses."""
        return bool(self._parted)

    @property
    def matched(self) -> int:
        """Number of readers that receive every sample written from now on."""
        return sum(
            self.is_known_to(reader.prefix) and (reader.serial is not None or not reader.reliable)
            for reader in self._readers.values()
        )

    def acknowledged_by(self, guid: bytes) -> int:
        """Return the number up to which this reader has all samples; 0 if it is not matched."""
        reader = self._readers.get(guid)
        return 0 if reader is None else reader.acknowledged

    @property
    def unacknowledged(self) -> int:
        """Number of samples that at least one reliable reader has not acknowledged."""
        waiting = [reader.acknowledged for reader in self._readers.values() if reader.reliable]
        return self._sequence - min(waiting, default=self._sequence)

    def write(self, payload: Buffer) -> int:
        """Send a sample to every reader.

        Args:
            payload: The sample with its encapsulation header.

        Returns:
            The number of addresses for which the network accepted it.
        """
        return self._write(payload, self._addresses)

    def write_stop(self, payload: Buffer) -> int:
        """As ``write``. If no reader is left, send to the addresses of the last ones. A reader that was
        announced as gone may still be there (SAF-022)."""
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
        """Send all pieces. An address counts only if the network accepted every piece."""
        taken = dict.fromkeys(addresses, True)
        for piece in messages.fragments(UNKNOWN, self._entity, self._sequence, payload):
            for address in addresses:
                taken[address] &= self._send((self._header, piece), address)
        return sum(taken.values())

    # -- matched readers

    def has_room(self, guid: bytes, most: int) -> bool:
        """Return whether this reader is matched already, or fewer than ``most`` are."""
        return guid in self._readers or len(self._readers) < most

    def match(self, data: EndpointData, address: Address) -> None:
        """Add a reader of this topic that fits. If it is known, update its address."""
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
        """Sequence number of the last sample."""
        return self._sequence

    def on_acknack(self, part: AckNack) -> None:
        reader = self._readers.get(part.reader)
        if reader is None or not reader.reliable:
            return
        if part.serial is not None:
            if part.serial == reader.serial:
                return  # a duplicate made by the network
            reader.serial = part.serial
        reader.acknowledged = max(reader.acknowledged, min(part.base - 1, self._sequence))
        if reader.late:
            # A reader forgets us when we are silent for longer than our lease. It then requests
            # everything again, and must not get a sample twice.
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
        """Send a heartbeat to readers that lack an acknowledgement or have sent no ACKNACK yet."""
        if self._kept is None or now_ns - self._heartbeat_ns < HEARTBEAT_NS:
            return
        self._heartbeat_ns = now_ns
        for reader in self._readers.values():
            if reader.reliable and (reader.acknowledged < self._sequence or reader.serial is None):
                self._beat(reader, final=False)

    def _first(self) -> int:
        """Return the number of the oldest kept sample, or one past the last if no sample is kept."""
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
    """Return ascending numbers as ranges ``start <= n < end``."""
    found: list[tuple[int, int]] = []
    for number in numbers:
        if found and found[-1][1] == number:
            found[-1] = (found[-1][0], number + 1)
        else:
            found.append((number, number + 1))
    return found
