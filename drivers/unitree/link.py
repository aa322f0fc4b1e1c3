"""One participant on a Unitree robot's network. It sends commands and receives states. The wire and the stop
channel both use it.

No call here waits or loops: ``poll`` handles received data, ``send`` and ``ask`` send at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.stamps import Stamps
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
"""A service answers requests in order [assumed]. If it answers a request that was made so long after an
unanswered order, that order was lost."""


class Service:
    """A client of one of the robot's services."""

    def __init__(self, participant: Participant, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._pending: dict[int, Callable[[rpc.Response], None]] = {}
        self._newest = 0
        self.owed: set[int] = set()
        """Ids of orders without an answer. The request is delivered however late: a service that hung
        carries it out when it goes on."""
        self.settled_ns = 0
        """When the last order was answered. Reports from before then may be from before the order."""
        self._writer = participant.writer(rpc.request_topic(name), rpc.REQUEST_TYPE, reliable=True)
        self._reader = participant.reader(
            rpc.response_topic(name), rpc.RESPONSE_TYPE, self._on_response, reliable=True
        )

    @property
    def found(self) -> bool:
        """Return True if a server is matched in at least one direction."""
        return self._writer.matched > 0 or self._reader.matched > 0

    @property
    def matched(self) -> bool:
        """Return True if both directions match. A response to an unknown reader would be lost."""
        return self._writer.matched > 0 and self._reader.matched > 0

    @property
    def takes_stops(self) -> bool:
        """Return True if a stop may reach the service. It knows us, or knew us until it announced its end."""
        return self.matched or self._writer.has_parted

    def order(self, api: int) -> None:
        """Request an action of the robot. It stays in ``owed`` until it is answered."""
        self.owed.add(self.ask(api, lambda _: None))

    def ask(
        self, api: int, on_response: Callable[[rpc.Response], None], parameter: str = "", stop: bool = False
    ) -> int:
        """Send a request and return its id, the present time in nanoseconds.

        The answer has the same id. It describes the robot at that time or later.

        Args:
            api: The request's number.
            on_response: Called from ``poll``, at most once.
            parameter: The request's JSON.
            stop: Send it also to a service that has announced its end.
        """
        number = self._newest = max(self._clock.now_ns(), self._newest + 1)
        if len(self._pending) >= MAX_PENDING:
            del self._pending[next(iter(self._pending))]
        self._pending[number] = on_response
        write = self._writer.write_stop if stop else self._writer.write
        write(CDR + rpc.encode_request(rpc.Request(number, api, parameter)))
        return number

    def _on_response(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # skip an unreadable answer, so that the awaited value grows old
            response = rpc.decode_response(bytes(payload[4:]))
            if response.id in self.owed:
                self.owed.remove(response.id)
                self.settled_ns = t_ns
            on_response = self._pending.pop(response.id, None)
            if on_response is not None:
                self.owed = {number for number in self.owed if response.id - number < LOST_NS}
                on_response(response)


class Network:
    """Our participant, and the robot's LowState. Making it raises ``WireDown`` if the sockets cannot be
    opened."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        model, robot = config.model, config.port
        try:
            own = address_of(config.interface) if config.interface else own_address(robot.partition(":")[0])
            # On loopback, twins do not discover each other. A simulator there is found by multicast only.
            multicast = config.simulator or not own.startswith("127.")
            self.participant = Participant(config.domain, own, (robot,), multicast, clock=clock, only=robot)
        except ValueError as error:
            raise WireDown(f"{robot}: {error}") from None
        self.clock = clock
        self.model = model
        self.state: State | None = None
        self.state_ns = 0
        """When the newest state with an increased tick arrived; 0 if there is no such state.

        A repeated tick, from a loop that is stuck, brings nothing new, and the first state may be one.
        An older tick, delayed by a network or a proxy, brings nothing new either. A robot that has
        restarted is another participant, and its ticks start anew.
        """
        self._ticks = None if config.simulator else Stamps(TICK_WRAP)  # a simulator need not count ticks
        self._writer = b""  # of the newest state
        self.discarded: Counter[str] = Counter()
        """States that were discarded since the link was opened, by reason."""
        self._decode = StateCodec(model, unsealed=config.simulator).decode

    def listen(self) -> None:
        """Subscribe to the robot's state."""
        self.participant.reader(p.STATE_TOPIC, p.state_type(self.model.family), self._on_state)

    @property
    def unusable(self) -> str:
        """Return in words why there is no state."""
        count = self.discarded.total()
        if not count:
            return "no LowState comes"
        whys = [f"{number} {why}" for why, number in self.discarded.items()]
        shown = f"all {next(iter(self.discarded))}" if len(whys) == 1 else ", ".join(whys)
        return (
            f"{count} LowStates come, {shown}: a simulator? For Unitree's own, unitree_mujoco, say simulator=True. "
            "A robot that goes on so has to be restarted"
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
            self.discarded["whose tick does not go on"] += 1
            return
        self.state = state
        if ticks is None or ticks.goes_on:
            self.state_ns = t_ns


class Link(Network):
    """A ``Network`` that also commands the joints."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        model = config.model
        self._codec = CommandCodec(model)
        self.commands = self.participant.writer(p.COMMAND_TOPIC, p.command_type(model.family))
        count = len(model.joints)
        self._limp = (0.0,) * (5 * count)
        self._damp = (0.0,) * (4 * count) + (model.damp_kd,) * count

    @property
    def heard(self) -> bool:
        """Return True if the robot has matched our command writer."""
        return self.commands.matched > 0

    def encode(self, values: tuple[float, ...]) -> bytes:
        """Return the payload of a target of five rows."""
        return CDR + self._codec.encode(self._machine, values)

    def send(self, payload: bytes) -> bool:
        """Send a payload. Return True if it left for the robot."""
        return self.commands.write(payload) > 0

    def send_stop(self, payload: bytes) -> bool:
        """As ``send``, also to a robot that has announced its end."""
        return self.commands.write_stop(payload) > 0

    def safe_frame(self, damp: bool) -> bytes:
        """Return a frame that pulls no joint to a position: with ``damp`` the joints brake, else they are
        free."""
        return CDR + self._codec.encode(self._machine, self._damp if damp else self._limp)

    @property
    def _machine(self) -> int:
        return self.state.machine if self.state else 0
