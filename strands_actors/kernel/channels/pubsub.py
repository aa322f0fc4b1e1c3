"""Plain topics over zenoh: what anybody may subscribe to, and what comes in from anybody.

A session of its own, apart from the one that carries messages between actors: whoever joins this
one reaches topics and nothing else. (A second session of a process costs 40 kB and no thread.)
Nothing here ever holds the loop up: a subscriber that does not read loses samples, and a flood is
thinned out before it enters Python.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import trio
import zenoh

from .zenoh_exit import callback, calls, closed, open_session, opened
from .zenoh_session import ANSWERED_S, Waker, config

JSON = "application/json"

AWAY_S = 0.003
"""For what was done at once to be over: who hears of it meanwhile takes a processor from it. An
e-stop of two robots on two processors took 2.1 to 2.6 ms when their roots were woken with it, and
1.6 since."""
_REPLIES = "answers"
"""Where answers to questions wait: no key."""
_WAKE_BATCH = 128
_URGENT: dict[str, Any] = {
    "congestion_control": zenoh.CongestionControl.DROP,
    "priority": zenoh.Priority.REAL_TIME,
    "express": True,
}


class Stamp(msgspec.Struct, frozen=True):
    """The attachment of a sample, as JSON: its number on this topic, and the wall clock."""

    seq: int
    time_ns: int


class Received(msgspec.Struct, frozen=True):
    key: str
    payload: bytes
    encoding: str
    attachment: bytes | None
    alive: bool = True  # of a liveliness token: False when it is gone
    done: Any = None  # what the subscription's ``at_once`` made of it
    sent_s: float = 0.0  # by the sender's wall clock, where it says so
    reply: Any = None  # of a question: takes an answer, and whether it is the last

    @property
    def asker(self) -> str:
        """Return who asks, of a question: with what its key ends."""
        return self.key.rpartition("/")[2]


class Reply:
    """Answers one question. Who asked hears it, and nobody else, whoever listens."""

    def __init__(self, query: Any) -> None:
        self._query = query
        self._key = str(query.key_expr)

    def __call__(self, answer: bytes, final: bool = True, schema: str = "") -> bool:
        """Return whether it could be sent."""
        try:
            encoding = _encoding(schema) if schema else zenoh.Encoding.ZENOH_BYTES
            self._query.reply(self._key, answer, encoding=encoding)
            if final:
                self._query.drop()
        except zenoh.ZError:
            return False  # this session is closed, or the last answer was given
        return True


class Topic:
    """A topic of ours. ``wanted``: somebody subscribes to it (0.6 us; what nobody reads is not
    encoded)."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self._seq = 0

    @property
    def wanted(self) -> bool:
        status: Any = self._publisher.matching_status  # the stubs say bool
        return bool(status.matching)

    def put(self, payload: bytes, time_ns: int = 0) -> None:
        """``time_ns``: what it is of, by the wall clock; 0: of now."""
        self._seq += 1
        with calls:
            self._publisher.put(payload, attachment=_stamp(self._seq, time_ns))


class Poll:
    """Samples and questions that wait below the interpreter until they are taken; of a flood the
    newest ``keep`` remain of each."""

    def __init__(self, subscriber: Any, queryable: Any) -> None:
        both = ((subscriber, _received), (queryable, _question))
        self._rings: list[tuple[Any, Callable[[Any], Received]]] = [(ring, read) for ring, read in both if ring]

    def take(self) -> Received | None:
        for ring, read in self._rings:
            waiting = ring.try_recv()
            if waiting is not None:
                self._rings.reverse()  # a flood of the one keeps none of the other
                return read(waiting)
        return None


