"""Public topics over zenoh, which any process may subscribe to and publish on.

They use a separate zenoh session, not the one for messages between actors. So a process that joins this session
reaches topics and nothing else. (A second session of a process costs 40 kB and no thread.) Nothing here blocks
the loop: a subscriber that does not read loses samples, and a flood is thinned out before it enters Python.
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
"""Seconds from an ``at_once`` handler to the wake-up of the loop.

The handler may have started work in another process, which should be done by then. If the loop is woken
earlier, it takes a processor from that work. An e-stop of two robots on two processors took 2.1 to 2.6 ms
without this pause, and takes 1.6 ms with it.
"""
_REPLIES = "answers"
"""The name of the inbox for answers to questions. It is not a zenoh key."""
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
    # For a liveliness token, False when the token has disappeared.
    alive: bool = True
    # Result of the subscription's ``at_once`` function.
    done: Any = None
    # Time of sending by the sender's wall clock, in seconds; 0 if unknown.
    sent_s: float = 0.0
    # For a question, the function that sends an answer (``Reply``).
    reply: Any = None

    @property
    def asker(self) -> str:
        """Return the name of the sender of a question: the last part of the question's key."""
        return self.key.rpartition("/")[2]


class Reply:
    """Sends answers to one question. Only the sender of the question receives them."""

    def __init__(self, query: Any) -> None:
        self._query = query
        self._key = str(query.key_expr)

    def __call__(self, answer: bytes, final: bool = True, schema: str = "") -> bool:
        """Send an answer. Return False if it could not be sent.

        Args:
            answer: The content.
            final: True if no further answer follows.
            schema: Name of the schema, which is sent with the answer. Empty for plain bytes.
        """
        try:
            encoding = _encoding(schema) if schema else zenoh.Encoding.ZENOH_BYTES
            self._query.reply(self._key, answer, encoding=encoding)
            if final:
                self._query.drop()
        except zenoh.ZError:
            # The session is closed, or the final answer has been sent.
            return False
        return True


class Topic:
    """A topic that this process publishes.

    ``has_subscribers`` is True while a process subscribes to it. Checking takes 0.6 us, so that samples without
    a reader are not encoded.
    """

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self._seq = 0

    @property
    def has_subscribers(self) -> bool:
        # zenoh's type stubs wrongly declare this as bool.
        status: Any = self._publisher.matching_status
        return bool(status.matching)

    def put(self, payload: bytes, time_ns: int = 0) -> None:
        """Publish a sample. ``time_ns`` is its time by the wall clock, or 0 for now."""
        self._seq += 1
        with calls:
            self._publisher.put(payload, attachment=_stamp(self._seq, time_ns))


class Poll:
    """Samples and questions that wait in zenoh until ``take`` returns them.

    In a flood only the newest ``keep`` samples and questions remain.
    """

    def __init__(self, subscriber: Any, queryable: Any) -> None:
        both = ((subscriber, _received), (queryable, _question))
        self._rings: list[tuple[Any, Callable[[Any], Received]]] = [(ring, read) for ring, read in both if ring]

    def take(self) -> Received | None:
        for ring, read in self._rings:
            waiting = ring.try_recv()
            if waiting is not None:
                # Samples and questions take turns. So a flood of one kind does not block the other kind.
                self._rings.reverse()
                return read(waiting)
        return None


