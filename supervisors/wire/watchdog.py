"""The watchdog owns time: it re-sends, expires and beats, each only when earned.

Every tick it probes the gate; the gate looks at its deadlines and answers. Every cycle it asks the
transport to read, and to re-send the last setpoint when one is due, *only if* in this period the
writer (its lifetime and lease stand, says the gate), the gate (it answered) and the transport (it
answered the last cycle) are all alive. A frozen link in that chain therefore stops the keepalive by
itself.

To the root it beats on the same condition, without the writer: a wire process whose gate or
transport does not answer is fenced from outside, whatever it believes of itself.

A stream of setpoints that is as quick as its ticks brings them along (``Ticker``): with each that
it accepts the gate looks at its deadlines and says so, as if it had been probed. When none comes
the watchdog ticks by itself again.

It reads no clock: what it does follows from its memory, the message, and when that was taken up.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from strands_actors.contract.driver import Reason, Timing
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.failure_detector import FailureDetector, Heard
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.health.processor import Standing
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import BROUGHT, Probe, Stop, StopReport
from strands_actors.supervisors.wire.messages import Alive, Cycle, Cycled, RootGone

ASKS = 2


class Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Leave(Message, frozen=True):
    """The watchdog to itself: nobody is left who could fence us. Make safe, then end."""

    lane = "urgent"

    why: str


class WatchdogMemory(msgspec.Struct, frozen=True):
    """All that a watchdog's decisions depend on, beside the message and when it was taken up."""

    probe: int
    cycle: int
    cycle_at_ns: int
    ticked_ns: int
    gate_answered: int
    transport_answered: int
    gate_heard_ns: int
    transport_heard_ns: int
    busy_until_ns: int
    alive: Alive
    root: Heard
    root_lost: bool


