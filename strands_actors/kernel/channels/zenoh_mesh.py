"""The mesh over zenoh, which carries messages between the processes of robots. Each address has a pub/sub
inbox, and an id assigns each answer to its request. This has half the latency of zenoh's queries.

Every node listens on its own unix socket and connects to the sockets that it is given. No message is cached or
replayed.

Two facts about zenoh shape this file:

* A subscriber with an ordinary Python callback owns a Python thread. That thread keeps a crashed process
  hanging, with its liveliness token alive. ``Callback(indirect=False)`` has no such thread.
* A callback runs on zenoh's thread. It only appends to a deque and writes an eventfd, or wakes the thread that
  waits for this very answer.

Theory. Each hosted address has a liveliness token, ``<address>/alive``. An address can be reached if its token
is there. A subscription does not show that, since any process may subscribe to a key. When a token disappears,
all requests to its address fail. The frames that its process sent before are read first.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import msgspec
import trio
import zenoh

from strands_actors.kernel.asks import Unreachable, went_away
from strands_actors.kernel.frames import outline
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import PREFIX, Node
from strands_actors.kernel.thread_asks import ThreadAsks

from .permissions import Channel
from .zenoh_exit import callback, calls, closed, open_session, opened
from .zenoh_session import ANSWERED_S, Waker, config, secured_by, unix_endpoint

_WAKE_BATCH = 512
_PUBLISHERS = 32
"""The greatest number of publishers that are kept. Senders of requests change, so beyond this number the oldest
publisher is dropped. It is declared again when needed.
"""

EVERYBODY = f"{PREFIX}/**/alive"
"""The key of the tokens of all actors and nodes."""


class TokenLost(NamedTuple):
    """A notice that the liveliness token of an address has disappeared.

    It waits in the same queue as the frames, so that all earlier frames are read first.
    """

    address: str


class ZenohMesh:
    """One zenoh session of one process. Call ``attach`` with a node, then run ``run`` as long as the node
    lives.
    """

    def __init__(self, session: zenoh.Session, main: ZenohMesh | None = None) -> None:
        """Use an open session.

        Args:
            session: The session.
            main: Another mesh of this process. Its ``run`` also handles the frames of this session.
        """
        self.channel: Channel | None = None
        self._session = session
        self._pid = os.getpid()
        self._urgent: deque[tuple[ZenohMesh, bytes]] = deque() if main is None else main._urgent
        self._inbox: deque[tuple[ZenohMesh, bytes | TokenLost]] = deque() if main is None else main._inbox
        self._waker: Waker = Waker() if main is None else main._waker
        self._guests: ZenohMesh | None = None
        self._shown: zenoh.Publisher | None = None
        self._publishers: dict[tuple[str, bool], zenoh.Publisher] = {}
        self._subscribers: dict[str, Any] = {}
        self._alive: set[str] = set()
        """The addresses of actors and nodes that have a token. Subscriptions do not count, since any process
        may subscribe."""
        self._tokens: Any = None
        self._private: set[str] = set()
        self._threads: ThreadAsks | None = None
        # Publishers for the requests of threads, by address and by urgency (True for urgent).
        self._request_publishers: dict[tuple[str, bool], zenoh.Publisher] = {}
        self.node: Node
        opened(self)

    @classmethod
    async def open(
        cls,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        settings: Mapping[str, Any] | None = None,
        secret: str = "",
    ) -> ZenohMesh:
        """Open a session, in a worker thread, since it blocks for some 10 ms.

        Args:
            listen: Endpoints to listen on.
            connect: Endpoints to connect to.
            settings: Further settings, by zenoh's own path.
            secret: The secret that all peers must know (``secured_by``).
        """
        return cls(await _open(listen, connect, settings, secret))

    async def let_guests_in(
        self, listen: Sequence[str], channel: Channel, addresses: Sequence[str], show: str
    ) -> None:
        """Open a second session, for guests that do not know the secret of this one.

        Guests can send to the given actors of the node and get answers. They do not receive the messages of
        this session.

        Args:
            listen: Endpoints for guests.
            channel: The permissions of guests.
            addresses: The actors that guests can reach.
            show: The key on which both sessions publish the trace (sender, receiver and type of every message)
                while a process subscribes to it.
        """
        guests = self._guests = ZenohMesh(await _open(listen), self)
        guests.channel, guests.node = channel, self.node
        guests._look_for(EVERYBODY)
        for address in addresses:
            guests.announce(address, True)
        self._shown = guests._shown = guests._session.declare_publisher(show)

    def let_in(self, node: Node, address: str) -> None:
        """Let peers of this session reach one actor of ``node`` and get answers.

        This replaces ``attach``. The node itself sends nothing over this session.
        """
        self.node = node
        self.announce(address, True)

    def attach(self, node: Node, tokens: str = EVERYBODY) -> None:
        """Make this the mesh of a node (the actors of this process), and announce its actors.

        Args:
            node: The node of this process.
            tokens: The key pattern of the liveliness tokens to watch. Access rules may forbid a session to
                watch all tokens.
        """
        self.node = node
        node.mesh = self
        self._look_for(tokens)
        self.announce(node.address, True)
        for address in node.cells:
            self.announce(address, True)

    def _look_for(self, tokens: str) -> None:
        self._tokens = self._session.liveliness().declare_subscriber(tokens, callback(self._on_token), history=True)

    def ask_privately(self, address: str) -> None:
        """From now on send all messages to this address as zenoh queries, also those of threads.

        The key of a query ends with the name of this node. Other processes receive neither the query nor its
        answer, even if they subscribe to every key.
        """
        self._private.add(address)

    def serve_threads(self) -> None:
        """Prepare this mesh for requests from threads (``ask``)."""
        threads = self._threads = ThreadAsks(f"{self.node.address}/threads")

        self._subscribers[threads.reply_to] = (self._subscribe(threads.reply_to, self._on_answer),)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Hand frames from zenoh's thread to the node, in its loop."""
        urgent, inbox = self._urgent, self._inbox
        task_status.started()
        while True:
            await self._waker.wait()
            with self.node.dispatch:
                for _ in range(min(len(urgent) + len(inbox), _WAKE_BATCH)):
                    mesh, data = urgent.popleft() if urgent else inbox.popleft()
                    if isinstance(data, TokenLost):
                        self.node.lost(data.address)
                        continue
                    if mesh._shown is not None:
                        _show(mesh._shown, data)
                    self.node.receive_frame(data, mesh)
            if urgent or inbox:
                self._waker.wake()

    def close(self) -> None:
        """Close the session. Blocks for a few milliseconds."""
        if self._threads is not None:
            self._threads.close("this process has left the mesh")
        with calls:
            self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open
        closed(self)

    # -- methods of ``Connection``, which links and meshes share

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        if self._pid != os.getpid():
            # A forked child has the session, but not its threads.
            return False
        try:
            with calls:
                if to in self._private:
                    return self._query(to, data, self._on_sample, urgent)
                publisher = self._publisher(to, urgent)
                if to in self._alive or _has_subscriber(to, publisher):
                    publisher.put(data)
                    if self._shown is not None:
                        _show(self._shown, data)
                    return True
        except zenoh.ZError:
            # The address is no valid key (a peer chooses the address of its answer), or the session is closed.
            return False
        return self._guests is not None and self._guests.send(to, data, descriptors, urgent)

    def _query(self, to: str, data: bytes, on_answer: Callable[[zenoh.Sample], None], urgent: bool) -> bool:
        if to not in self._alive:
            return False

        # This runs on zenoh's thread.
        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                on_answer(reply.ok)

        self._session.get(
            request_key(to, self.node.address.rpartition("/")[2]),
            callback(answered),
            payload=data,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=_URGENT if urgent else zenoh.Priority.INTERACTIVE_HIGH,
            express=urgent,
            timeout=ANSWERED_S,
        )
        return True

    def _publisher(self, to: str, urgent: bool) -> zenoh.Publisher:
        existing = self._publishers.get((to, urgent))
        if existing is not None:
            return existing
        if "*" in to:
            raise zenoh.ZError(f"{to} is not one address")
        if len(self._publishers) >= _PUBLISHERS:
            self._publishers.pop(next(iter(self._publishers))).undeclare()  # type: ignore[no-untyped-call]
        publisher = self._publishers[to, urgent] = self._declare(to, urgent)
        return publisher

    def _declare(self, to: str, urgent: bool) -> zenoh.Publisher:
        """Declare a publisher.

        Messages of one sender and lane (urgent, command or latest) keep their order. No message is dropped when a
        queue is full, since a stop may be among them. Urgent messages are sent at once (express). The others are
        sent in batches, so that three times as many can be sent per second.
        """
        return self._session.declare_publisher(
            to,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=_URGENT if urgent else zenoh.Priority.INTERACTIVE_HIGH,
            express=urgent,
        )

    def send_at_once(self, data: bytes) -> bool:
        return False

    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        """Send a request and wait for the answer, from any thread except the loop's (``Ref.ask_here``)."""
        if self._threads is None:
            raise RuntimeError("threads cannot ask before serve_threads was called")
        put = partial(self._put_question, message.lane == "urgent")
        return self._threads.ask(put, to, sender, message, decode, deadline_s)

    def forget(self, to: str, reason: str) -> None:
        """End all requests that threads have sent to ``to``. These threads get an error with the text
        ``reason``.
        """
        for urgent in (False, True):
            publisher = self._request_publishers.pop((to, urgent), None)
            if publisher is not None:
                publisher.undeclare()  # type: ignore[no-untyped-call]
        if self._threads is not None:
            self._threads.fail(to, Unreachable(reason))

    def _put_question(self, urgent: bool, to: str, data: bytes) -> bool:
        try:
            with calls:
                if to in self._private:
                    return self._query(to, data, self._on_answer, urgent)
                if to not in self._alive:
                    return False
                publisher = self._request_publishers.get((to, urgent))
                # Two threads may declare a publisher at the same time. Only one of these publishers is kept.
                if publisher is None:
                    publisher = self._request_publishers[to, urgent] = self._declare(to, urgent)
                publisher.put(data)
        except zenoh.ZError:
            return False
        return True

    def announce(self, address: str, hosted: bool) -> None:
        if not hosted:
            for declared in self._subscribers.pop(address, ()):
                declared.undeclare()
        elif address not in self._subscribers:
            inbox = self._subscribe(address, self._on_sample)
            token = self._session.liveliness().declare_token(f"{address}/alive")
            self._subscribers[address] = (inbox, token)

    def _subscribe(self, key: str, on_sample: Callable[[zenoh.Sample], None]) -> Any:
        return self._session.declare_subscriber(key, callback(on_sample))

    # -- code that runs on zenoh's thread

    def _on_sample(self, sample: zenoh.Sample) -> None:
        (self._urgent if sample.priority == _URGENT else self._inbox).append((self, sample.payload.to_bytes()))
        self._waker.wake()

    def _on_answer(self, sample: zenoh.Sample) -> None:
        """Hand an answer to the thread that waits for it."""
        if self._threads is not None:
            self._threads.take(sample.payload.to_bytes())

    def _on_token(self, sample: zenoh.Sample) -> None:
        address = str(sample.key_expr).removesuffix("/alive")
        if sample.kind == zenoh.SampleKind.PUT:
            self._alive.add(address)
            return
        self._alive.discard(address)
        if self._threads is not None:
            self._threads.fail(address, went_away(address))
        # Guests may declare any token. So only a token of the main session shows that an address has gone.
        if self.node.mesh is self:
            self._inbox.append((self, TokenLost(address)))
            self._waker.wake()


