"""A connection to robotd for intents, states and stops. robotd processes it in order, so a stop never overtakes
the intent before it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.common.ports.json_rpc_port import JsonRpcPort, SaidNo
from strands_actors.drivers.common.ports.ssh_forward import SshForward
from strands_actors.drivers.common.ports.tcp_port import OrderlyStream
from strands_actors.drivers.common.ports.unix_port import open_unix
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .config import Endpoint, MicroduckConfig

ANSWER_S = 0.2
"""Longest time for the answer to a stop."""

LOOK_HZ = 20
"""Rate of states that a stop requests, on a connection without a subscription."""


class Way:
    """The way to robotd's sockets: a local path, or our own ssh."""

    def __init__(self, config: MicroduckConfig) -> None:
        self._config = config
        self._forward: SshForward | None = None

    @property
    def endpoint(self) -> Endpoint:
        return self._config.endpoint()

    async def open(self, remote: str = "") -> OrderlyStream:
        """Connect to robotd, or to the socket ``remote`` of another daemon. Raise ``WireDown``."""
        endpoint = self.endpoint
        if not endpoint.host:
            return await open_unix(remote or endpoint.path)
        if self._forward is None:
            self._forward = SshForward(endpoint.host, endpoint.ssh_port, (endpoint.path, p.TOF_SOCKET))
        return await self._forward.open(remote or endpoint.path, self._config.timeout_s)

    def close(self) -> None:
        if self._forward is not None:
            self._forward.close()


class DuckLink:
    """The link. ``state`` is the newest state, and ``stamps`` the times at which its ``t`` changed."""

    def __init__(self, config: MicroduckConfig, clock: Clock, way: Way | None = None) -> None:
        self._config = config
        self._clock = clock
        self._way = way or Way(config)
        self._own_way = way is None
        self.port = JsonRpcPort(self._way.open, self._take)
        self._subscribed = False
        self.state: p.State | None = None
        self.told: Mapping[str, Any] = {}  # the newest state as received
        self.stamps = Stamps()
        self.states = 0
        self.problem = "it has told nothing yet"

    @property
    def is_open(self) -> bool:
        return self.port.is_open

    async def connect(self) -> None:
        """Connect, unless it is connected, and send nothing. Raise ``WireDown``, as all methods here do."""
        if not self.port.is_open:
            self._subscribed = False
            self.stamps.connected()
            await self.port.open()

    async def greet(self, within_s: float) -> p.Hello:
        return p.read_hello(await self.ask(p.HELLO, {"api_version": self._config.api_version}, within_s))

    async def subscribe(self, hz: int | None, within_s: float) -> tuple[str, ...]:
        """Subscribe to states. Return the robot's skills."""
        answer = await self.ask(p.SUBSCRIBE, {} if hz is None else {"hz": hz}, within_s)
        self._subscribed = True
        return p.read_skills(answer)

    async def ask(self, method: str, params: Mapping[str, Any], within_s: float) -> Any:
        """Send a request and return its answer. Raise ``WireDown`` for an error, too."""
        try:
            return await self.port.ask(method, params, within_s)
        except SaidNo as no:
            raise WireDown(f"{method}: robotd says {no} ({no.code}). Look at its log") from None

    async def hear(self) -> None:
        """Receive states until the connection is lost."""
        await self.port.hear()

    async def next_state(self) -> p.State:
        """Wait for the next state, after subscribing if that was not done."""
        if not self._subscribed:
            self.port.forget(self.port.send(p.SUBSCRIBE, {"hz": LOOK_HZ}))
            self._subscribed = True
        seen = self.states
        await self.port.until(lambda: self.states > seen)
        assert self.state is not None
        return self.state

    async def until_state(self, is_so: Callable[[p.State], bool]) -> None:
        await self.port.until(lambda: self.state is not None and is_so(self.state))

    async def until_it_goes_on(self) -> None:
        """Wait for two states with different stamps. A single one may be the last of a stuck loop."""
        await self.port.until(lambda: self.stamps.goes_on)

    def close(self) -> None:
        """Close the connection at once. It may be called again."""
        self.port.close()
        if self._own_way:
            self._way.close()

    def _take(self, call: Call) -> None:
        if call.method != p.STATE:
            return
        try:
            state = p.read_state(call.params)
        except MalformedFrame as malformed:
            self.problem = str(malformed)  # ``read`` reports it if it lasts.
            return
        self.stamps.take(state.t_s, self._clock.now_ns())
        self.state, self.told = state, call.params
        self.states += 1


def report_of(state: p.State) -> Report:
    """Return the report of the base as a whole."""
    moving = state.applied if any(state.applied) else state.requested
    return Report(round(state.t_s * NS), state.stands, ", ".join(f"{value:.3g}" for value in moving))
