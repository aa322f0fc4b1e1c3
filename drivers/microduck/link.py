"""One connection to robotd for intents, states and stops. robotd processes a connection in order, so a stop
never overtakes an earlier intent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.common.ports.json_rpc_port import JsonRpcPort, RequestFailed
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


class Connector:
    """Open connections to robotd's sockets, by a local path or through an ssh process of ours."""

    def __init__(self, config: MicroduckConfig) -> None:
        self._config = config
        self._forward: SshForward | None = None

    @property
    def endpoint(self) -> Endpoint:
        return self._config.endpoint()

    async def open(self, remote: str = "") -> OrderlyStream:
        """Connect to robotd, or to the socket of another daemon if ``remote`` names one. Raise ``WireDown``."""
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
    """The connection to robotd. ``state`` is the newest state. ``stamps`` records when the time in the states
    (``t``) last changed."""

    def __init__(self, config: MicroduckConfig, clock: Clock, connector: Connector | None = None) -> None:
        self._config = config
        self._clock = clock
        self._connector = connector or Connector(config)
        self._owns_connector = connector is None
        self.port = JsonRpcPort(self._connector.open, self._take)
        self._subscribed = False
        self.state: p.State | None = None
        self.raw_state: Mapping[str, Any] = {}  # the newest state, as received JSON
        self.stamps = Stamps()
        self.states = 0
        self.problem = "no state has arrived yet"

    @property
    def is_open(self) -> bool:
        return self.port.is_open

    async def connect(self) -> None:
        """Connect if there is no connection. Nothing is sent. Raise ``WireDown``, as all methods here do."""
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
        """Send a request and return its answer. An error in the answer raises ``WireDown``, too."""
        try:
            return await self.port.ask(method, params, within_s)
        except RequestFailed as no:
            raise WireDown(f"{method}: robotd answered with an error: {no} ({no.code}). Check its log") from None

    async def hear(self) -> None:
        """Receive states until the connection is lost."""
        await self.port.hear()

    async def next_state(self) -> p.State:
        """Wait for the next state. Subscribe first if that was not done."""
        if not self._subscribed:
            self.port.forget(self.port.send(p.SUBSCRIBE, {"hz": LOOK_HZ}))
            self._subscribed = True
        states_before = self.states
        await self.port.until(lambda: self.states > states_before)
        assert self.state is not None
        return self.state

    async def until_state(self, is_so: Callable[[p.State], bool]) -> None:
        await self.port.until(lambda: self.state is not None and is_so(self.state))

    async def until_it_goes_on(self) -> None:
        """Wait for two states with different times. A single state may be the last one of a robotd that hangs."""
        await self.port.until(lambda: self.stamps.goes_on)

    def close(self) -> None:
        """Close the connection at once. A second call does nothing."""
        self.port.close()
        if self._owns_connector:
            self._connector.close()

    def _take(self, call: Call) -> None:
        if call.method != p.STATE:
            return
        try:
            state = p.read_state(call.params)
        except MalformedFrame as malformed:
            # A single unreadable state is ignored. ``read`` reports the problem if it persists.
            self.problem = str(malformed)
            return
        self.stamps.take(state.t_s, self._clock.now_ns())
        self.state, self.raw_state = state, call.params
        self.states += 1


def report_of(state: p.State) -> Report:
    """Summarise a state as one report for the whole base: its time, whether the duck stands, and its motion."""
    moving = state.requested if any(state.requested) else state.applied
    return Report(round(state.t_s * NS), state.stands, ", ".join(f"{value:.3g}" for value in moving))
