"""Record which messages the actors of a process receive, answer and send, in order.

Without a recorder, the actors only check whether there is one. When a recorder connects over the mesh, a journal
stores the events, and a task in the same process sends them in numbered batches.

Theory. A recorder must never delay the actors. So only a few batches may be unacknowledged, and the journal has a
limited size. A slow, frozen or dead recorder fills the journal and has no other effect. Entries that do not fit are
dropped and counted. After such a gap, and at the beginning, the journal contains the whole memory of each actor, so
that a replay can start there.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec
import trio

from strands_actors.kernel.actor import Actor, Deferred, describe
from strands_actors.kernel.clock import NS
from strands_actors.kernel.frames import TELL
from strands_actors.kernel.messages import Message, Refused

from . import refusals

FORMAT = 1
"""Number of the journal's format. A recorder that reads another format is refused."""

PERIOD_S = 0.02
"""Longest time until an entry is sent, in seconds. A stop and its results are sent at once."""
CAPACITY = 8192
"""Largest number of entries that wait for a recorder: about ten seconds of an arm at 50 Hz."""
BATCH_BYTES = 16 * 1024
ENTRY_BYTES = 48 * 1024
"""Size of the longest entry, in bytes. A longer entry does not fit into a frame and is counted as missing."""
WINDOW = 4
"""Largest number of batches without acknowledgement. If the recorder freezes, the socket's buffer can hold these,
so sending never blocks."""
KEEPALIVE_S = 0.25
"""Longest pause between batches, in seconds. Without entries an empty batch is sent."""
SILENT_S = 2.0
"""The session ends after this many seconds without an acknowledgement."""


class Kind(enum.IntEnum):
    TOOK = 0  # an actor began to handle a message
    ANSWERED = 1  # the actor answered the message that it handles
    DEFERRED = 2  # the actor will answer later, under ``number``
    SETTLED = 3  # the actor sent the deferred answer with this ``number``
    SENT = 4  # the actor sent a message to the actor ``to``, without waiting for a reply
    SAW = 5  # the actor read a value that is not in its message, such as a heartbeat
    REFUSED = 6  # the framework (``kernel``) refused a message of the type ``to`` before the actor got it
    NOTED = 7  # an event that no message between actors shows, such as the start of a process
    # Everything that the actor's decisions depend on. ``number`` is the number of deferred answers so far.
    MEMORY = 8
    GAP = 9  # ``number`` entries are missing here


