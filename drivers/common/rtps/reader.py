"""Receive the samples of the matched writers, and request missing ones.

Pure: the time is an argument. Answers are sent by the callback ``send``, samples are delivered by ``deliver``.

A best-effort reader delivers each sample that is newer than the last one, and drops all others. A reliable reader
delivers the samples in order and completely, as long as the writer keeps them. A sample that arrives too early
waits, within bounds.

A sequence number far from the last one is accepted only if the writer was silent before. Otherwise one forged
datagram, with a number that is higher by 2^40, would make all following true samples look old. After a silence,
higher and lower numbers are accepted. So the true writer is received again after another sender has used its name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from . import messages
from .discovery import EndpointData
from .messages import Gap, Heartbeat, Send
from .wire_types import PREFIX_SIZE, Address

WINDOW = 256
"""How far beyond the next sequence number a sample may be; as many as an ACKNACK can name."""
MAX_WAITING = 1 << 20
"""Bytes of early samples, for each writer."""
LEAP = WINDOW
"""Numbers that may be missing between two samples of a writer that was not silent."""
REORDERED = 16
"""How many numbers late a network may deliver a sample. A number further back means that the writer
has restarted its count."""
SILENT_NS = 100_000_000
"""After so long without a sample that continues the count, any number is accepted."""
ANEW_NS = 1_000_000_000
"""The same for a reliable writer that seems to restart its count. It is longer, because an older
message may just be late."""
MAX_SAMPLE = 1 << 18
"""Largest size of a fragmented sample in bytes, by default."""
GREETING_NS = 100_000_000
"""Period of the requests for a first heartbeat."""


class Sample(NamedTuple):
    payload: memoryview  # the payload, valid only during the call of ``deliver``
    writer: bytes  # GUID of the writer
    t_ns: int  # time at which the sample arrived
    disposed: bool  # True if the sample has no data, and means that an object (named by payload or key) has ended
    key: bytes


Deliver = Callable[[Sample], None]


class _Writer:
    """The state of one remote writer, as this reader sees it."""

    def __init__(self, guid: bytes, address: Address) -> None:
        self.prefix = guid[:PREFIX_SIZE]
        self.entity = guid[PREFIX_SIZE:]
        self.address = address
        self.next = 1  # lowest number of a sample that was neither received nor declared as not available
        # Time of the last message with an expected sequence number; None if there was no such message.
        self.last_received_ns: int | None = None
        # Samples that wait for earlier ones, by sequence number. None stands for one that will not be sent.
        self.early: dict[int, Sample | None] = {}
        self.waiting = 0  # total size in bytes of the samples in ``early``
        self.serial: int | None = None  # number of the writer's last heartbeat
        self.answers = 0

    def is_silent(self, now_ns: int, for_ns: int = SILENT_NS) -> bool:
        return self.last_received_ns is None or now_ns - self.last_received_ns >= for_ns


class Reader:
    def __init__(self, data: EndpointData, send: Send, deliver: Deliver, max_bytes: int = MAX_SAMPLE) -> None:
        self.data = data
        self.max_bytes = max_bytes
        self.mismatch = ""  # why the last writer of this topic was not compatible
        self.is_acknowledged_by: Callable[[bytes], bool] = lambda prefix: True
        """Return whether a participant has acknowledged that this reader exists."""
        self.lost = 0  # number of samples that were sent and never received
        # Number of messages that were dropped because their sequence number was too far from the last one.
        self.leaps = 0
        self.entity = data.guid[PREFIX_SIZE:]
        self._deliver = deliver
        self._send = send
        self._header = messages.header(data.guid[:PREFIX_SIZE])
        self._reliable = data.reliable
        self._writers: dict[bytes, _Writer] = {}
        self._greeted_ns = 0

    @property
    def matched(self) -> int:
        """Number of writers whose samples this reader will receive."""
        return sum(
            self.is_acknowledged_by(writer.prefix) and (writer.serial is not None or not self._reliable)
            for writer in self._writers.values()
        )

    @property
    def hosts(self) -> tuple[str, ...]:
        """Return the hosts of the matched writers, without repeats."""
        return tuple(dict.fromkeys(writer.address[0] for writer in self._writers.values()))

    # -- matched writers

    def has_room(self, guid: bytes, most: int) -> bool:
        """Return True if this writer is matched already, or fewer than ``most`` writers are matched."""
        return guid in self._writers or len(self._writers) < most

    def match(self, data: EndpointData, address: Address) -> None:
        """Add a compatible writer of this topic. If it is known, update its address."""
        existing = self._writers.get(data.guid)
        if existing is not None:
            existing.address = address
            return
        writer = self._writers[data.guid] = _Writer(data.guid, address)
        if self._reliable:
            self._greet(writer)

    def unmatch(self, guid: bytes) -> bool:
        return self._writers.pop(guid, None) is not None

    # -- received messages

    def wants(self, guid: bytes, sequence: int, now_ns: int) -> bool:
        """Return True if a sample with this number would be accepted now."""
        writer = self._writers.get(guid)
        if writer is None:
            return False
        if self._reliable:
            return writer.next <= sequence < writer.next + WINDOW and sequence not in writer.early
        if writer.next <= sequence <= writer.next + LEAP:
            return True
        return not writer.next - REORDERED <= sequence < writer.next and writer.is_silent(now_ns)

    def on_sample(self, sequence: int, sample: Sample) -> None:
        if not self.wants(sample.writer, sequence, sample.t_ns):
            writer_or_none = self._writers.get(sample.writer)
            if writer_or_none is not None and sequence > writer_or_none.next:
                self.leaps += 1
            return
        writer = self._writers[sample.writer]
        if not self._reliable:
            if writer.next > 1:
                self.lost += max(0, sequence - writer.next)
            writer.next = sequence + 1
            writer.last_received_ns = sample.t_ns
            self._deliver(sample)
        elif sequence == writer.next:
            writer.next += 1
            writer.last_received_ns = sample.t_ns
            self._deliver(sample)
            self._catch_up(writer)
        elif writer.waiting + len(sample.payload) <= MAX_WAITING:
            writer.waiting += len(sample.payload)
            writer.early[sequence] = sample._replace(payload=memoryview(bytes(sample.payload)))

    def on_heartbeat(self, part: Heartbeat, now_ns: int) -> None:
        writer = self._writers.get(part.writer)
        if writer is None or not self._reliable or part.serial == writer.serial:
            return
        counts_anew = part.last < writer.next - 1 - REORDERED
        leaps = part.first > writer.next + LEAP
        if (counts_anew and not writer.is_silent(now_ns, ANEW_NS)) or (leaps and not writer.is_silent(now_ns)):
            self.leaps += 1
            return
        greeted = writer.serial is not None
        writer.serial = part.serial
        writer.last_received_ns = now_ns
        # The writer has restarted its count, or another sender has used its name.
        if counts_anew:
            writer.early.clear()
            writer.waiting = 0
            writer.next = part.first
        if part.first > writer.next:
            if greeted:
                self.lost += part.first - writer.next
            self._skip_to(writer, part.first)
        missing = [
            number
            for number in range(writer.next, min(part.last + 1, writer.next + WINDOW))
            if number not in writer.early
        ]
        if missing or not part.final:
            self._answer(writer, missing, final=not missing)

    def on_gap(self, part: Gap, now_ns: int) -> None:
        writer = self._writers.get(part.writer)
        if writer is None or not self._reliable:
            return
        if part.base > writer.next + LEAP and not writer.is_silent(now_ns):
            self.leaps += 1
            return
        end = writer.next + WINDOW
        if part.start <= writer.next:
            self._skip_to(writer, max(writer.next, part.base))
        else:
            for number in range(part.start, min(part.base, end)):
                writer.early.setdefault(number)
        for number in part.listed:
            if writer.next <= number < end:
                writer.early.setdefault(number)
        self._catch_up(writer)

    def tick(self, now_ns: int) -> None:
        """Request a heartbeat from each writer that has not sent one yet."""
        if not self._reliable or now_ns - self._greeted_ns < GREETING_NS:
            return
        self._greeted_ns = now_ns
        for writer in self._writers.values():
            if writer.serial is None:
                self._greet(writer)

    def _skip_to(self, writer: _Writer, number: int) -> None:
        """Deliver the waiting samples below ``number``. The missing ones below ``number`` will not be delivered."""
        for early in sorted(early for early in writer.early if early < number):
            self._take(writer, early)
        writer.next = max(writer.next, number)
        self._catch_up(writer)

    def _catch_up(self, writer: _Writer) -> None:
        while writer.next in writer.early:
            self._take(writer, writer.next)

    def _take(self, writer: _Writer, number: int) -> None:
        sample = writer.early.pop(number)
        writer.next = number + 1
        if sample is not None:
            writer.waiting -= len(sample.payload)
            self._deliver(sample)

    def _greet(self, writer: _Writer) -> None:
        self._answer(writer, (), final=False)

    def _answer(self, writer: _Writer, missing: list[int] | tuple[()], final: bool) -> None:
        writer.answers += 1
        answer = messages.acknack(self.entity, writer.entity, writer.next, missing, writer.answers, final)
        self._send((self._header, messages.info_destination(writer.prefix), answer), writer.address)
