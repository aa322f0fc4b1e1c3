"""Record what the actors of a process receive, answer and send, in order.

While there is no recorder, the node has no instrument, and the actors pay one ``if``. A recorder attaches over
the mesh. Then a journal notes the events, and a task next to the actors sends them in numbered batches.

Theory. A recorder must never delay the actors. Only a few batches may be unacknowledged, and the journal is
bounded. So a slow, frozen or dead recorder fills the journal and has no other effect. Entries that do not fit
are counted. After such a gap, as at the beginning, the journal continues from the whole memory of the actors,
so that a replay can start there.
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
from strands_actors.kernel.refusals import Code

FORMAT = 1
"""The format of the journal. A recorder with another format is refused."""

PERIOD_S = 0.02
"""The longest time that an entry waits (s). A stop and its results are sent at once."""
CAPACITY = 8192
"""The most entries that wait for a recorder: some ten seconds of an arm at 50 Hz."""
BATCH_BYTES = 16 * 1024
ENTRY_BYTES = 48 * 1024
"""The longest entry. A longer one does not fit into a frame, and becomes a gap."""
WINDOW = 4
"""The most batches without acknowledgement. A frozen recorder leaves so few unread that a socket holds them, so
sending never waits for it."""
STILL_THERE_S = 0.25
"""The longest pause between batches (s). An empty one is sent if there are no entries."""
SILENT_S = 2.0
"""Seconds without an acknowledgement after which a recorder is given up."""


class Kind(enum.IntEnum):
    TOOK = 0  # the actor began to handle a message
    ANSWERED = 1
    DEFERRED = 2  # the answer comes later, under ``number``
    SETTLED = 3  # the answer of ``number``
    SENT = 4  # a message by ``tell``, to the actor ``to``
    SAW = 5  # a value that the handler read from outside of its message
    REFUSED = 6  # the kernel refused a message of the type ``to`` before the actor read it
    NOTED = 7  # an event without a message
    MEMORY = 8  # everything that the actor's decisions depend on; ``number`` of deferred answers so far
    GAP = 9  # ``number`` entries are missing


class Entry(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One line of a journal. ``at_ns`` (CLOCK_MONOTONIC) is the time of an event. It is 0 for the results of a
    message, which follow that message."""

    kind: Kind
    actor: str
    at_ns: int
    number: int
    to: str
    body: msgspec.Raw


class Attach(Message, frozen=True):
    """Begin to send batches to a recorder. This replaces its last session.

    Attributes:
        to: The recorder's address.
        session: The number of the session.
        by: The name of the recorder.
        format: Its format of the journal.
        pid: Its process id.
    """

    to: str
    session: int
    by: str
    format: int = FORMAT
    pid: int = 0


class Attached(Message, frozen=True):
    driver: dict[str, Any]  # class, robot, port and options (``loading.describe_driver``)
    axes: tuple[str, ...]
    unit: str


class Taken(Message, frozen=True):
    """Another recorder is attached to the robot. ``pid`` is its process id, as reported by itself."""

    by: str
    pid: int

    @property
    def text(self) -> str:
        return f"{self.by} records this robot already. end that one first"


class Batch(Message, frozen=True):
    """Encoded entries (``Entry``). An empty batch is a sign of life."""

    session: int
    number: int
    entries: tuple[msgspec.Raw, ...]


class Acknowledge(Message, frozen=True):
    """The recorder has read all batches up to this one."""

    lane = "latest"

    session: int
    number: int


class Detach(Message, frozen=True):
    """End a session. The answer comes when all entries were sent and acknowledged, or a refusal if the session
    is over."""

    session: int


class Detached(Message, frozen=True):
    pass


def _plain(value: object) -> int:
    if isinstance(value, Deferred):
        return value.number
    raise TypeError(f"{type(value).__name__} has no place in a journal")


encode = msgspec.msgpack.Encoder(enc_hook=_plain).encode

_Line = tuple[Kind, str, int, int, str, object]


