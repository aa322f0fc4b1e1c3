"""One participant on a Unitree robot's network: commands out, states in. Wire and stop channel are
made of it.

Nothing here waits or loops: ``poll`` takes in what has arrived, ``send`` and ``ask`` leave at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.network_interfaces import address_of
from strands_actors.drivers.common.rtps import CDR, Participant, own_address
from strands_actors.drivers.common.stamps import Stamps
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from . import rpc
from .config import UnitreeConfig
from .protocol import CommandCodec, State, StateCodec, WrongChecksum

FIND_S = 4.0
"""For both sides to find each other, and the first state."""

MAX_PENDING = 32
TICK_WRAP = 1 << 32

LOST_NS = 30 * NS
"""A service answers in the order in which it is asked [assumed]: one that answers what was asked so
long after an order has never got that order."""


class Service:
    """A client of one of the robot's services."""

    def __init__(self, participant: Participant, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._pending: dict[int, Callable[[rpc.Response], None]] = {}
        self._newest = 0
        self.owed: set[int] = set()
        """Ids of orders that have not been answered. A request is delivered however long that takes:
        a service that hung carries it out when it goes on."""
        self.settled_ns = 0
        """When the last of them was answered: what was said before that is of before it, too."""
        self._writer = participant.writer(rpc.request_topic(name), rpc.REQUEST_TYPE, reliable=True)
        self._reader = participant.reader(
            rpc.response_topic(name), rpc.RESPONSE_TYPE, self._on_response, reliable=True
        )

    @property
    def found(self) -> bool:
        """Whether anybody there serves it."""
        return self._writer.matched > 0 or self._reader.matched > 0

    @property
    def matched(self) -> bool:
        """Both ways: a response to a reader that is not known yet would be lost."""
        return self._writer.matched > 0 and self._reader.matched > 0

    @property
    def takes_stops(self) -> bool:
        """Whether a stop may reach it: it knows us, or did until it said that it has gone."""
        return self.matched or self._writer.has_parted

    def order(self, api: int) -> None:
        """Ask for what the robot then does; ``owed`` until it has answered."""
        self.owed.add(self.ask(api, lambda _: None))

    def ask(
        self, api: int, on_response: Callable[[rpc.Response], None], parameter: str = "", stop: bool = False
    ) -> int:
        """``on_response`` is called from ``poll``, once or never. The id of request and response is
        when it was asked, in nanoseconds: what is answered was so then, or later. Return it.
        ``stop``: ask a robot that says that it has gone, too."""
        number = self._newest = max(self._clock.now_ns(), self._newest + 1)
        if len(self._pending) >= MAX_PENDING:
            del self._pending[next(iter(self._pending))]
        self._pending[number] = on_response
        write = self._writer.write_stop if stop else self._writer.write
        write(CDR + rpc.encode_request(rpc.Request(number, api, parameter)))
        return number

    def _on_response(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # an answer that cannot be read is none: what waits for it grows old
            response = rpc.decode_response(bytes(payload[4:]))
            if response.id in self.owed:
                self.owed.remove(response.id)
                self.settled_ns = t_ns
            heard = self._pending.pop(response.id, None)
            if heard is not None:
                self.owed = {number for number in self.owed if response.id - number < LOST_NS}
                heard(response)


class Network:
    """Our participant, and the robot's LowState. Raise ``WireDown`` when the sockets cannot be had."""

    def __init__(self, config: UnitreeConfig, clock: Clock) -> None:
        model, robot = config.model, config.port
        try:
            own = address_of(config.interface) if config.interface else own_address(robot.partition(":")[0])
            # Twins on one host leave each other in peace; a simulator there is found by its group alone.
            multicast = config.simulator or not own.startswith("127.")
            self.participant = Participant(config.domain, own, (robot,), multicast, clock=clock, only=robot)
        except ValueError as error:
            raise WireDown(f"{robot}: {error}") from None
        self.clock = clock
        self.model = model
        self.state: State | None = None
        self.state_ns = 0
        """When the newest came whose tick had gone on; 0: none yet. One that repeats its tick, from a
        loop that is stuck, tells nothing new, and the first may be one of these. Nor does one whose tick
        is older, which a network or a proxy has kept. A robot that has restarted is another participant,
        and counts anew."""
        self._ticks = None if config.simulator else Stamps(TICK_WRAP)  # a simulator need not count any
        self._writer = b""  # of the newest state
        self.discarded: Counter[str] = Counter()
        """States that were not taken, by why not, since the link was opened."""
        self._decode = StateCodec(model, unsealed=config.simulator).decode

    def listen(self) -> None:
        """To the robot's state, from now on."""
        self.participant.reader(p.STATE_TOPIC, p.state_type(self.model.family), self._on_state)

    @property
    def unusable(self) -> str:
        """Why there is no state, in words."""
        count = self.discarded.total()
        if not count:
            return "no LowState comes"
        whys = [f"{number} {why}" for why, number in self.discarded.items()]
        what = f"all {next(iter(self.discarded))}" if len(whys) == 1 else ", ".join(whys)
        return (
            f"{count} LowStates come, {what}: a simulator? For Unitree's own, unitree_mujoco, say simulator=True. "
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
    """The joints commanded one by one, too."""

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
        """Whether the robot takes our commands."""
        return self.commands.matched > 0

    def encode(self, values: tuple[float, ...]) -> bytes:
        """A target, five rows, as a payload."""
        return CDR + self._codec.encode(self._machine, values)

    def send(self, payload: bytes) -> bool:
        """Whether it left, and for the robot."""
        return self.commands.write(payload) > 0

    def send_stop(self, payload: bytes) -> bool:
        """As ``send``, to a robot that says that it has gone, too."""
        return self.commands.write_stop(payload) > 0

    def safe_frame(self, damp: bool) -> bytes:
        """No joint is pulled anywhere: braked, or not even that."""
        return CDR + self._codec.encode(self._machine, self._damp if damp else self._limp)

    @property
    def _machine(self) -> int:
        return self.state.machine if self.state else 0
