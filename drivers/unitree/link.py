"""One DDS participant that sends commands to a Unitree robot and receives its states.

The wire process and the stop channel each have one. No call here waits: ``poll`` handles received data, and
``send`` and ``ask`` send at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.common.ports.exchange import Exchange
from strands_actors.drivers.common.ports.network_interfaces import address_of
from strands_actors.drivers.common.rtps import CDR, Participant, own_address
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from . import rpc
from .config import UnitreeConfig
from .protocol import CommandCodec, State, StateCodec, WrongChecksum

FIND_S = 4.0
"""Longest time until both sides have found each other and the first state has come."""

MAX_PENDING = 32
TICK_WRAP = 1 << 32

LOST_NS = 30 * NS
"""A service answers its requests in order [assumed]. If it answers a request that is this much later than an
unanswered order, the order was lost."""


class Service:
    """A client of one of the robot's services. It sends requests and receives the responses."""

    def __init__(self, participant: Participant, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._exchange: Exchange[int, Callable[[rpc.Response], None], rpc.Response] = Exchange(MAX_PENDING)
        self._newest = 0
        self.unanswered: set[int] = set()
        """Ids of orders that have no answer yet. The robot may still carry them out, even much later: a service
        that hangs handles its requests when it continues."""
        self.settled_ns = 0
        """Time at which the last order was answered. An earlier report may show the state before that order."""
        self._writer = participant.writer(rpc.request_topic(name), rpc.REQUEST_TYPE, reliable=True)
        self._reader = participant.reader(
            rpc.response_topic(name), rpc.RESPONSE_TYPE, self._on_response, reliable=True
        )

    @property
    def is_discovered(self) -> bool:
        """True if DDS has connected at least one direction to the service: our requests or its responses."""
        return self._writer.matched > 0 or self._reader.matched > 0

    @property
    def matched(self) -> bool:
        """True if DDS has connected both directions to the service. Before that, responses would be lost."""
        return self._writer.matched > 0 and self._reader.matched > 0

    @property
    def takes_stops(self) -> bool:
        """True if a stop may reach the service: it is connected, or was connected until it announced its end."""
        return self.matched or self._writer.has_parted

    def request_action(self, api: int) -> None:
        """Request an action of the robot. The request's id stays in ``unanswered`` until the answer arrives."""
        self.unanswered.add(self.ask(api, lambda _: None))

    def ask(
        self, api: int, on_response: Callable[[rpc.Response], None], parameter: str = "", stop: bool = False
    ) -> int:
        """Send a request and return its id, which is the present time in nanoseconds.

        The response has the same id. So its content is at least as new as this time.

        Args:
            api: The number of the request.
            on_response: Called with the response, from ``poll``, at most once.
            parameter: The parameter of the request, as JSON.
            stop: Also send the request to a service that has announced its end.
        """
        number = self._newest = max(self._clock.now_ns(), self._newest + 1)
        self._exchange.sent(number, on_response)
        write = self._writer.write_stop if stop else self._writer.write
        write(CDR + rpc.encode_request(rpc.Request(number, api, parameter)))
        return number

    def _on_response(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # Ignore an unreadable response. The gates notice if a value gets too old.
            response = rpc.decode_response(bytes(payload[4:]))
            if response.id in self.unanswered:
                self.unanswered.remove(response.id)
                self.settled_ns = t_ns
            sent = self._exchange.take(response.id, response)
            if sent is not None:
                self.unanswered = {number for number in self.unanswered if response.id - number < LOST_NS}
                sent.request(response)


class Network:
    """A DDS participant that receives the robot's LowState.

    Its constructor raises ``WireDown`` if the sockets cannot be opened.
    """

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        model, robot = config.model, config.port
        try:
            own = address_of(config.interface) if config.interface else own_address(robot.partition(":")[0])
            # On loopback no multicast is used, so that several simulated robots do not discover each other.
            # Unitree's own simulator needs multicast there, too.
            multicast = config.simulator or not own.startswith("127.")
            self.participant = Participant(config.domain, own, (robot,), multicast, clock=clock, only=robot)
        except ValueError as error:
            raise WireDown(f"{robot}: {error}") from None
        self.clock = clock
        self.model = model
        self.state: State | None = None
        self.state_ns = 0
        """Time at which the newest state with an increased tick arrived. 0 if there was no such state.

        A state with a repeated tick (from a robot that hangs) or an older tick (delayed in the network) is not new.
        So the first state alone does not count. A robot that has restarted is another participant, and its ticks
        start again.
        """
        self._ticks = None if config.simulator else Stamps(TICK_WRAP)  # A simulator may not count ticks.
        self._writer = b""  # The id of the DDS writer that sent the newest state.
        self.discarded: Counter[str] = Counter()
        """Number of discarded states since the connection was opened, by the reason to discard them."""
        self._decode = StateCodec(model, unsealed=config.simulator).decode

    def listen(self) -> None:
        """Subscribe to the robot's LowState."""
        self.participant.reader(p.STATE_TOPIC, p.state_type(self.model.family), self._on_state)

    @property
    def unusable(self) -> str:
        """Return a message that explains why no usable state (LowState) of the robot has arrived."""
        count = self.discarded.total()
        if not count:
            return "the robot sends no LowState. Check the robot and the network"
        texts = [f"{number} {reason}" for reason, number in self.discarded.items()]
        shown = f"all {next(iter(self.discarded))}" if len(texts) == 1 else ", ".join(texts)
        return (
            f"{count} LowStates have arrived, {shown}. For Unitree's own simulator, unitree_mujoco, use "
            "simulator=True. Restart a real robot that sends such states"
        )

    def poll(self) -> None:
        self.participant.poll()

    def close(self) -> None:
        self.participant.close()

    # -- states

    def _on_state(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        try:
            state = self._decode(payload[4:])
        except WrongChecksum:
            self.discarded["with a wrong checksum"] += 1
        except MalformedFrame as malformed:
            self.discarded[f"that cannot be read ({malformed})"] += 1
        else:
            self._take(state, bytes(writer), t_ns)

    def _take(self, state: State, writer: bytes, t_ns: int) -> None:
        if self._ticks is not None and writer != self._writer:
            self._ticks = Stamps(TICK_WRAP)
        self._writer, ticks = writer, self._ticks
        if ticks is not None and not ticks.take(state.tick, t_ns):
            self.discarded["with a tick that does not advance"] += 1
            return
        self.state = state
        if ticks is None or ticks.goes_on:
            self.state_ns = t_ns


class Link(Network):
    """A ``Network`` that also sends joint commands (LowCmd)."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        model = config.model
        self._codec = CommandCodec(model)
        self.commands = self.participant.writer(p.COMMAND_TOPIC, p.command_type(model.family))
        count = len(model.joints)
        self._limp = (0.0,) * (5 * count)
        self._damp = (0.0,) * (4 * count) + (model.damp_kd,) * count

    @property
    def matched(self) -> bool:
        """True if the robot receives our commands: DDS has connected our writer to its reader."""
        return self.commands.matched > 0

    def encode(self, values: tuple[float, ...]) -> bytes:
        """Return the payload of a joint command. ``values`` are q, dq, tau, kp and kd of all joints."""
        return CDR + self._codec.encode(self._machine, values)

    def send(self, payload: bytes) -> bool:
        """Send a command. Return True if it was sent to at least one reader."""
        return self.commands.write(payload) > 0

    def send_stop(self, payload: bytes) -> bool:
        """Send a command as ``send`` does, but also to a robot that has announced its end."""
        return self.commands.write_stop(payload) > 0

    def safe_frame(self, damp: bool) -> bytes:
        """Return a command without target positions. With ``damp`` the joints brake, else they have no torque."""
        return CDR + self._codec.encode(self._machine, self._damp if damp else self._limp)

    @property
    def _machine(self) -> int:
        return self.state.machine if self.state else 0
