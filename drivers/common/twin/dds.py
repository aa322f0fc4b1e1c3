"""Simulate a robot in a DDS network: its participant, its control cycles, its state messages and its faults.

The simulated robot of each driver defines the endpoints and the work of one cycle ("tick").
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import aclosing
from typing import Annotated, Protocol

from strands_actors.contract.options import option
from strands_actors.drivers.common.rtps import CDR, PREFIX_SIZE, Participant, Writer
from strands_actors.kernel.clock import NS, MonotonicClock

from .faults import Fault, Faults, Reply, parse_fault
from .lateness import Lateness
from .options import HostOption
from .server import Frost
from .tcp import own_host
from .wirelog import WireLog


class DdsOptions(HostOption, frozen=True):
    """Options of every simulated robot on DDS."""

    domain: Annotated[int, option("DDS domain", ge=0)] = 0
    multicast: Annotated[bool, option("be found by multicast, too, as a vendor's client looks for a robot")] = False


TICK_S = 0.002


class Motors(Protocol):
    """The motors of the simulated body, by their index."""

    def set_stuck(self, index: int, on: bool) -> None: ...
    def set_off(self, index: int, off: bool) -> None: ...


class DdsServer(ABC):
    """Serve one simulated robot in a DDS network. The public methods cause events while it runs: faults, a pulled
    cable, a freeze."""

    def __init__(self, log: WireLog, options: DdsOptions, motors: Motors, slots: Sequence[int]) -> None:
        """Prepare the server. No network is opened yet.

        Args:
            slots: The number of each motor in the robot's messages. A motor can get stuck or lose its supply.
        """
        self.log = log
        self.clock = MonotonicClock()
        self.faults = Faults()
        self.address = ""
        self.participant: Participant | None = None
        self._motors = motors
        self._slots = tuple(slots)
        self._frost = Frost()
        self._last_state = b""  # last state message, which a stuck robot repeats
        self._late: deque[tuple[int, bytes]] = deque()
        self._lateness = Lateness()
        self._late_of: dict[bytes, float] = {}  # delay of a participant's messages in seconds, by its GUID prefix
        # delayed messages: the time at which each is due, and its handler
        self._waiting: deque[tuple[int, Callable[[int], None]]] = deque()
        self._domain = options.domain
        self._multicast = options.multicast
        self._host = options.host or own_host()

    @abstractmethod
    def make_endpoints(self, participant: Participant) -> None:
        """Create the robot's DDS writers and readers on a participant that was just opened."""

    @abstractmethod
    def advance(self, now_s: float) -> None:
        """Advance the robot's onboard computer and its body to this time."""

    @abstractmethod
    def send_due(self, tick: int, now_ns: int) -> None:
        """Send the messages that are due in this control cycle. Not called while the cable is unplugged."""

    @abstractmethod
    def power_cycle(self) -> None: ...

    # -- the network

    def plug(self) -> None:
        if self.participant is None:
            self.participant = Participant(self._domain, self._host, (), self._multicast, clock=self.clock)
            self.address = self.participant.address
            self.make_endpoints(self.participant)

    def unplug(self) -> None:
        """Pull the cable. The robot does not notice it and continues its last command."""
        if self.participant is not None:
            self.participant.close()
            self.participant = None

    def close(self) -> None:
        self.unplug()

    async def serve(self) -> None:
        """Run the simulated robot until cancelled."""
        async with aclosing(self.clock.ticks(TICK_S)) as ticks:
            tick = 0
            async for now_ns in ticks:
                await self._frost.thawed()
                tick += 1
                if self.participant is not None:
                    self.participant.poll()
                while self._waiting and self._waiting[0][0] <= now_ns:
                    self._waiting.popleft()[1](time.monotonic_ns())
                self.advance(now_ns / NS)
                if self.participant is not None:
                    self.send_due(tick, now_ns)

    # -- messages that are received and sent

    def receive(self, writer: bytes, t_ns: int, handle: Callable[[int], None]) -> None:
        """Handle a received message now. If its sender's process is delayed (see ``Lateness``), handle it later.

        Args:
            writer: GUID of the writer that sent the message. Its prefix identifies the participant.
            t_ns: Time at which the message was received.
            handle: Handles the message. It is called with the present time.
        """
        late_s = self._late_of.get(writer[:PREFIX_SIZE])
        if late_s is None:
            late_s = self._late_of[writer[:PREFIX_SIZE]] = self._how_late(writer[:PREFIX_SIZE])
        if late_s:
            self._waiting.append((self.clock.now_ns() + round(late_s * NS), handle))
        else:
            handle(t_ns)

    def _how_late(self, prefix: bytes) -> float:
        address = None if self.participant is None else self.participant.address_of(prefix)
        return 0.0 if address is None else self._lateness.of_address(address)

    @property
    def is_off(self) -> bool:
        """True if the robot has no power, so that it neither receives nor sends."""
        return self.faults.of(None) is Fault.OFF

    @property
    def lies(self) -> bool:
        """True if the robot reports wrong values, because the fault ``wrong`` is set."""
        return self.faults.of(None) is Fault.WRONG

    def send_state(self, writer: Writer, state: bytes, now_ns: int) -> None:
        """Send a state message. The present fault may change, delay or drop it."""
        if self.faults.of(None) is not Fault.STUCK or not self._last_state:
            self._last_state = state
        reply = self.faults.apply(Reply(0.0, self._last_state))
        if reply is not None:
            late_ns = round((reply.delay_s + reply.late_s) * NS)
            self._late.append((now_ns + late_ns, CDR + reply.data))
        while self._late and self._late[0][0] <= now_ns:
            writer.write(self._late.popleft()[1])

    def note(self, kind: str, text: str) -> None:
        """Log an action that the robot does without a command."""
        self.log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])

    # -- events that a test can cause

    def set_fault(self, text: str) -> None:
        """Set a fault: ``WORD`` (its name, such as ``stuck``) for the robot, or ``WORD:slot`` for one motor. Raise
        ``ValueError`` for any other text."""
        fault, unit = parse_fault(text)
        if unit is None:
            self.faults.set(fault)
        elif unit in self._slots and fault in (Fault.OK, Fault.STUCK, Fault.OFF):
            index = self._slots.index(unit)
            self._motors.set_stuck(index, fault is Fault.STUCK)
            self._motors.set_off(index, fault is Fault.OFF)
        else:
            raise ValueError(
                f"fault {text!r}: a motor ({self._slots[0]} to {self._slots[-1]}) can be ok, stuck or off"
            )

    def set_delay(self, lateness: Lateness) -> None:
        """Delay the messages of one client process. ``lateness`` has the process and the delay."""
        self._lateness = lateness
        self._late_of.clear()

    def freeze(self, seconds: float) -> None:
        """Stop reading and sending for ``seconds``. Then the robot handles the messages that have waited."""
        self._frost.freeze(seconds)
