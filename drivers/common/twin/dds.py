"""The robot's end of a DDS network: its participant, the ticks of its computer, what it says of its
state, and what may happen to all of that.

A wire's twin says which endpoints there are, and what a tick does.
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
    """Of every such twin."""

    domain: Annotated[int, option("DDS domain", ge=0)] = 0
    multicast: Annotated[bool, option("be found by multicast, too, as a vendor's client looks for a robot")] = False


TICK_S = 0.002


class Motors(Protocol):
    """The body, by motor."""

    def set_stuck(self, index: int, on: bool) -> None: ...
    def set_off(self, index: int, off: bool) -> None: ...


class DdsServer(ABC):
    """Serves one robot. Its methods are what may happen to it while it runs."""

    def __init__(self, log: WireLog, options: DdsOptions, motors: Motors, slots: Sequence[int]) -> None:
        """``slots``: the number of each motor, which can get stuck or lose its supply."""
        self.log = log
        self.clock = MonotonicClock()
        self.faults = Faults()
        self.address = ""
        self.participant: Participant | None = None
        self._motors = motors
        self._slots = tuple(slots)
        self._frost = Frost()
        self._held = b""  # the state that a stuck robot repeats
        self._late: deque[tuple[int, bytes]] = deque()
        self._lateness = Lateness()
        self._late_of: dict[bytes, float] = {}  # of each participant, by its prefix
        self._waiting: deque[tuple[int, Callable[[int], None]]] = deque()  # when what is taken up
        self._domain = options.domain
        self._multicast = options.multicast
        self._host = options.host or own_host()

    @abstractmethod
    def make_endpoints(self, participant: Participant) -> None:
        """Make writers and readers on a participant that has just been opened."""

    @abstractmethod
    def advance(self, now_s: float) -> None:
        """Let the robot's computer and body go on to this time."""

    @abstractmethod
    def say(self, tick: int, now_ns: int) -> None:
        """Tell what is due at this tick. Not called without a cable."""

    @abstractmethod
    def power_cycle(self) -> None: ...

    # -- the network

    def plug(self) -> None:
        if self.participant is None:
            self.participant = Participant(self._domain, self._host, (), self._multicast, clock=self.clock)
            self.address = self.participant.address
            self.make_endpoints(self.participant)

    def unplug(self) -> None:
        """Pull the cable. The robot itself does not notice, and goes on with its last command."""
        if self.participant is not None:
            self.participant.close()
            self.participant = None

    def close(self) -> None:
        self.unplug()

    async def serve(self) -> None:
        """Until cancelled."""
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
                    self.say(tick, now_ns)

    # -- what it hears and says

    def take(self, writer: bytes, t_ns: int, take_up: Callable[[int], None]) -> None:
        """Take up what a writer has said: now, or later when its process is late. ``take_up`` is
        given the time."""
        late_s = self._late_of.get(writer[:PREFIX_SIZE])
        if late_s is None:
            late_s = self._late_of[writer[:PREFIX_SIZE]] = self._how_late(writer[:PREFIX_SIZE])
        if late_s:
            self._waiting.append((self.clock.now_ns() + round(late_s * NS), take_up))
        else:
            take_up(t_ns)

    def _how_late(self, prefix: bytes) -> float:
        address = None if self.participant is None else self.participant.address_of(prefix)
        return 0.0 if address is None else self._lateness.of_address(address)

    @property
    def is_off(self) -> bool:
        """Return whether it neither hears nor says anything."""
        return self.faults.of(None) is Fault.OFF

    @property
    def lies(self) -> bool:
        """Return whether what it says of its state is wrong."""
        return self.faults.of(None) is Fault.WRONG

    def say_state(self, writer: Writer, state: bytes, now_ns: int) -> None:
        """Send a state, as the present fault lets it."""
        if self.faults.of(None) is not Fault.STUCK or not self._held:
            self._held = state
        reply = self.faults.apply(Reply(0.0, self._held))
        if reply is not None:
            late_ns = round((reply.delay_s + reply.late_s) * NS)
            self._late.append((now_ns + late_ns, CDR + reply.data))
        while self._late and self._late[0][0] <= now_ns:
            writer.write(self._late.popleft()[1])

    def note(self, kind: str, text: str) -> None:
        """What the robot does by itself, for the log."""
        self.log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])

    # -- what may happen to it

    def set_fault(self, text: str) -> None:
        """``WORD`` or ``WORD:slot``. Raise ``ValueError`` for another word."""
        fault, unit = parse_fault(text)
        if unit is None:
            self.faults.set(fault)
        elif unit in self._slots and fault in (Fault.OK, Fault.STUCK, Fault.OFF):
            at = self._slots.index(unit)
            self._motors.set_stuck(at, fault is Fault.STUCK)
            self._motors.set_off(at, fault is Fault.OFF)
        else:
            raise ValueError(
                f"a motor, {self._slots[0]} to {self._slots[-1]}, can be ok, stuck or off, not {fault}"
            )

    def be_late(self, lateness: Lateness) -> None:
        """Take up later what one process says."""
        self._lateness = lateness
        self._late_of.clear()

    def freeze(self, seconds: float) -> None:
        """The robot neither reads nor says anything for so long; then it takes up what waited."""
        self._frost.freeze(seconds)