class PubSub:
    """One session. Run ``run`` as long as handlers are to be called, in its loop."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._waker = Waker()
        self._closed = False
        self._inboxes: dict[str, _Inbox] = {}
        self._topics: dict[str, Topic] = {}
        self._ready: dict[str, zenoh.Publisher] = {}
        self._polls: dict[tuple[str, str], Poll] = {}
        self._tokens: dict[str, Any] = {}
        opened(self)

    @classmethod
    async def open(
        cls,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        settings: Mapping[str, Any] | None = None,
    ) -> PubSub:
        """Raise ``zenoh.ZError`` when it cannot listen, or a certificate cannot be used."""
        return cls(await trio.to_thread.run_sync(open_session, config(listen, connect, settings)))

    def close(self) -> None:
        """Close the session. Blocks for a few milliseconds."""
        with calls:
            self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open
        closed(self)
        self._closed = True
        self._waker.wake()

    @property
    def connections(self) -> int:
        """Return how many others this session is connected to."""
        info = self._session.info
        return len(info.peers_zid()) + len(info.routers_zid())

    @property
    def names(self) -> set[str]:
        """Return the names in the certificates of those it is connected to; empty for one
        without."""
        return {link.auth_identifier or "" for link in self._session.info.links()}

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Until the session is closed."""
        task_status.started()
        while not self._closed:
            await self._waker.wait()
            for inbox in list(self._inboxes.values()):
                samples = inbox.samples
                for _ in range(min(len(samples), _WAKE_BATCH)):
                    sample = samples.popleft()
                    inbox.handler(sample if isinstance(sample, Received) else _received(sample))
                if samples:
                    self._waker.wake()
        self._waker.close()

    # -- out

    def topic(self, key: str, schema: str, encoding: str = JSON) -> Topic:
        """``schema``: named in the encoding, as ``application/json;<schema>``. One a key, whoever
        asks."""
        if key not in self._topics:
            publisher = self._session.declare_publisher(
                key,
                encoding=zenoh.Encoding(encoding).with_schema(schema),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_LOW,
            )
            self._topics[key] = Topic(publisher)
        return self._topics[key]

    def put(self, key: str, payload: bytes, schema: str) -> None:
        """One urgent sample: a command, an answer. Never kept for those who come later. From any
        thread."""
        with calls:
            if ready := self._ready.get(key):
                ready.put(payload, attachment=_stamp(1))
            else:
                self._session.put(key, payload, encoding=_encoding(schema), attachment=_stamp(1), **_URGENT)

    def put_frame(self, key: str, frame: bytes) -> bool:
        """Send one urgent sample of bytes that say themselves what they are. Return whether it
        could be sent."""
        try:
            with calls:
                self._session.put(key, frame, **_URGENT)
        except zenoh.ZError:
            return False  # no key at all, or the session is closed
        return True

    def ask(self, key: str, payload: bytes, schema: str, handler: Callable[[Received], None]) -> None:
        """Send one urgent question. ``handler`` is called in the loop for each answer. Raise
        ``zenoh.ZError`` when the session is closed."""
        inbox = self._inboxes.setdefault(_REPLIES, _Inbox(lambda received: received.done(received), 256, None))

        def arrived(reply: zenoh.Reply) -> None:  # on zenoh's thread
            if reply.ok is not None:
                inbox.samples.append(msgspec.structs.replace(_received(reply.ok), done=handler))
                self._waker.wake()

        self._session.get(
            key,
            callback(arrived),
            payload=payload,
            encoding=_encoding(schema),
            attachment=_stamp(1),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWERED_S,
            **_URGENT,
        )

    def get_ready(self, key: str, schema: str) -> None:
        """To ``put`` there, in half the time (0.1 ms, when it is seldom done)."""
        if key not in self._ready:
            self._ready[key] = self._session.declare_publisher(key, encoding=_encoding(schema), **_URGENT)

    def declare_token(self, key: str) -> None:
        """There for as long as this session is."""
        if key not in self._tokens:
            self._tokens[key] = self._session.liveliness().declare_token(key)

    # -- in

    def subscribe(
        self,
        key: str,
        handler: Callable[[Received], None],
        keep: int = 256,
        at_once: Callable[[Received], object] | None = None,
    ) -> None:
        """Call ``handler`` in the loop, instead of the one that had this key before. At most
        ``keep`` samples wait, the newest; keys are looked at in the order in which they were
        subscribed to.

        ``at_once``: called before, in zenoh's own thread, whatever the loop does; it must neither
        wait nor raise. What it gives is the sample's ``done``. Unless that is None the loop is
        woken ``AWAY_S`` later."""
        self._listen(key, handler, keep, lambda into: self._session.declare_subscriber(key, into), at_once)

    def watch_tokens(self, key: str, handler: Callable[[Received], None], keep: int = 1024) -> None:
        """Call ``handler`` for each token that is there, comes or goes."""
        liveliness = self._session.liveliness()
        self._listen(key, handler, keep, lambda into: liveliness.declare_subscriber(key, into, history=True))

    def poll(self, keep: int, samples: str = "", questions: str = "") -> Poll:
        """Of the samples that are put on one key, and the questions that are asked on another."""
        keys = samples, questions
        if keys not in self._polls:
            ring = zenoh.handlers.RingChannel
            self._polls[keys] = Poll(
                self._session.declare_subscriber(samples, ring(keep)) if samples else None,
                self._session.declare_queryable(questions, ring(keep)) if questions else None,
            )
        return self._polls[keys]

    def _listen(
        self,
        key: str,
        handler: Callable[[Received], None],
        keep: int,
        declare: Callable[[Any], Any],
        at_once: Callable[[Received], object] | None = None,
    ) -> None:
        known = self._inboxes.get(key)
        if known is not None:
            known.handler, known.at_once = handler, at_once
            return
        inbox = self._inboxes[key] = _Inbox(handler, keep, at_once)

        def arrived(sample: zenoh.Sample) -> None:  # on zenoh's thread
            if inbox.take(sample):
                time.sleep(AWAY_S)
            self._waker.wake()

        # Not indirect: that would be a Python thread, which outlives a script that has crashed.
        inbox.subscriber = declare(callback(arrived))


class _Inbox:
    def __init__(
        self, handler: Callable[[Received], None], keep: int, at_once: Callable[[Received], object] | None
    ) -> None:
        self.handler = handler
        self.at_once = at_once
        self.samples: deque[zenoh.Sample | Received] = deque(maxlen=keep)
        self.subscriber: Any = None  # what nobody refers to is undeclared

    def take(self, sample: zenoh.Sample) -> bool:
        """On zenoh's thread. Whether something was done at once."""
        if self.at_once is None:
            self.samples.append(sample)
            return False
        received = _received(sample)
        done = self.at_once(received)
        self.samples.append(msgspec.structs.replace(received, done=done))
        return done is not None


_encode = msgspec.json.Encoder().encode


def _stamp(seq: int, time_ns: int = 0) -> bytes:
    return _encode(Stamp(seq, time_ns or time.time_ns()))


def _encoding(schema: str) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_JSON.with_schema(schema)


def _question(query: Any) -> Received:
    payload, attachment = query.payload, query.attachment
    return Received(
        str(query.key_expr),
        b"" if payload is None else payload.to_bytes(),
        str(query.encoding or ""),
        None if attachment is None else attachment.to_bytes(),
        reply=Reply(query),
    )


def _received(sample: zenoh.Sample) -> Received:
    attachment = sample.attachment
    return Received(
        str(sample.key_expr),
        sample.payload.to_bytes(),
        str(sample.encoding),
        None if attachment is None else attachment.to_bytes(),
        sample.kind == zenoh.SampleKind.PUT,
        sent_s=0.0 if sample.timestamp is None else sample.timestamp.get_time().timestamp(),
    )
