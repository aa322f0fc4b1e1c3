"""The watchdog: re-send setpoints, let them expire, and send heartbeats. It does this only while gate and transport
work.

At every tick it sends a probe to the gate, which checks its deadlines and replies. In every control period it lets
the transport read the robot, and send the last setpoint again under three conditions:

    writer      the gate reports that the setpoint is in force: its lifetime and lease have not ended
    gate        it has replied to the probe
    transport   it has replied in the last period

If one of them is frozen, the robot gets no more setpoints, and its own timeout can stop it.

The heartbeat to the root needs the replies of gate and transport, but no writer. If gate or transport does not
reply, the heartbeats end, and the root kills the wire process.

In a stream as fast as the ticks, the gate checks its deadlines at every accepted setpoint, so no probe is needed.
The next tick is then postponed (``Ticker``). When the stream pauses, the ticks continue.

The watchdog reads no clock. A decision depends on its memory, the message, and the time at which the message was
taken from the mailbox.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from strands_actors.contract.driver import Reason, Timing
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.failure_detector import DetectorState, FailureDetector
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.health.processor import ProcessorUse
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import BROUGHT, Probe, Stop, StopReport
from strands_actors.supervisors.wire.messages import Alive, Cycle, Cycled, RootGone

STOP_ATTEMPTS = 2


class Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Leave(Message, frozen=True):
    """A message of the watchdog to itself: the root is gone. Stop the robot, then exit."""

    lane = "urgent"

    cause: str


class WatchdogMemory(msgspec.Struct, frozen=True):
    """Everything on which the watchdog's decisions depend, besides a message and its time."""

    probe: int
    cycle: int
    cycle_at_ns: int
    ticked_ns: int
    gate_answered: int
    transport_answered: int
    gate_answered_ns: int = msgspec.field(name="gate_heard_ns")
    transport_answered_ns: int = msgspec.field(name="transport_heard_ns")
    busy_until_ns: int
    alive: Alive
    root: DetectorState
    root_lost: bool


class Watchdog(Actor):
    """Send ticks, heartbeats and control cycles for one wire process.

    Args:
        timing: The timing of the driver.
        gate: Address of the gate.
        transport: Address of the transport.
        orphaned: Called after the root has ended and the robot was stopped, with True if the stop was confirmed.
        heartbeat: The heartbeats of wire and root, on a shared page.
        root: Returns whether the root process waits for a processor. A process that waits does not count as silent.
        missed: Called at a tick without a new heartbeat of the root. It checks whether the root process is dying,
            and then sends ``RootGone`` before the system reports the end.
        late_s: If a request is cut off, it may still take effect for this long (``Timing.late_s``).
    """

    def __init__(
        self,
        timing: Timing,
        gate: str,
        transport: str,
        orphaned: Callable[[bool], None],
        heartbeat: Heartbeat,
        root: Callable[[], ProcessorUse | None] = lambda: None,
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
        self._answers_ns = [0, 0]  # times of the last replies of gate and transport
        self._busy_until_ns = 0
        self._alive = Alive(0, 0, False)
        self._root_use = root
        self._missed = missed
        self._root = FailureDetector(timing.heartbeat_ttl_s, timing.tick_s, self._observe_root)
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
                self.context.start_soon(self._leave, message.cause)
            case StopReport():
                pass

    def _observe_root(self) -> ProcessorUse | None:
        use = self._root_use()
        self.context.saw(use)
        return use

    def _tick(self, now_ns: int) -> None:
        self._probe += 1
        self._gate.tell(Probe(self._probe, now_ns))
        self._listen_to_root(now_ns)

    def _listen_to_root(self, now_ns: int) -> None:
        self._ticked_ns = now_ns
        if self._root.note_heartbeat(self._heartbeat.last_received_ns):
            self.context.saw(self._root.last_received_ns)
        elif not self._root_lost:
            self._missed()
        if not self._root_lost and self._root.tick(now_ns):
            self._lose_root(f"the root process stopped answering ({self._root.describe_silence(now_ns)})")

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
            # It is a tuple, since a replay reads a plain number as a heartbeat of the root.
            self.context.saw((now_ns,))
            self._heartbeat.beat(now_ns)

    def _start_cycle(self, now_ns: int) -> None:
        answered = self._transport_answered == self._cycle
        resend = self._alive.epoch if self._alive.live and answered else 0
        self._cycle += 1
        self._cycle_at_ns = max(self._cycle_at_ns + self._cycle_ns, now_ns)
        self._transport.tell(Cycle(self._cycle, resend, answered))

    def _chain_answered(self, now_ns: int) -> bool:
        """Return True if gate and transport have replied recently. While the transport has announced that it is
        busy, it need not reply."""
        gate_ns, transport_ns = self._answers_ns
        limit_ns = now_ns - self._heartbeat_ttl_ns // 2 - self._cycle_ns
        return gate_ns >= limit_ns and (transport_ns >= limit_ns or now_ns < self._busy_until_ns)

    def _lose_root(self, cause: str) -> None:
        if self._root_lost:
            return
        self._root_lost = True
        self.context.me.tell(Leave(cause))

    async def _leave(self, cause: str) -> None:
        """Stop the robot and exit, since the root has ended and can no longer kill this process. If the stop is not
        confirmed, it is ordered a second time."""
        confirmed = False
        try:
            for _ in range(STOP_ATTEMPTS):
                report = await self._gate.ask(Stop(Reason.ROOT, busy.explained(cause)), self._leave_s)
                confirmed = isinstance(report, StopReport) and report.confirmed
                if confirmed:
                    break
        except (AskTimeout, Unreachable):
            pass  # ``orphaned(False)`` then stops the robot without gate and transport.
        finally:
            self._orphaned(confirmed)

    # -- memory for recordings and replays

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
        """Restore the state of the watchdog from a recording, for a replay."""
        self._probe, self._cycle, self._cycle_at_ns = memory.probe, memory.cycle, memory.cycle_at_ns
        self._ticked_ns = memory.ticked_ns
        self._gate_answered, self._transport_answered = memory.gate_answered, memory.transport_answered
        self._answers_ns = [memory.gate_answered_ns, memory.transport_answered_ns]
        self._busy_until_ns, self._alive = memory.busy_until_ns, memory.alive
        self._root.recall(memory.root)
        self._root_lost = memory.root_lost