class PubSub:
    """One zenoh session for public topics. Run ``run`` in the loop in which the handlers are called."""

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
        """Open a session. Raise ``zenoh.ZError`` if it cannot listen, or if a certificate cannot be used."""
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
        """Return the number of peers and routers that this session is connected to."""
        info = self._session.info
        return len(info.peers_zid()) + len(info.routers_zid())

    @property
    def names(self) -> set[str]:
        """Return the names in the certificates of the connected peers. A peer without a certificate has an
        empty name."""
        return {link.auth_identifier or "" for link in self._session.info.links()}

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Call the handlers until the session is closed."""
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
        """Return the topic of a key, declaring it at first use. The encoding names the schema, as
        ``application/json;<schema>``."""
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
        """Publish one urgent sample, such as a command or an answer. zenoh does not keep it for later
        subscribers. It may be called from any thread."""
        with calls:
            if ready := self._ready.get(key):
                ready.put(payload, attachment=_stamp(1))
            else:
                self._session.put(key, payload, encoding=_encoding(schema), attachment=_stamp(1), **_URGENT)

    def put_frame(self, key: str, frame: bytes) -> bool:
        """Publish one urgent sample without an encoding. Return True if it could be sent."""
        try:
            with calls:
                self._session.put(key, frame, **_URGENT)
        except zenoh.ZError:
            # The key is invalid, or the session is closed.
            return False
        return True

    def ask(self, key: str, payload: bytes, schema: str, handler: Callable[[Received], None]) -> None:
        """Send one urgent question. ``handler`` is called in the loop for each answer. Raise
        ``zenoh.ZError`` when the session is closed."""
        inbox = self._inboxes.setdefault(_REPLIES, _Inbox(lambda received: received.done(received), 256, None))

        # This runs on zenoh's thread.
        def arrived(reply: zenoh.Reply) -> None:
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
        """Declare a publisher for this key in advance. It halves the time of ``put`` (0.1 ms for rare samples)."""
        if key not in self._ready:
            self._ready[key] = self._session.declare_publisher(key, encoding=_encoding(schema), **_URGENT)

    def declare_token(self, key: str) -> None:
        """Declare a liveliness token, a key that other sessions see as long as this session is open."""
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
        """Call a handler in the loop for each sample. It replaces an earlier handler of this key.

        Keys are handled in the order in which they were subscribed to.

        Args:
            key: The key to subscribe to.
            handler: Called in the loop.
            keep: The greatest number of waiting samples. Older ones are dropped.
            at_once: Called before ``handler``, on zenoh's thread, even if the loop is busy. It must neither
                wait nor raise. Its result becomes the sample's ``done``. If the result is not None, the loop is
                woken ``AWAY_S`` later.
        """
        self._listen(key, handler, keep, lambda into: self._session.declare_subscriber(key, into), at_once)

    def unsubscribe(self, key: str) -> None:
        """End the subscription of a key. Without one this does nothing."""
        inbox = self._inboxes.pop(key, None)
        if inbox is not None and not self._closed:
            with calls:
                inbox.subscriber.undeclare()

    def watch_tokens(self, key: str, handler: Callable[[Received], None], keep: int = 1024) -> None:
        """Call ``handler`` for each liveliness token (a key that shows that a session is open) that exists,
        appears or disappears.
        """
        liveliness = self._session.liveliness()
        self._listen(key, handler, keep, lambda into: liveliness.declare_subscriber(key, into, history=True))

    def poll(self, keep: int, samples: str = "", questions: str = "") -> Poll:
        """Return a ``Poll`` for the samples of one key and the questions of another key."""
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
        existing = self._inboxes.get(key)
        if existing is not None:
            existing.handler, existing.at_once = handler, at_once
            return
        inbox = self._inboxes[key] = _Inbox(handler, keep, at_once)

        # This runs on zenoh's thread.
        def arrived(sample: zenoh.Sample) -> None:
            if inbox.take(sample):
                time.sleep(AWAY_S)
            self._waker.wake()

        # zenoh would start a Python thread for an indirect callback. That thread outlives a crashed script.
        inbox.subscriber = declare(callback(arrived))


class _Inbox:
    def __init__(
        self, handler: Callable[[Received], None], keep: int, at_once: Callable[[Received], object] | None
    ) -> None:
        self.handler = handler
        self.at_once = at_once
        self.samples: deque[zenoh.Sample | Received] = deque(maxlen=keep)
        # Keep the subscriber, since zenoh ends a subscription that is no longer referenced.
        self.subscriber: Any = None

    def take(self, sample: zenoh.Sample) -> bool:
        """Store a sample, on zenoh's thread. Return True if ``at_once`` returned a result."""
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
