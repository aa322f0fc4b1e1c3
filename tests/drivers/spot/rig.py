"""The twin's services behind streams in memory, for the wire in virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import trio

from strands_actors.contract.driver import Candidate, GateState, Live
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.grpc_messages import MAX_MESSAGE
from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.spot.driver import Spot
from strands_actors.drivers.spot.messages import decode
from strands_actors.drivers.spot.protocol import ESTOP_ROLE, METHODS, Motors, challenge_response, duration
from strands_actors.drivers.spot.stop_channel import EstopChannel
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.login import LoginClient
from strands_actors.drivers.spot.wire import SpotWire
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
PORT = "192.0.2.1?ca=/no/such/file"
KEYS = 10
HASTE = 5.0


class Taken(NamedTuple):
    """One request that the robot took."""

    t_s: float
    name: str
    kind: str
    safe_state: str | None
    body: Mapping[str, Any]


class Go(Permit):
    """A permit that denies after this number of checks."""

    def __init__(self, checks: int = 10**9) -> None:
        self._left = checks

    def check(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise PermitDenied("a stop is waiting")


class World:
    """One robot. ``options`` are those of its twin, ``driver`` those of the driver.

    The robot powers on and stands up in 0.4 s each, because no test of the wire alone feeds the e-stop meanwhile.
    """

    def __init__(self, driver: dict[str, Any] | None = None, **options: Any) -> None:
        self.twin = LoggedTwin(self, **options)
        self.taken: list[Taken] = []
        self.streams: list[MemoryStream] = []
        self.frozen = False  # True: it reads and sends nothing
        self.gone = False
        self.connect_s = 0.001
        self.driver = Spot("spot", PORT, Spot.resolve("spot", driver or {}))

    def wire(self) -> SpotWire:
        return SpotWire(self.driver.config, VirtualClock(), self.open_stream)

    def stop_channel(self) -> EstopChannel:
        return EstopChannel(self.driver.config, (), VirtualClock(), self.open_stream)

    async def open_stream(self, authority: str, /) -> MemoryStream:
        await trio.sleep(self.connect_s)
        if self.gone:
            raise WireDown("192.0.2.1:443: cannot connect")
        self.streams.append(MemoryStream(self, authority))
        return self.streams[-1]

    def thaw(self) -> None:
        """Let the robot read the waiting bytes, those of each connection in order."""
        self.frozen = False
        for stream in self.streams:
            stream.take_waiting()

    def names(self, kind: str = "") -> list[str]:
        return [one.name for one in self.taken if kind in ("", one.kind)]

    def of(self, name: str) -> list[Taken]:
        return [one for one in self.taken if one.name == name]

    def safe(self) -> list[str]:
        """Return the safe state of each safe frame."""
        return [one.safe_state or "" for one in self.taken if one.kind == "safe"]


class LoggedTwin(SpotTwin):
    def __init__(self, world: World, **options: Any) -> None:
        options.setdefault("haste", HASTE)
        super().__init__(
            "spot", trio.current_time, wall_ns=lambda: round((1.7e9 + trio.current_time()) * 1e9), **options
        )
        self._world = world


class _Client(Connection):
    """A client as the twin's services see it, with the messages to it and notes about it."""

    def __init__(self, stream: MemoryStream) -> None:
        self._stream = stream
        self.log = self  # type: ignore[assignment]
        self.asked = ""

    def send(self, data: bytes) -> None:
        self._stream.received += data
        self._stream.news.set()

    def abort(self) -> None:
        self._stream.close()

    def write(self, t_ns: int, source: str, frames: Any, safe_state: str | None = None) -> None:
        for kind, data in frames:
            body = decode(METHODS[self.asked].request, data)
            self._stream.world.taken.append(Taken(trio.current_time(), self.asked, kind, safe_state, body))


class _Service:
    """The twin, with the method of each message."""

    def __init__(self, twin: SpotTwin, client: _Client) -> None:
        self._twin = twin
        self._client = client
        self.faults = twin.faults

    def called(self, call: ServerCall) -> bool:
        return self._twin.called(call)

    def message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        self._client.asked = call.path.rpartition("/")[2]
        self._twin.message(call, t_ns, message)

    def over(self, call: ServerCall) -> None:
        self._twin.over(call)


