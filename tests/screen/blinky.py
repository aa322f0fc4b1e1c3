"""A third party's driver that is not in our registry: a one-joint robot on a TCP line protocol, with its twin.

Requests: ``P`` asks for the position, ``G 1.5`` sets the goal, ``E`` energises, ``S`` holds, ``L`` goes limp.
The robot answers each with ``<position> <energised>``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal

import trio

from strands_actors.contract.driver import HOLDING_REASONS, Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.wire import MotorReport, Observation, Permit, StopChannel, Wire, WireDown
from strands_actors.drivers.common.ports.addresses import parse_address
from strands_actors.drivers.common.twin import Exchange, Reply, TcpServer, answering, run_server
from strands_actors.drivers.common.twin.faults import Fault, Faults
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

ANSWER_S = 0.5
LIMIT = 100.0


def fresh(candidate: Candidate, state: GateState) -> Refused | None:
    age_ms = (state.now_ns - state.observation.t_ns) / 1e6
    return Refused("stale", f"nothing was read for {age_ms:.0f} ms") if age_ms > 300 else None


class Blinky(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("blinky",)
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = "tests.screen.blinky:serve"

    axes = ("joint",)
    ids = (1,)
    unit = "degrees"
    timing = Timing(control_hz=50.0, keepalive_s=0.1)
    fallbacks: Mapping[Reason, str] = {  # never changed
        reason: "hold" if reason in HOLDING_REASONS else "limp" for reason in Reason
    }
    firmware_watchdog = "The robot holds its last goal"
    gates = (fresh,)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        self.port = port

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        value = action.get("joint")
        if set(action) != {"joint"} or isinstance(value, bool) or not isinstance(value, int | float):
            return Refused("unknown_joint", f"{', '.join(map(str, action))} is not joint", "send joint alone")
        if not math.isfinite(value) or abs(value) > LIMIT:
            return Refused("past_travel", f"joint is {value}", f"stay within {LIMIT}")
        return Candidate((float(value),), (0,))

    def open_wire(self, clock: Clock) -> Wire:
        return BlinkyWire(self.port, clock)

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        return BlinkyStopChannel(self.port, clock)


class BlinkyWire(Wire):
    def __init__(self, port: str, clock: Clock) -> None:
        self._port = port
        self._clock = clock
        self._stream: trio.SocketStream | None = None

    async def _ask(self, line: str) -> tuple[float, bool]:
        if self._stream is None:
            raise WireDown(f"{self._port}: not open")
        try:
            with trio.fail_after(ANSWER_S):
                await self._stream.send_all(f"{line}\n".encode())
                position, energised = (await self._stream.receive_some(64)).split()
        except (trio.BrokenResourceError, trio.ClosedResourceError, trio.TooSlowError, ValueError) as error:
            raise WireDown(f"{self._port}: no answer ({type(error).__name__})") from error
        return float(position), energised == b"1"

    async def open(self) -> dict[str, Any]:
        host, port = parse_address(self._port, 1)
        try:
            self._stream = await trio.open_tcp_stream(host, port)
        except OSError as error:
            raise WireDown(f"{self._port}: {error}") from error
        return {}

    async def arm(self, permit: Permit) -> Observation:
        before = await self.read()
        await self._ask(f"G {before.position[0]}")
        permit.check()
        await self._ask("E")
        return await self.read()

    async def read(self) -> Observation:
        position, _ = await self._ask("P")
        now_ns = self._clock.now_ns()
        return Observation(now_ns, (position,), (now_ns,))

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        permit.check()
        await self._ask(f"G {values[0]}")

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        try:
            _, energised = await self._ask("S" if safe_state == "hold" else "L")
        except WireDown as down:
            return (MotorReport("joint", 1, True, False, False, str(down)),)
        return (MotorReport("joint", 1, True, True, energised == (safe_state == "hold")),)

    def close(self) -> None:
        if self._stream is not None:
            self._stream.socket.close()
            self._stream = None


class BlinkyStopChannel(StopChannel):
    def __init__(self, port: str, clock: Clock) -> None:
        self._wire = BlinkyWire(port, clock)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        try:
            await self._wire.open()
        except WireDown as down:
            return (MotorReport("joint", 1, False, False, False, str(down)),)
        return await self._wire.make_safe(safe_state)

    def close(self) -> None:
        self._wire.close()


class BlinkyTwin:
    """The robot: one conversation per client, one joint for all clients."""

    KINDS: ClassVar[Mapping[str, str]] = {"P": "read", "G": "setpoint", "E": "enable", "S": "safe", "L": "safe"}

    def __init__(self) -> None:
        self.position = 0.0
        self.energised = False
        self.faults = Faults()

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        self.faults.set(fault)

    def power_cycle(self) -> None:
        self.energised = False

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        for line in data.decode().splitlines():
            verb, _, number = line.partition(" ")
            if verb == "G" and self.energised and self.faults.of(None) is not Fault.STUCK:
                self.position = float(number)
            elif verb in "ESL":
                self.energised = verb != "L"
            reply = self.faults.apply(Reply(0.0, f"{self.position} {int(self.energised)}\n".encode()))
            safe_state = {"S": "hold", "L": "limp"}.get(verb)
            yield Exchange(self.KINDS[verb], line.encode(), [reply] if reply else [], safe_state)


def serve(robot: str, **arguments: Any) -> None:
    twin = BlinkyTwin()
    run_server(lambda log: TcpServer(twin, {0: answering(lambda: twin)}, log), **arguments)