class Journal:
    """An ``Instrument`` that stores the events of some actors.

    Args:
        names: The names of the actors, by address.
        dull: Message types that are left out.
        remember: Returns the memories to continue from, as (actor, deferrals, memory).
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
        self.hurry = trio.Event()
        """Set by events that are sent at once."""

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

    # -- the Instrument protocol

    def took(self, address: str, at_ns: int, message: Message, asked: bool = False) -> None:
        self._add(Kind.TOOK, address, at_ns, int(asked), "", message)
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

    def refused(self, to: str, what: str, refusal: Refused) -> None:
        self._add(Kind.REFUSED, to, 0, 0, what, refusal)

    def noted(self, address: str, at_ns: int, message: Message) -> None:
        self._add(Kind.NOTED, address, at_ns, 0, "", message)
        self.hurry.set()

    # -- for the task that sends the entries

    def begin(self, now_ns: int) -> None:
        """Add the present memories of the actors. They are encoded at once, since they change."""
        for actor, deferrals, memory in self._remember():
            body = encode(memory)
            # Without a memory a replay compares nothing until the next one.
            if len(body) <= ENTRY_BYTES // 2:
                self._lines.append((Kind.MEMORY, actor, now_ns, deferrals, "", msgspec.Raw(body)))

    def take(self, now_ns: int) -> tuple[msgspec.Raw, ...]:
        """Return the next encoded entries, up to the size of a batch."""
        taken: list[msgspec.Raw] = []
        size = 0
        while size < BATCH_BYTES:
            if not self._lines:
                if not self._missing:
                    break
                self._lines.append((Kind.GAP, "", now_ns, self._missing, "", None))
                self._missing = 0
                self.begin(now_ns)
            line = encode(self._lines[0])
            if len(line) > ENTRY_BYTES:
                self._missing += len(self._lines)
                self._lines.clear()
                continue
            if taken and size + len(line) > BATCH_BYTES:
                break
            self._lines.popleft()
            taken.append(msgspec.Raw(line))
            size += len(line)
        return tuple(taken)


class _RecorderSession:
    """The session of one recorder, with its progress."""

    def __init__(self, attach: Attach, journal: Journal, now_ns: int) -> None:
        self.id = attach.session
        self.to = attach.to
        self.by = attach.by
        self.pid = attach.pid
        self.journal = journal
        self.heard_ns = now_ns
        self.sent = 0
        self.sent_ns = 0
        self.acknowledged = 0
        self.unsent: Batch | None = None  # the recorder's address was not hosted at that time
        self.leaving: Deferred | None = None

    @property
    def done(self) -> bool:
        return self.journal.empty and self.unsent is None and self.acknowledged == self.sent


class InstrumentKeeper(Actor):
    """The actor that a recorder attaches to, one in each process that can be recorded. It serves one recorder
    at a time.

    Args:
        names: The names of the recorded actors, by address.
        attached: The description of the robot for the recorder.
        remember: See ``Journal``.
        dull: See ``Journal``.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        attached: Attached,
        remember: Callable[[], Iterable[tuple[str, int, object]]] = tuple,
        dull: frozenset[type] = frozenset(),
    ) -> None:
        self._names = names
        self._attached = attached
        self._remember = remember
        self._dull = dull
        self._session: _RecorderSession | None = None
        self._given_up = 0  # the last session that ended with unsent entries

    @property
    def recorder_pid(self) -> int:
        """Return the process id of the recorder, as reported by itself, or 0."""
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
                    session.heard_ns = self.context.received_ns
                    session.acknowledged = message.number
                return None
            case Detach():
                return self._detach(message)

    def _attach(self, message: Attach) -> Attached | Taken | Refused:
        if message.format != FORMAT:
            return Refused(Code.FORMAT, f"format {message.format}, this robot has {FORMAT}", "use its version")
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
        """Return the answer to a recorder that leaves a session which is over.

        A recorder that was given up has not received the last entries. It gets a refusal, so that it does not
        call its file whole.
        """
        if session != self._given_up:
            return Detached()
        why = "the robot has given the recording up, and the rest was not sent"
        return Refused(Code.GIVEN_UP, why, "give the recorder more of the computer")

    def _unplug(self, session: _RecorderSession) -> None:
        if self.context.node.instrument is session.journal:
            self.context.node.instrument = None

    async def _ship(self, session: _RecorderSession) -> None:
        """Send the entries, in a task next to the actors.

        A failure here ends the recording and never the process. The recorder notices the silence, and notes it
        in its file.
        """
        journal = session.journal
        try:
            while self._session is session and not (session.leaving is not None and session.done):
                with trio.move_on_after(PERIOD_S):
                    await journal.hurry.wait()
                journal.hurry = trio.Event()
                now_ns = self.context.clock.now_ns()
                if now_ns - session.heard_ns > SILENT_S * NS:
                    self._given_up = session.id
                    break
                self._send_some(session, now_ns)
        except Exception as error:
            self._given_up = session.id
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
                if not entries and now_ns - session.sent_ns < STILL_THERE_S * NS:
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