class MemoryStream:
    def __init__(self, world: World, authority: str) -> None:
        self.world = world
        self.authority = authority
        self.received = b""
        self.news = trio.Event()
        self._waiting: list[bytes] = []
        self._open = True
        connection = _Client(self)
        self._client = LoginClient(_Service(world.twin, connection), connection, world.twin.logins, MAX_MESSAGE)
        self._client.flush()

    def write(self, data: bytes) -> None:
        self._check()
        self._waiting.append(data)
        if not self.world.frozen:
            self.take_waiting()

    def take_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for data in waiting:
            self._client.take(round(trio.current_time() * 1e9), data)
            self._client.flush()

    async def read(self) -> bytes:
        while True:
            self._check()
            await trio.sleep(0.001)
            data = self.read_waiting()
            if data is not None:
                return data
            with trio.move_on_after(0.005):
                await self.news.wait()

    def read_waiting(self) -> bytes | None:
        self._check()
        if self.world.frozen or not self.received:
            return None
        reported, self.received, self.news = self.received, b"", trio.Event()
        return reported

    def close(self) -> None:
        self._open = False

    @property
    def is_open(self) -> bool:
        return self._open

    def close_in_order(self) -> None:
        self.close()

    def _check(self) -> None:
        if not self._open or self.world.gone:
            raise WireDown("192.0.2.1:443: the connection is closed")


async def ready(world: World, stands: bool = True) -> SpotWire:
    """Return an armed wire with a standing robot."""
    wire = world.wire()
    await wire.open()
    await wire.read()
    await wire.arm(Go())
    if stands:
        answer = await wire.perform("stand", {}, Go())
        assert answer == {"standing": True}, answer
    return wire


def let_a_tablet_drive(world: World) -> None:
    """Give e-stop and lease to another client, and switch the motors on."""
    let_a_tablet_have_the_e_stop(world)
    world.twin.leases.acquire("tablet-7", take=True)
    world.twin.mechanism.motors = Motors.ON


def let_a_tablet_have_the_e_stop(world: World) -> None:
    """Let another client set up the e-stop and allow power."""
    estop = world.twin.estop
    estop.set_config(
        {"endpoints": [{"role": ESTOP_ROLE, "name": "tablet-7", "timeout": duration(3600.0)}]},
        estop.config.get("unique_id", ""),
        False,
    )
    (endpoint,) = estop.config["endpoints"]
    estop.register(endpoint, estop.config["unique_id"])
    first = estop.check_in({"endpoint": endpoint})["challenge"]
    estop.check_in(
        {"endpoint": endpoint, "challenge": first, "response": challenge_response(first), "stop_level": 4}
    )


# -- helpers for gates


def observed(position: tuple[float, ...] = (0.0,) * KEYS, **sensors: float) -> Observation:
    known = {"motors": 2.0, "estopped": 0.0, **sensors}
    stamps = tuple(NOW_NS if value == value else 0 for value in position)
    return Observation(NOW_NS, position, stamps, sensors={key: (value,) for key, value in known.items()})


def state(seen: Observation | None = None, live: Live | None = None, stream: bool = False) -> GateState:
    seen = seen or observed()
    target = tuple(value if value == value else 0.0 for value in seen.position)
    return GateState(NOW_NS, seen, target, NOW_NS - 10**8, stream, 0.1 if stream else 0.0, live)


def answer(action: dict[str, Any], at: GateState | None = None, by: Spot | None = None) -> Candidate | Refused:
    """Judge an action as the gate does, by a driver with its own gates or by ``by``."""
    driver, at = by or Spot("spot", "", Spot.resolve("spot", {})), at or state()
    for condition in driver.conditions:
        refusal = condition.check(at.observation, at.now_ns)
        if refusal is not None:
            return refusal
    candidate = driver.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in driver.gates:
            if (refusal := gate(candidate, at)) is not None:
                return refusal
    return candidate


def accepted(action: dict[str, Any], at: GateState | None = None) -> Candidate:
    found = answer(action, at)
    assert isinstance(found, Candidate), found
    return found


def refused(action: dict[str, Any], at: GateState | None = None) -> Refused:
    found = answer(action, at)
    assert isinstance(found, Refused), found
    return found


def target(world: World, seen: Observation, **action: float) -> tuple[float, ...]:
    """Return the target of an action."""
    now_ns = seen.t_ns
    at = GateState(now_ns, seen, tuple(0.0 if value != value else value for value in seen.position), now_ns, False)
    candidate = world.driver.parse(action, at)
    assert isinstance(candidate, Candidate), candidate
    return candidate.values


def velocity(taken: Taken) -> dict[str, Any]:
    requested: dict[str, Any] = taken.body["command"]["synchronized_command"]["mobility_command"][
        "se2_velocity_request"
    ]
    return requested


def confirmed(reports: tuple[MotorReport, ...]) -> bool:
    assert len(reports) == 10
    return all(report.safe for report in reports)


async def pass_time(world: World, seconds: float, *wires: SpotWire) -> None:
    """Let time pass as a tree does: feed and read, ten times a second."""
    for _ in range(round(seconds * 10)):
        for wire in wires:
            await wire.feed()
            await wire.read()
        world.twin.pass_time()
        await trio.sleep(0.1)
