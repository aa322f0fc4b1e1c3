"""A reader: which writers it hears, what it has of each, what it asks for again. Pure: time is an
argument, answers leave through ``send``, samples through ``deliver``.

Best effort: a sample newer than the last is taken, all else is dropped. Reliable: in order and
complete, as long as the writer still has it; what arrives too early waits, within bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from . import messages
from .discovery import EndpointData
from .messages import Gap, Heartbeat, Send
from .wire_types import PREFIX_SIZE, Address

WINDOW = 256
"""Sequence numbers beyond the next one that are waited for; as many as an ACKNACK can name."""
MAX_WAITING = 1 << 20
"""Bytes of early samples, for each writer."""
GREETING_NS = 100_000_000
"""Between requests for a first heartbeat."""


class Sample(NamedTuple):
    payload: memoryview  # valid during the call that hands it over
    writer: bytes  # GUID
    t_ns: int  # when it arrived
    disposed: bool  # no data: something has ended, and the payload or the key says what
    key: bytes


Deliver = Callable[[Sample], None]


class _Writer:
    """A remote writer, seen from here."""

    def __init__(self, guid: bytes, address: Address) -> None:
        self.prefix = guid[:PREFIX_SIZE]
        self.entity = guid[PREFIX_SIZE:]
        self.address = address
        self.next = 1  # the lowest number that has neither come nor been declared gone
        self.early: dict[int, Sample | None] = {}  # None: will not come
        self.waiting = 0  # bytes in it
        self.serial: int | None = None  # of its last heartbeat
        self.answers = 0


class Reader:
    def __init__(self, data: EndpointData, send: Send, deliver: Deliver) -> None:
        self.data = data
        self.mismatch = ""  # why the last writer of this topic did not fit
        self.is_known_to: Callable[[bytes], bool] = lambda prefix: True
        """Whether a participant has acknowledged that we exist."""
        self.lost = 0  # samples that a writer has sent and that never came
        self.entity = data.guid[PREFIX_SIZE:]
        self._deliver = deliver
        self._send = send
        self._header = messages.header(data.guid[:PREFIX_SIZE])
        self._reliable = data.reliable
        self._writers: dict[bytes, _Writer] = {}
        self._greeted_ns = 0

    @property
    def matched(self) -> int:
        """Writers that fit and know of us: we hear what they write from now on."""
        return sum(
            self.is_known_to(writer.prefix) and (writer.serial is not None or not self._reliable)
            for writer in self._writers.values()
        )

    @property
    def hosts(self) -> tuple[str, ...]:
        """Where the writers are that fit, each host once."""
        return tuple(dict.fromkeys(writer.address[0] for writer in self._writers.values()))

    # -- whom it hears

    def match(self, data: EndpointData, address: Address) -> None:
        """``data`` is of this topic and fits. Told again, it may have moved."""
        known = self._writers.get(data.guid)
        if known is not None:
            known.address = address
            return
        writer = self._writers[data.guid] = _Writer(data.guid, address)
        if self._reliable:
            self._greet(writer)

    def unmatch(self, guid: bytes) -> bool:
        return self._writers.pop(guid, None) is not None

    # -- what it hears

    def wants(self, guid: bytes, sequence: int) -> bool:
        """Whether this sample would still be taken."""
        writer = self._writers.get(guid)
        if writer is None or sequence < writer.next:
            return False
        if not self._reliable:
            return True
        return sequence not in writer.early and sequence < writer.next + WINDOW

    def on_sample(self, sequence: int, sample: Sample) -> None:
        if not self.wants(sample.writer, sequence):
            return
        writer = self._writers[sample.writer]
        if not self._reliable:
            if writer.next > 1:
                self.lost += sequence - writer.next
            writer.next = sequence + 1
            self._deliver(sample)
        elif sequence == writer.next:
            writer.next += 1
            self._deliver(sample)
            self._catch_up(writer)
        elif writer.waiting + len(sample.payload) <= MAX_WAITING:
            writer.waiting += len(sample.payload)
            writer.early[sequence] = sample._replace(payload=memoryview(bytes(sample.payload)))

    def on_heartbeat(self, part: Heartbeat) -> None:
        writer = self._writers.get(part.writer)
        if writer is None or not self._reliable or part.serial == writer.serial:
            return
        greeted = writer.serial is not None
        writer.serial = part.serial
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

    def on_gap(self, part: Gap) -> None:
        writer = self._writers.get(part.writer)
        if writer is None or not self._reliable:
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
        """Ask those for a heartbeat who have not sent any."""
        if not self._reliable or now_ns - self._greeted_ns < GREETING_NS:
            return
        self._greeted_ns = now_ns
        for writer in self._writers.values():
            if writer.serial is None:
                self._greet(writer)

    def _skip_to(self, writer: _Writer, number: int) -> None:
        """Everything below ``number`` that has not come will not come."""
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
