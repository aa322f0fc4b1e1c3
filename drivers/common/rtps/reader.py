"""Receive the samples of the matched writers, and request the missing ones.

Pure: time is an argument, answers leave through ``send``, samples through ``deliver``.

Best effort: a sample newer than the last is delivered, all others are dropped. Reliable: samples
are delivered in order and complete, as long as the writer still keeps them. Early samples wait,
within bounds.

A sequence number far from the last one is accepted only after the writer was silent. Otherwise one
forged datagram with a leap of 2^40 would make every true sample after it look old. Such a leap is
accepted in both directions. So the true writer is received again after another sender used its
name.
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
    payload: memoryview  # valid during the call that hands it over
    writer: bytes  # GUID
    t_ns: int  # when it arrived
    disposed: bool  # no data: the payload or the key names the object that has ended
    key: bytes


Deliver = Callable[[Sample], None]


class _Writer:
    """The state of one remote writer."""

    def __init__(self, guid: bytes, address: Address) -> None:
        self.prefix = guid[:PREFIX_SIZE]
        self.entity = guid[PREFIX_SIZE:]
        self.address = address
        self.next = 1  # the lowest number that was neither received nor declared gone
        self.heard_ns: int | None = None  # when a message last continued the count; None: never
        self.early: dict[int, Sample | None] = {}  # None: it was declared gone
        self.waiting = 0  # bytes in ``early``
        self.serial: int | None = None  # of its last heartbeat
        self.answers = 0

    def is_silent(self, now_ns: int, for_ns: int = SILENT_NS) -> bool:
        return self.heard_ns is None or now_ns - self.heard_ns >= for_ns


class Reader:
    def __init__(self, data: EndpointData, send: Send, deliver: Deliver, max_bytes: int = MAX_SAMPLE) -> None:
        self.data = data
        self.max_bytes = max_bytes
        self.mismatch = ""  # why the last writer of this topic did not fit
        self.is_known_to: Callable[[bytes], bool] = lambda prefix: True
        """Return whether a participant has acknowledged that this reader exists."""
        self.lost = 0  # samples that were sent and never received
        self.leaps = 0  # messages dropped because their number was too far off
        self.entity = data.guid[PREFIX_SIZE:]
        self._deliver = deliver
        self._send = send
        self._header = messages.header(data.guid[:PREFIX_SIZE])
        self._reliable = data.reliable
        self._writers: dict[bytes, _Writer] = {}
        self._greeted_ns = 0

    @property
    def matched(self) -> int:
        """Number of writers whose samples are received from now on."""
        return sum(
            self.is_known_to(writer.prefix) and (writer.serial is not None or not self._reliable)
            for writer in self._writers.values()
        )

    @property
    def hosts(self) -> tuple[str, ...]:
        """Return the hosts of the matched writers, each once."""
        return tuple(dict.fromkeys(writer.address[0] for writer in self._writers.values()))

    # -- matched writers

    def has_room(self, guid: bytes, most: int) -> bool:
        """Return whether this writer is matched already, or fewer than ``most`` are."""
        return guid in self._writers or len(self._writers) < most

    def match(self, data: EndpointData, address: Address) -> None:
        """Add a writer of this topic that fits. If it is known, update its address."""
        known = self._writers.get(data.guid)
        if known is not None:
            known.address = address
            return
        writer = self._writers[data.guid] = _Writer(data.guid, address)
        if self._reliable:
            self._greet(writer)

    def unmatch(self, guid: bytes) -> bool:
        return self._writers.pop(guid, None) is not None

    # -- received messages

    def wants(self, guid: bytes, sequence: int, now_ns: int) -> bool:
        """Return whether this sample would be accepted."""
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
            writer.heard_ns = sample.t_ns
            self._deliver(sample)
        elif sequence == writer.next:
            writer.next += 1
            writer.heard_ns = sample.t_ns
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
        writer.heard_ns = now_ns
        if counts_anew:  # or another sender has used its name
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
        """Request a heartbeat from each writer that has sent no heartbeat yet."""
        if not self._reliable or now_ns - self._greeted_ns < GREETING_NS:
            return
        self._greeted_ns = now_ns
        for writer in self._writers.values():
            if writer.serial is None:
                self._greet(writer)

    def _skip_to(self, writer: _Writer, number: int) -> None:
        """Deliver the early samples below ``number``, and give up the missing ones."""
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
