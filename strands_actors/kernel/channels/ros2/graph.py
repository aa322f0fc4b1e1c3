"""The session with the router of a ROS 2 graph: nodes, publishers, subscriptions and services.

The session is a client of the router, since programs of ROS find each other through a router, and rmw_zenoh's
router does not connect peers. Callbacks of zenoh only store what has arrived; handlers run in the loop.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import trio
import zenoh
import zenoh.ext

from ..zenoh_exit import callback, calls, closed, open_session, opened
from ..zenoh_session import Waker, config, short
from .cdr import MalformedCdr, decode, encode
from .names import TOKENS, Attachment, Dialect, Endpoint, Entity, NodeName, Qos, gid_of, read_attachment, read_token

RETRY_S = 0.5
"""How long to wait between two attempts to reach the router."""
MAX_BYTES = 1024 * 1024
"""A received message that is larger is dropped before it is decoded. A trajectory of 5,000 points fits."""
_KEPT = 16
_CALLS_KEPT = 64
_HANDLED_AT_ONCE = 64
_SETTINGS: Mapping[str, Any] = {
    "mode": "client",
    # A client that waits for its router cannot be interrupted. So it gives up at once, and is opened again.
    "connect/timeout_ms": 0,
    "connect/exit_on_failure": True,
    # The cache of a latched publisher needs time stamps.
    "timestamping/enabled": True,
}


class Arrival(NamedTuple):
    """A message from the graph.

    Attributes:
        message: Its fields.
        attachment: Its number, time and sender.
        arrived_ns: The time of its arrival on this host's monotonic clock, in nanoseconds.
    """

    message: dict[str, Any]
    attachment: Attachment
    arrived_ns: int


class Call:
    """A request to a service, which must be answered."""

    def __init__(self, arrival: Arrival, response_type: str, query: Any, key: str) -> None:
        self.arrival = arrival
        self._response_type = response_type
        self._query = query
        self._key = key

    def reply(self, message: Mapping[str, Any]) -> None:
        """Send the response. A client that has gone gets no response, which is no error."""
        attachment = self.arrival.attachment._replace(sent_ns=time.time_ns())
        with calls, contextlib.suppress(zenoh.ZError):
            self._query.reply(self._key, encode(self._response_type, message), attachment=attachment.encode())
            self._query.drop()


class Publisher:
    """A topic that a node publishes."""

    def __init__(self, publisher: Any, type_name: str, gid: bytes, is_latched: bool) -> None:
        self._publisher = publisher
        self._type_name = type_name
        self._gid = gid
        self._is_latched = is_latched
        self._sequence = itertools.count(1)

    @property
    def has_subscribers(self) -> bool:
        """Return True if a message would be received. A latched one is kept for later subscribers."""
        return self._is_latched or bool(self._publisher.matching_status.matching)

    def publish(self, message: Mapping[str, Any]) -> None:
        """Send a message.

        Raises:
            ValueError: A value does not fit its field.
        """
        attachment = Attachment(next(self._sequence), time.time_ns(), self._gid)
        payload = encode(self._type_name, message)
        with calls:
            self._publisher.put(payload, attachment=attachment.encode())


class Client:
    """A client of one service. ``Node.client`` makes it.

    Args:
        graph: The graph.
        service: The full name of the service.
        type_name: Its type.
        gid: The identifier of this client.
    """

    def __init__(self, graph: Graph, service: str, type_name: str, gid: bytes) -> None:
        self._graph = graph
        self._service = service
        self._type_name = type_name
        self._key = graph.dialect.key(service, type_name)
        self._gid = gid
        self._sequence = itertools.count(1)
        self.inbox = _Inbox(self._on_reply, _CALLS_KEPT)

    def send(
        self, request: Mapping[str, Any], on_response: Callable[[dict[str, Any]], None], within_s: float
    ) -> None:
        """Send a request. ``on_response`` is called in the loop with the response, if one comes.

        Args:
            request: The request.
            on_response: Called with the response.
            within_s: A later response is dropped, in seconds.

        Raises:
            ValueError: A value does not fit its field.
        """
        attachment = Attachment(next(self._sequence), time.time_ns(), self._gid)
        payload = encode(f"{self._type_name}_Request", request)
        inbox, graph = self.inbox, self._graph

        # This runs on zenoh's thread.
        def arrived(reply: Any) -> None:
            if reply.ok is not None:
                inbox.waiting.append(((reply.ok, on_response), time.monotonic_ns()))
                graph.wake()

        with calls:
            graph.session.get(
                self._key,
                callback(arrived),
                payload=payload,
                attachment=attachment.encode(),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=within_s,
            )

    def _on_reply(self, reply: Any, arrived_ns: int) -> None:
        sample, on_response = reply
        payload = sample.payload.to_bytes()
        if len(payload) > MAX_BYTES:
            self._graph.on_malformed(self._service, f"the response has {len(payload)} bytes")
            return
        try:
            response = decode(f"{self._type_name}_Response", payload)
        except MalformedCdr as error:
            self._graph.on_malformed(self._service, str(error))
            return
        on_response(response)


class _Inbox:
    """Arrived samples or queries that wait for the loop. In a flood only the newest remain."""

    def __init__(self, handle: Callable[[Any, int], None], keep: int) -> None:
        self.handle = handle
        self.waiting: deque[tuple[Any, int]] = deque(maxlen=keep)


class Node:
    """One node. ``close`` takes it and all its endpoints off the graph."""

    def __init__(self, graph: Graph, name: NodeName) -> None:
        self._graph = graph
        self.name = name
        self._declared: list[Any] = []
        self._inboxes: list[_Inbox] = []
        self._declare_token(name.token(graph.dialect))

    def publisher(self, topic: str, type_name: str, qos: Qos = Qos.DEFAULT) -> Publisher:
        """Declare a publisher. ``topic`` is the full name, with a slash in front."""
        session, key = self._graph.session, self._graph.dialect.key(topic, type_name)
        latched = qos is Qos.LATCHED
        with calls:
            if latched:
                publisher: Any = zenoh.ext.declare_advanced_publisher(
                    session, key, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
                )
            else:
                publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        self._declared.append(publisher)
        token = self._endpoint(Entity.PUBLISHER, topic, type_name, qos)
        return Publisher(publisher, type_name, gid_of(token), latched)

    def subscribe(
        self, topic: str, type_name: str, handler: Callable[[Arrival], None], qos: Qos = Qos.DEFAULT
    ) -> None:
        """Call ``handler`` in the loop for each message of a topic."""

        def handle(sample: Any, arrived_ns: int) -> None:
            arrival = self._read(topic, type_name, sample, arrived_ns)
            if arrival is not None:
                handler(arrival)

        key = self._graph.dialect.key(topic, type_name)
        self._listen(_Inbox(handle, _KEPT), lambda into: self._graph.session.declare_subscriber(key, into))
        self._endpoint(Entity.SUBSCRIPTION, topic, type_name, qos)

    def serve(self, service: str, type_name: str, handler: Callable[[Call], None]) -> None:
        """Call ``handler`` in the loop for each request to a service."""
        key = self._graph.dialect.key(service, type_name)

        def handle(query: Any, arrived_ns: int) -> None:
            arrival = self._read(service, f"{type_name}_Request", query, arrived_ns)
            if arrival is None:
                query.drop()
            else:
                handler(Call(arrival, f"{type_name}_Response", query, key))

        def declare(into: Any) -> Any:
            return self._graph.session.declare_queryable(key, into, complete=True)

        self._listen(_Inbox(handle, _CALLS_KEPT), declare)
        self._endpoint(Entity.SERVICE, service, type_name, Qos.DEFAULT)

    def client(self, service: str, type_name: str) -> Client:
        """Return a client of a service, which another node serves."""
        token = self._endpoint(Entity.CLIENT, service, type_name, Qos.DEFAULT)
        client = Client(self._graph, service, type_name, gid_of(token))
        self._inboxes.append(client.inbox)
        self._graph.add(client.inbox)
        return client

    def close(self) -> None:
        """Take the node off the graph. Blocks for a few milliseconds."""
        for inbox in self._inboxes:
            self._graph.forget(inbox)
        with calls:
            for declared in reversed(self._declared):
                # The session may have been closed already, which takes everything off the graph, too.
                with contextlib.suppress(zenoh.ZError):
                    declared.undeclare()
        self._declared.clear()

    def _read(self, topic: str, type_name: str, received: Any, arrived_ns: int) -> Arrival | None:
        payload = b"" if received.payload is None else received.payload.to_bytes()
        attachment = read_attachment(None if received.attachment is None else received.attachment.to_bytes())
        if attachment is None:
            self._graph.on_malformed(topic, "the message has no attachment of rmw_zenoh")
        elif len(payload) > MAX_BYTES:
            self._graph.on_malformed(topic, f"the message has {len(payload)} bytes, and {MAX_BYTES} are allowed")
        else:
            try:
                return Arrival(decode(type_name, payload), attachment, arrived_ns)
            except MalformedCdr as error:
                self._graph.on_malformed(topic, str(error))
        return None

    def _listen(self, inbox: _Inbox, declare: Callable[[Any], Any]) -> None:
        self._inboxes.append(inbox)
        self._declared.append(self._graph.listen(inbox, declare))

    def _endpoint(self, kind: Entity, topic: str, type_name: str, qos: Qos) -> str:
        token = self.name.endpoint_token(self._graph.dialect, self._graph.number(), kind, topic, type_name, qos)
        self._declare_token(token)
        return token

    def _declare_token(self, token: str) -> None:
        with calls:
            self._declared.append(self._graph.session.liveliness().declare_token(token))


class Graph:
    """The session with the router of a graph. ``connect`` makes it; run ``run`` in the loop of its handlers.

    Args:
        session: The open session.
        dialect: The domain, and if types have hashes.
        on_malformed: Called with the name of a topic and a reason for each message that cannot be read.
    """

    def __init__(self, session: Any, dialect: Dialect, on_malformed: Callable[[str, str], None]) -> None:
        self.session = session
        self.dialect = dialect
        self.on_malformed = on_malformed
        self.endpoints: dict[str, Endpoint] = {}
        """The endpoints of all other nodes of the graph, by token."""
        self._numbers = itertools.count()
        self._waker = Waker()
        self._inboxes: list[_Inbox] = []
        self._closed = False
        opened(self)
        watch = _Inbox(self._on_token, 4096)
        self._watch = self.listen(
            watch,
            lambda into: session.liveliness().declare_subscriber(
                f"{TOKENS}/{dialect.domain}/**", into, history=True
            ),
        )

    @property
    def is_connected(self) -> bool:
        """Return True if the router is connected. zenoh connects again by itself."""
        return bool(self.session.info.routers_zid())

    def publishers(self, topic: str) -> list[str]:
        """Return the names of all nodes that publish a topic."""
        return self.nodes_with(Entity.PUBLISHER, topic)

    def nodes_with(self, kind: Entity, topic: str) -> list[str]:
        """Return the names of all other nodes that have an endpoint of this kind for a topic or service."""
        matching = (each for each in self.endpoints.values() if each.kind == kind and each.topic == topic)
        return sorted({endpoint.node for endpoint in matching})

    def node(self, namespace: str, name: str) -> Node:
        """Add a node to the graph."""
        return Node(self, NodeName(str(self.session.info.zid()), self.number(), namespace, name))

    def number(self) -> int:
        """Return a number that no other node or endpoint of this session has."""
        return next(self._numbers)

    def listen(self, inbox: _Inbox, declare: Callable[[Any], Any]) -> Any:
        self._inboxes.append(inbox)

        # This runs on zenoh's thread.
        def arrived(received: Any) -> None:
            inbox.waiting.append((received, time.monotonic_ns()))
            self._waker.wake()

        with calls:
            return declare(callback(arrived))

    def add(self, inbox: _Inbox) -> None:
        """Handle an inbox in the loop. Something else fills it, and calls ``wake``."""
        self._inboxes.append(inbox)

    def wake(self) -> None:
        """Let the loop handle arrivals. It may be called from any thread."""
        self._waker.wake()

    def forget(self, inbox: _Inbox) -> None:
        """Drop an inbox, with what waits in it."""
        if inbox in self._inboxes:
            self._inboxes.remove(inbox)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Call the handlers until the session is closed."""
        task_status.started()
        while not self._closed:
            await self._waker.wait()
            for inbox in list(self._inboxes):
                for _ in range(min(len(inbox.waiting), _HANDLED_AT_ONCE)):
                    inbox.handle(*inbox.waiting.popleft())
                if inbox.waiting:
                    self._waker.wake()
        self._waker.close()

    def close(self) -> None:
        """Close the session. Blocks for a few milliseconds."""
        if self._closed:
            return
        with calls:
            self.session.close()
        closed(self)
        self._closed = True
        self._waker.wake()

    def _on_token(self, sample: Any, arrived_ns: int) -> None:
        token = str(sample.key_expr)
        endpoint = read_token(token)
        if sample.kind != zenoh.SampleKind.PUT:
            self.endpoints.pop(token, None)
        elif endpoint is not None:
            self.endpoints[token] = endpoint


async def connect(
    router: str,
    dialect: Dialect,
    on_malformed: Callable[[str, str], None],
    on_waiting: Callable[[str], None],
) -> Graph:
    """Connect to the router, and wait for it as long as it takes.

    Args:
        router: The endpoint of the router, such as ``tcp/localhost:7447``.
        dialect: The domain, and if types have hashes.
        on_malformed: See ``Graph``.
        on_waiting: Called with the reason after each attempt that failed.

    Returns:
        The session. The caller has to run and to close it.
    """
    while True:
        try:
            return await connect_once(router, dialect, on_malformed)
        except zenoh.ZError as error:
            on_waiting(short(error))
            await trio.sleep(RETRY_S)


async def connect_once(router: str, dialect: Dialect, on_malformed: Callable[[str, str], None]) -> Graph:
    """Connect to the router. For the arguments see ``connect``.

    Raises:
        zenoh.ZError: The router does not answer.
    """
    session = await trio.to_thread.run_sync(open_session, config((), [router], _SETTINGS))
    return Graph(session, dialect, on_malformed)