class Watchdog(Actor):
    """``orphaned`` is called when the root is gone and the wire has been made safe; with whether it
    has. ``heartbeat``: shared with the root. ``root`` tells how its process stands with the
    processor. ``missed`` is called at a tick before which the root has said nothing new: who sees that
    it dies tells ``RootGone``, before the system tells of its end."""

    def __init__(
        self,
        timing: Timing,
        gate: str,
        transport: str,
        orphaned: Callable[[bool], None],
        heartbeat: Heartbeat,
        root: Callable[[], Standing | None] = lambda: None,
        missed: Callable[[], None] = lambda: None,
        late_s: float = 0.0,
    ) -> None:
        self._addresses = gate, transport
        self._heartbeat = heartbeat
        self._tick_s = timing.tick_s
        self._leave_s = StopDeadlines.of(timing.safe_s, late_s).gate_s
        self._tick_ns = round(timing.tick_s * NS)
        self._heartbeat_ttl_ns = round(timing.heartbeat_ttl_s * NS)
        self._cycle_ns = round(NS / timing.control_hz)
        self._orphaned = orphaned
        self._probe = 0
        self._cycle = 0
        self._cycle_at_ns = 0
        self._ticked_ns = 0
        self._gate_answered = 0
        self._transport_answered = 0
        self._answers_ns = [0, 0]  # when gate and transport were last heard
        self._busy_until_ns = 0
        self._alive = Alive(0, 0, False)
        self._root_stands = root
        self._missed = missed
        self._root = FailureDetector(timing.heartbeat_ttl_s, timing.tick_s, self._look_at_root)
        self._root_lost = False

    async def started(self) -> None:
        gate, transport = self._addresses
        self._gate: Ref = self.context.ref(gate)
        self._transport: Ref = self.context.ref(transport)
        self._answers_ns = [self.context.received_ns] * 2
        self._ticker = self.context.every(self._tick_s, Tick)

    def receive(self, message: Tick | Alive | Cycled | RootGone | Leave | StopReport) -> None:
        match message:
            case Tick():
                self._tick(message.now_ns)
            case Alive():
                self._gate_alive(message)
            case Cycled():
                self._transport_answered = max(self._transport_answered, message.number)
                self._busy_until_ns = message.busy_until_ns
                self._answers_ns[1] = self.context.received_ns
            case RootGone():
                self._lose_root("the root process ended")
            case Leave():
                self.context.start_soon(self._leave, message.why)
            case StopReport():
                pass

    def _look_at_root(self) -> Standing | None:
        seen = self._root_stands()
        self.context.saw(seen)
        return seen

    def _tick(self, now_ns: int) -> None:
        self._probe += 1
        self._gate.tell(Probe(self._probe, now_ns))
        self._listen_to_root(now_ns)

    def _listen_to_root(self, now_ns: int) -> None:
        self._ticked_ns = now_ns
        if self._root.heard(self._heartbeat.heard_ns):
            self.context.saw(self._root.heard_ns)
        elif not self._root_lost:
            self._missed()
        if not self._root_lost and self._root.tick(now_ns):
            self._lose_root(f"the root process stopped answering ({self._root.told(now_ns)})")

    def _gate_alive(self, alive: Alive) -> None:
        now_ns = self.context.received_ns
        if alive.number != BROUGHT:
            self._gate_answered = alive.number
        elif now_ns - self._ticked_ns >= self._tick_ns // 2:
            self._ticker.brought()
            self._listen_to_root(now_ns)
        self._answers_ns[0] = now_ns
        self._alive = alive
        if now_ns >= self._cycle_at_ns:
            self._start_cycle(now_ns)
        if self._chain_answered(now_ns):
            self.context.saw((now_ns,))  # a number alone, in a replay, is what was heard of the root
            self._heartbeat.beat(now_ns)

    def _start_cycle(self, now_ns: int) -> None:
        answered = self._transport_answered == self._cycle
        resend = self._alive.epoch if self._alive.live and answered else 0
        self._cycle += 1
        self._cycle_at_ns = max(self._cycle_at_ns + self._cycle_ns, now_ns)
        self._transport.tell(Cycle(self._cycle, resend, answered))

    def _chain_answered(self, now_ns: int) -> bool:
        """Gate and transport have both been heard within the heartbeat's lifetime, or the transport
        said until when it is busy."""
        gate_ns, transport_ns = self._answers_ns
        limit_ns = now_ns - self._heartbeat_ttl_ns // 2 - self._cycle_ns
        return gate_ns >= limit_ns and (transport_ns >= limit_ns or now_ns < self._busy_until_ns)

    def _lose_root(self, why: str) -> None:
        if self._root_lost:
            return
        self._root_lost = True
        self.context.me.tell(Leave(why))

    async def _leave(self, why: str) -> None:
        """Nobody is left who could fence us: make safe, then end. Asked again, a gate with nothing
        energised has nothing to do, and any other one tries again."""
        confirmed = False
        try:
            for _ in range(ASKS):
                report = await self._gate.ask(Stop(Reason.ROOT, busy.explained(why)), self._leave_s)
                confirmed = isinstance(report, StopReport) and report.confirmed
                if confirmed:
                    break
        except (AskTimeout, Unreachable):
            pass  # whoever hears of it goes past gate and transport
        finally:
            self._orphaned(confirmed)

    # -- for a recorder

    def memory(self) -> WatchdogMemory:
        return WatchdogMemory(
            self._probe,
            self._cycle,
            self._cycle_at_ns,
            self._ticked_ns,
            self._gate_answered,
            self._transport_answered,
            self._answers_ns[0],
            self._answers_ns[1],
            self._busy_until_ns,
            self._alive,
            self._root.memory(),
            self._root_lost,
        )

    def recall(self, memory: WatchdogMemory) -> None:
        """Go on from there."""
        self._probe, self._cycle, self._cycle_at_ns = memory.probe, memory.cycle, memory.cycle_at_ns
        self._ticked_ns = memory.ticked_ns
        self._gate_answered, self._transport_answered = memory.gate_answered, memory.transport_answered
        self._answers_ns = [memory.gate_heard_ns, memory.transport_heard_ns]
        self._busy_until_ns, self._alive = memory.busy_until_ns, memory.alive
        self._root.recall(memory.root)
        self._root_lost = memory.root_lost