class Entry(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One entry of a journal. ``at_ns`` is the time of an event (CLOCK_MONOTONIC). It is 0 for the results of a
    message, which follow the entry of that message."""

    kind: Kind
    actor: str
    at_ns: int
    number: int
    to: str
    body: msgspec.Raw


class Attach(Message, frozen=True):
    """Begin to send batches to a recorder. An earlier session of this recorder ends.

    Attributes:
        to: The recorder's address.
        session: Number of the session, chosen by the recorder.
        by: Name of the recorder.
        format: Format of the journal that the recorder can read.
        pid: Process id of the recorder.
    """

    to: str
    session: int
    by: str
    format: int = FORMAT
    pid: int = 0


class Attached(Message, frozen=True):
    driver: dict[str, Any]  # class, robot, port and options of the driver (``loading.describe_driver``)
    axes: tuple[str, ...]
    unit: str


class Taken(Message, frozen=True):
    """The reply when another recorder is already connected. ``pid`` is that recorder's process id, as it reported
    it."""

    by: str
    pid: int

    @property
    def text(self) -> str:
        return f"{self.by} already records this robot. End that recording first"


class Batch(Message, frozen=True):
    """Encoded entries (``Entry``). An empty batch only shows that the process still runs."""

    session: int
    number: int
    entries: tuple[msgspec.Raw, ...]


class Acknowledge(Message, frozen=True):
    """The recorder has read all batches up to the one with this ``number``."""

    lane = "latest"

    session: int
    number: int


class Detach(Message, frozen=True):
    """End a session. The reply is sent when all entries were sent and acknowledged. It is a refusal if the session
    ended earlier and entries were lost."""

    session: int


class Detached(Message, frozen=True):
    pass


def _plain(value: object) -> int:
    if isinstance(value, Deferred):
        return value.number
    raise TypeError(f"a {type(value).__name__} cannot be written to a journal")


encode = msgspec.msgpack.Encoder(enc_hook=_plain).encode

_Line = tuple[Kind, str, int, int, str, object]


class Journal:
    """An ``Instrument`` that stores the events of some actors, until they are sent to a recorder: the messages
    that they receive, answer and send.

    Args:
        names: Name of each recorded actor, by its address.
        dull: Types of messages that are not recorded.
        remember: Returns the memory of each actor (the data on which its decisions depend), as (actor, number of
            deferred answers so far, memory).
    """

    def __init__(
        self,
        names: Mapping[str, str],
        dull: frozenset[type],
        remember: Callable[[], Iterable[tuple[str, int, object]]],
    ) -> None:
        self._names = names
        self._dull = dull
        self._remember = remember
        self._lines: deque[_Line] = deque()
        self._missing = 0
        self.gaps: list[int] = []
        """Number of missing events of each gap that is not reported yet."""
        self.hurry = trio.Event()
        """Set when an event must be sent at once."""

    @property
    def empty(self) -> bool:
        return not self._lines and not self._missing

    def _add(self, kind: Kind, address: str, at_ns: int, number: int, to: str, body: object) -> None:
        name = self._names.get(address)
        if name is None or type(body) in self._dull:
            return
        if self._missing or len(self._lines) >= CAPACITY:
            self._missing += 1
        else:
            self._lines.append((kind, name, at_ns, number, to, body))

    # -- methods of the Instrument protocol

    def took(self, address: str, at_ns: int, message: Message, expects_answer: bool = False) -> None:
        self._add(Kind.TOOK, address, at_ns, int(expects_answer), "", message)
        if message.lane == "urgent":
            self.hurry.set()

    def answered(self, address: str, answer: Message | None) -> None:
        if answer is not None:
            self._add(Kind.ANSWERED, address, 0, 0, "", answer)

    def deferred(self, address: str, number: int) -> None:
        self._add(Kind.DEFERRED, address, 0, number, "", None)

    def settled(self, address: str, number: int, answer: Message | None) -> None:
        self._add(Kind.SETTLED, address, 0, number, "", answer)

    def sent(self, sender: str, to: str, message: Message) -> None:
        self._add(Kind.SENT, sender, 0, 0, name_of(to), message)

    def saw(self, address: str, value: object) -> None:
        self._add(Kind.SAW, address, 0, 0, "", value)

    def refused(self, to: str, message_type: str, refusal: Refused) -> None:
        self._add(Kind.REFUSED, to, 0, 0, message_type, refusal)

    def noted(self, address: str, at_ns: int, message: Message) -> None:
        self._add(Kind.NOTED, address, at_ns, 0, "", message)
        self.hurry.set()

    # -- methods for the task that sends the entries

    def begin(self, now_ns: int) -> None:
        """Append the present memory of each actor to the journal, so that a replay can start here. It is encoded
        at once, since it will change."""
        for actor, deferrals, memory in self._remember():
            body = encode(memory)
            # Leave out a memory that is too large for an entry. A replay can then start only at a later memory.
            if len(body) <= ENTRY_BYTES // 2:
                self._lines.append((Kind.MEMORY, actor, now_ns, deferrals, "", msgspec.Raw(body)))

    def take(self, now_ns: int) -> tuple[msgspec.Raw, ...]:
        """Remove the oldest entries from the journal, as many as one batch can hold, and return them encoded."""
        entries: list[msgspec.Raw] = []
        size = 0
        while size < BATCH_BYTES:
            if not self._lines:
                if not self._missing:
                    break
                self._lines.append((Kind.GAP, "", now_ns, self._missing, "", None))
                self.gaps.append(self._missing)
                self._missing = 0
                self.begin(now_ns)
            line = encode(self._lines[0])
            if len(line) > ENTRY_BYTES:
                self._missing += len(self._lines)
                self._lines.clear()
                continue
            if entries and size + len(line) > BATCH_BYTES:
                break
            self._lines.popleft()
            entries.append(msgspec.Raw(line))
            size += len(line)
        return tuple(entries)


class _RecorderSession:
    """The session of one recorder: its journal, and how much was sent and acknowledged."""

    def __init__(self, attach: Attach, journal: Journal, now_ns: int) -> None:
        self.id = attach.session
        self.to = attach.to
        self.by = attach.by
        self.pid = attach.pid
        self.journal = journal
        self.last_received_ns = now_ns
        self.sent = 0
        self.sent_ns = 0
        self.acknowledged = 0
        # A batch that could not be sent, because the recorder's address was not connected at that time.
        self.unsent: Batch | None = None
        self.leaving: Deferred | None = None

    @property
    def done(self) -> bool:
        return self.journal.empty and self.unsent is None and self.acknowledged == self.sent


class InstrumentKeeper(Actor):
    """The actor to which a recorder connects. Each process that can be recorded has one. It serves one recorder at
    a time.

    Args:
        names: Name of each recorded actor, by its address.
        attached: The reply to the recorder, with the description of the robot.
        remember: Returns the present memory of each actor (see ``Journal``).
        dull: Types of messages that are not recorded.
        on_gap: Called with the number of missing events of each gap in a recording.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        attached: Attached,
        remember: Callable[[], Iterable[tuple[str, int, object]]] = tuple,
        dull: frozenset[type] = frozenset(),
        on_gap: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._on_gap = on_gap
        self._names = names
        self._attached = attached
        self._remember = remember
        self._dull = dull
        self._session: _RecorderSession | None = None
        self._abandoned = 0  # number of the last session that ended although entries had not been sent

    @property
    def recorder_pid(self) -> int:
        """Return the process id of the recorder, as it reported it; 0 without a recorder."""
        return 0 if self._session is None else self._session.pid

    def receive(
        self, message: Attach | Acknowledge | Detach
    ) -> Attached | Taken | Detached | Refused | Deferred | None:
        match message:
            case Attach():
                return self._attach(message)
            case Acknowledge():
                session = self._session
                if session is not None and session.id == message.session:
                    session.last_received_ns = self.context.received_ns
                    session.acknowledged = message.number
                return None
            case Detach():
                return self._detach(message)

    def _attach(self, message: Attach) -> Attached | Taken | Refused:
        if message.format != FORMAT:
            return refusals.other_format(message.format, FORMAT)
        if self._session is not None and self._session.to != message.to:
            return Taken(self._session.by, self._session.pid)
        now_ns = self.context.received_ns
        journal = Journal(self._names, self._dull, self._remember)
        journal.begin(now_ns)
        self._session = session = _RecorderSession(message, journal, now_ns)
        self.context.node.instrument = journal
        self.context.start_soon(self._ship, session)
        return self._attached

    def _detach(self, message: Detach) -> Detached | Deferred | Refused:
        session = self._session
        if session is None or session.id != message.session:
            return self._good_bye(message.session)
        self._unplug(session)
        session.leaving = self.context.defer()
        session.journal.hurry.set()
        return session.leaving

    def _good_bye(self, session: int) -> Detached | Refused:
        """Return the reply to a recorder that ends a session which has already ended.

        If this process has ended the session early, the last entries were not sent. The recorder
        then gets a refusal, so that it does not mark its file as complete.
        """
        if session != self._abandoned:
            return Detached()
        return refusals.recording_given_up()

    def _unplug(self, session: _RecorderSession) -> None:
        if self.context.node.instrument is session.journal:
            self.context.node.instrument = None

    async def _ship(self, session: _RecorderSession) -> None:
        """Send the entries of a session, in a task of this actor.

        A failure here ends the recording, never the process. The recorder then receives no more batches, and notes
        this in its file.
        """
        journal = session.journal
        try:
            while self._session is session and not (session.leaving is not None and session.done):
                with trio.move_on_after(PERIOD_S):
                    await journal.hurry.wait()
                journal.hurry = trio.Event()
                now_ns = self.context.clock.now_ns()
                if now_ns - session.last_received_ns > SILENT_S * NS:
                    self._abandoned = session.id
                    break
                self._send_some(session, now_ns)
        except Exception as error:
            self._abandoned = session.id
            self.context.node.dead(session.to, session, f"recording ended: {describe(error)}")
        finally:
            self._unplug(session)
            if self._session is session:
                self._session = None
            if session.leaving is not None:
                session.leaving.send(self._good_bye(session.id))

    def _send_some(self, session: _RecorderSession, now_ns: int) -> None:
        while session.sent - session.acknowledged < WINDOW:
            batch, session.unsent = session.unsent, None
            if batch is None:
                entries = session.journal.take(now_ns)
                while session.journal.gaps:
                    self._on_gap(session.journal.gaps.pop())
                if not entries and now_ns - session.sent_ns < KEEPALIVE_S * NS:
                    return
                batch = Batch(session.id, session.sent + 1, entries)
            if not self.context.node.send_frame(session.to, TELL, 0, self.context.address, batch):
                session.unsent = batch
                return
            session.sent += 1
            session.sent_ns = now_ns


def name_of(address: str) -> str:
    """Return the name of an actor in a journal: ``gate`` for ``strands/so101/actor/gate``."""
    return address.rpartition("/actor/")[2]
