"""The connection of one process to a ROS 2 graph, by the router of rmw_zenoh.

It is a client of the router. When the router is lost, zenoh connects again by itself, and nothing that was sent in
between is kept. ROS acknowledges no message of a topic, so a sender learns only from the reports of a node what has
become of its messages.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable

import trio
import zenoh

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.channels.ros2.graph import Graph, Node, connect_once
from strands_actors.kernel.channels.ros2.names import Dialect
from strands_actors.kernel.channels.zenoh_session import short

ROUTER = "tcp/localhost:7447"
"""Where rmw_zenohd listens by default."""

ENDPOINTS = ("tcp/", "unixsock-stream/")
LOOK_S = 0.01
AGAIN_S = 0.2


class GraphPort:
    """A node of a graph.

    Args:
        router: The endpoint of the router.
        dialect: The domain, and if types have hashes.
        name: The name of the node.
        declare: Called with each new node, to declare its endpoints.
    """

    def __init__(self, router: str, dialect: Dialect, name: str, declare: Callable[[Node], None]) -> None:
        self.malformed = 0
        """The number of messages that could not be read."""
        self._router = router
        self._dialect = dialect
        self._name = name
        self._declare = declare
        self._graph: Graph | None = None
        self._receives = False

    @property
    def graph(self) -> Graph:
        """The session. Raises ``WireDown`` without one."""
        if self._graph is None:
            raise WireDown(f"ros2: not connected to the router at {self._router}. Reconnect")
        return self._graph

    @property
    def is_open(self) -> bool:
        """True if there is a session and its router is connected."""
        return self._graph is not None and self._graph.is_connected

    async def open(self, within_s: float) -> None:
        """Connect to the router. Does nothing if there is a session already. Raise ``WireDown``."""
        if self._graph is not None:
            return
        reason = "no answer"
        with trio.move_on_after(within_s):
            while True:
                try:
                    # A session that is opened only halfway could not be closed.
                    with trio.CancelScope(shield=True):
                        graph = await connect_once(self._router, self._dialect, self._on_malformed)
                except zenoh.ZError as error:
                    reason = short(error)
                    await trio.sleep(AGAIN_S)
                else:
                    self._graph = graph
                    self._declare(graph.node("", self._name))
                    return
        raise WireDown(
            f"ros2: no zenoh router at {self._router} within {within_s:g} s ({reason}). Start rmw_zenohd, or give "
            "the router as port='tcp/HOST:7447'"
        )

    async def receive(self) -> None:
        """Handle what arrives until cancelled."""
        self._receives = True
        try:
            await self.graph.run()
        finally:
            self._receives = False

    @contextlib.asynccontextmanager
    async def receiving(self) -> AsyncIterator[None]:
        """Handle what arrives while the block runs, also if no other task calls ``receive``, or if it ends."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._take_over)
            yield
            nursery.cancel_scope.cancel()

    async def _take_over(self) -> None:
        """Receive as soon as no other task does. A stop cancels the task that has received before."""
        while True:
            if self._graph is not None and not self._receives:
                await self.receive()
            await trio.sleep(LOOK_S)

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Wait until a condition is true. The caller sets the deadline."""
        while not is_so():  # noqa: ASYNC110  # the condition depends on what arrives, and on the graph
            await trio.sleep(LOOK_S)

    def close(self) -> None:
        """Close the session at once. A second call does nothing."""
        graph, self._graph = self._graph, None
        if graph is not None:
            graph.close()

    def _on_malformed(self, topic: str, reason: str) -> None:
        self.malformed += 1


def check_router(port: str) -> None:
    """Raise ``ValueError`` unless this is empty or the endpoint of a router."""
    if port and not port.startswith(ENDPOINTS):
        raise ValueError(f"port is {port!r}. Give the router of the graph, such as 'tcp/192.0.2.10:7447'")