async def _open(
    listen: Sequence[str], connect: Sequence[str] = (), settings: Mapping[str, Any] | None = None, secret: str = ""
) -> zenoh.Session:
    # A timestamp lets a receiver see the age of a message. It costs 0.2 us.
    stamped = {"timestamping/enabled": {"peer": True}}
    with secured_by(secret) as credentials:
        configured = config(listen, connect, {**stamped, **credentials, **(settings or {})})
        return await trio.to_thread.run_sync(open_session, configured)


def _show(shown: zenoh.Publisher, data: bytes) -> None:
    """Publish a frame without its content, for the public trace. The content may have a lease (the right to
    command), which must stay secret.
    """
    # zenoh's type stubs wrongly declare this as bool.
    status: Any = shown.matching_status
    if status.matching and (content := outline(data)) is not None:
        shown.put(content)


_URGENT = zenoh.Priority.REAL_TIME


def _has_subscriber(address: str, publisher: zenoh.Publisher) -> bool:
    """Return True if the address is that of a node, and a process subscribes to it.

    Answers are sent to such an address, and it may have no token. Requests are never sent to it.
    """
    if not address.startswith(f"{PREFIX}/node/"):
        return False
    # zenoh's type stubs wrongly declare this as bool.
    status: Any = publisher.matching_status
    return bool(status.matching)


def request_key(address: str, sender: str) -> str:
    """Return the key on which the node ``sender`` sends requests to an actor.

    Access rules keep other processes from using this key.
    """
    return f"{address}/from/{sender}"


__all__ = ["PREFIX", "ZenohMesh", "config", "request_key", "unix_endpoint"]
