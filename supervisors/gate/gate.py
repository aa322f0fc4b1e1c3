"""The gate: the actor through which every command to a robot passes.

It holds the failsafe state, the leases and the newest observation. ``failsafe`` decides which state
follows, ``admission`` which setpoint is accepted, ``cause`` which cause of a stop is kept.

The gate reads no clock. A decision depends on its memory, the message, and the time at which the
message was taken from the mailbox, so that a recording can be replayed exactly. The gate never waits:
it replies to a stop when the transport reports, and handles other messages meanwhile.
"""

from __future__ import annotations

import msgspec

from strands_actors.contract.driver import HOLDING_REASONS, ORDERED, Driver, Live, OnResume, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor, Deferred
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Ref
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import (
    ACQUIRE,
    BROUGHT,
    MOVE,
    OBSERVE,
    RESUME,
    Accepted,
    Acquire,
    ArmDone,
    Beat,
    CarriedOut,
    GetObservation,
    GetSafety,
    GetStatus,
    Lease,
    LinkLost,
    LinkUp,
    LockKept,
    Observed,
    Perform,
    Performed,
    Probe,
    Release,
    Released,
    Resume,
    Resumed,
    SafeDone,
    Setpoint,
    StandbyIs,
    Status,
    Stop,
    Stopped,
    StoppedAt,
    StopReport,
)
from strands_actors.supervisors.root.messages import Decided, StateIs
from strands_actors.supervisors.root.stop_channel import not_reached
from strands_actors.supervisors.wire.messages import Alive, Arm, CarryOut, MakeSafe, Write

from . import failsafe
from .admission import Admission, Known, refuse_at_the_end
from .cause import SOON_NS, Cause, Lapse, Rank, rank_of, rank_of_condition
from .failsafe import Action, Event, Mode
from .held_target import held_target
from .lease import LEASE_TTL_NS, Held, Leases
from .memory import GateMemory, Waiting

_STOP_AGAIN_NS = round(0.5 * NS)
"""Shortest time between an unconfirmed stop and the next one."""

_MADE_SAFE = frozenset({Mode.HOLDING, Mode.STOPPING, Mode.ENDING})
"""Modes in which the transport brings the robot to a safe state and will report."""
NOBODY_WRITES = "the writer gave its lease back"
OBSERVATION_S = 1.0
"""Shortest time for which an observation counts as current. On a busy computer the next may be
late."""


class Gate(Actor):
    """Decide about every command to one robot.

    Args:
        driver: The driver of the robot.
        transport: Address of the transport.
        watchdog: Address of the watchdog.
        guardian: Address of the guardian, in the root.
        start: First state of the failsafe machine. A restarted wire continues with its last epoch.
        cause: What led to that state, for people.
        locked_since: When a lockout began, ISO 8601; empty if there is none.
        no_standby: Why nothing may be energised, until the root reports that its stop channel and
            the standby are ready.
        audited: Report every decision to the root, which writes the audit.
        secret: Key of the leases' numbers, so that they cannot be guessed.
        stopped_ns: When the root was last ordered to stop the robot.
    """

    def __init__(
        self,
        driver: Driver,
        transport: str,
        watchdog: str,
        guardian: str,
        start: failsafe.State,
        cause: str = "",
        locked_since: str = "",
        no_standby: str = "",
        audited: bool = False,
        secret: bytes = b"",
        stopped_ns: int = 0,
    ) -> None:
        self._driver = driver
        self._admission = Admission(driver)
        self._no_standby = no_standby
        self._audited = audited
        self._addresses = transport, watchdog, guardian
        self._state = start
        # A lease of an earlier wire process must not count here.
        self._leases = Leases(0, secret=secret) if secret else Leases(start.epoch << 20)
        self._observation: Observation | None = None
        self._target: tuple[float, ...] = ()
        self._target_ns = 0
        self._live: Live | None = None
        self._stops: list[Waiting] = []
        self._lock = LockKept(0, locked_since)  # the newest lock on the disk
        self._resumes: list[Deferred] = []
        self._rearming: list[Deferred] = []  # resumes that arm when the robot has stopped
        self._grants: list[tuple[Lease, Deferred]] = []  # leases to give when the hold is done
        self._services: dict[int, Deferred] = {}  # requests for running services, by number
        self._service = 0
        self._cause = Cause(cause)
        self._connect_error = "not connected yet"
        self._facts: dict[str, object] = {}
        self._last_stop: StopReport | None = None
        self._last_stop_ns = 0
        self._report_stands = False  # no motion and no lost link since the report of the last stop
        self._stopped_ns = stopped_ns  # time of the last ordered stop
        self._writes = self._reads = self._refusals = 0
        self._last_refusal = ""

    async def started(self) -> None:
        transport, watchdog, guardian = self._addresses
        self._transport: Ref = self.context.ref(transport)
        self._watchdog: Ref = self.context.ref(watchdog)
        self._guardian: Ref = self.context.ref(guardian)
        self._tell_state()

    def receive(
        self,
        message: Setpoint
        | Stop
        | Resume
        | Acquire
        | Beat
        | Release
        | Stopped
        | GetObservation
        | GetSafety
        | GetStatus
        | Perform
        | Probe
        | Observed
        | SafeDone
        | LockKept
        | StoppedAt
        | StandbyIs
        | ArmDone
        | CarriedOut
        | LinkUp
        | LinkLost,
    ) -> (
        Accepted
        | Refused
        | StopReport
        | Resumed
        | Released
        | Lease
        | Observation
        | Status
        | Performed
        | Deferred
        | None
    ):
        match message:
            case Setpoint():
                return self._setpoint(message)
            case Probe():
                if self._live is not None:
                    self._look(message.now_ns)
                elif self._state.mode in failsafe.WRITABLE:
                    self._look_at_conditions(message.now_ns, live=False)
                self._tell_alive(message.number)
            case Observed():
                self._observed(message)
            case Stop():
                return self._stop(message)
            case Resume():
                return self._answer_resume(message)
            case Beat():
                self._leases.beat(message, self.context.received_ns)
            case Stopped():
                self._writer_stopped(message.pid)
            case Acquire():
                return self._acquire(message)
            case Release():
                return self._release(message)
            case GetObservation():
                seen = self._newest_observation()
                return seen.about(OBSERVE) if isinstance(seen, Refused) else seen
            case GetSafety():
                return self._safety()
            case GetStatus():
                return self._status()
            case Perform():
                return self._perform(message)
            case CarriedOut():
                self._carried_out(message)
            case SafeDone():
                self._safe_done(message)
            case LockKept():
                self._lock = message
                self._answer_stops()
            case StoppedAt():
                self._stopped_ns = max(self._stopped_ns, message.at_ns)
            case StandbyIs():
                self._no_standby = message.problem
            case ArmDone():
                self._arm_done(message)
            case LinkUp():
                self._link_up(message)
            case LinkLost():
                self._link_lost(message.why)
        return None

    # -- setpoints

    def _setpoint(self, message: Setpoint) -> Accepted | Refused:
        held = self._leases.find(message.lease, message.channel)
        kept = None if held is None else held.refused
        code = "accepted"
        answer = kept or self._admit(message)
        if isinstance(answer, Refused):
            if held is not None and not self.context.asked:
                held.refused = answer
            code = answer.code
            self._refusals += 1
            self._last_refusal = answer.text
        elif 0 < message.period_s <= self._driver.timing.tick_s:
            self._look(self.context.received_ns, admitted=True)
            self._tell_alive(BROUGHT)
        if held is not None and held.told != code:
            held.told = code
            self._tell_decided(
                held.holder, "setpoint", answer if isinstance(answer, Refused) else code, held.channel
            )
        return answer

    def _admit(self, message: Setpoint) -> Accepted | Refused:
        now_ns = self.context.received_ns
        admitted = self._admission.setpoint(message, self._known(), now_ns)
        if isinstance(admitted, Refused):
            return admitted
        self._advance(Event.SETPOINT)
        self._report_stands = False
        self._target, self._target_ns = admitted.values, now_ns
        self._live = Live(admitted.until_ns or None)
        if self._leases.held is not None:
            self._leases.held.beat(now_ns + LEASE_TTL_NS)
            self._leases.held.steps += 1
        streamed = message.period_s > 0
        write = Write(message.epoch, admitted.deadline_ns, admitted.values, admitted.until_ns, streamed)
        self._transport.tell(write)
        seen = self._newest_observation() if message.observe else None
        observation = seen if isinstance(seen, Observation) else None
        return Accepted(self._state.epoch, admitted.values, self._read_beside(), observation)

    def _read_beside(self) -> dict[str, tuple[float, ...]]:
        """Return the sensors that the driver adds to the reply to an accepted command."""
        wanted, seen = self._driver.ANSWERS_WITH, self._observation
        if not wanted or seen is None:
            return {}
        return {name: seen.sensors[name] for name in wanted if name in seen.sensors}

    def _known(self) -> Known:
        return Known(
            self._state,
            self._leases,
            self._cause.text,
            self._cause.reason,
            self._connect_error,
            self._observation,
            self._target,
            self._target_ns,
            self._live,
            bool(self._services),
        )

    # -- the driver's own services

    def _perform(self, message: Perform) -> Refused | Deferred:
        refusal = self._admission.service(message, self._known(), self.context.received_ns)
        if refusal is not None:
            return refusal
        if message.first is not None:
            answer = self._setpoint(message.first)
            if isinstance(answer, Refused):
                return answer
        if self._driver.SERVICES[message.service].moves:
            self._advance(Event.SETPOINT)
            self._report_stands = False
            self._live = Live()
        elif self._driver.SERVICES[message.service].ends_motion:
            self._live = None
        self._service += 1
        self._services[self._service] = deferred = self.context.defer()
        self._transport.tell(CarryOut(self._state.epoch, self._service, message.service, message.arguments))
        return deferred

    def _carried_out(self, message: CarriedOut) -> None:
        if message.moved and self._observation is not None:  # The next command starts where the service ended.
            self._target = self._driver.first_target(self._observation)
            self._target_ns = self.context.received_ns
        deferred = self._services.pop(message.number, None)
        if deferred is not None:
            deferred.send(message.refusal or Performed(message.result))

    # -- the lease

    def _acquire(self, message: Acquire) -> Lease | Refused | Deferred:
        """Give a lease. During a hold the reply waits for its end, so that axes which the next command
        does not name stay where they were held."""
        answer = self._leases.acquire(message, self.context.received_ns, self._state.mode is Mode.HOLDING)
        if isinstance(answer, Refused):
            answer = answer.about(ACQUIRE)
        self._tell_decided(
            message.holder, ACQUIRE, answer if isinstance(answer, Refused) else "granted", message.channel
        )
        if isinstance(answer, Refused):
            return answer
        lease = Lease(answer, self._state.epoch)
        if not self._is_being_held:
            return lease
        deferred = self.context.defer()
        self._grants.append((lease, deferred))
        return deferred

    @property
    def _is_being_held(self) -> bool:
        """True while a hold is running and has not been reported."""
        return self._state.mode is Mode.HOLDING and not self._is_reported

    @property
    def _is_reported(self) -> bool:
        """True if the newest order of a safe state has been reported."""
        return self._last_stop is not None and self._last_stop.epoch >= self._state.epoch

    def _release(self, message: Release) -> Released | Deferred:
        """Release a lease. If that makes the robot hold, reply when the hold is reported."""
        held = self._leases.release(message.lease, message.channel)
        if held is not None:
            self._tell_decided(held.holder, "release", "released", held.channel)
            latched = held.under is not None and self._live is not None and self._live.latched
            if not (message.keeps and latched and not message.channel) and self._end_writer(held):
                deferred = self.context.defer()
                self._stops.append(Waiting(self._state.epoch, deferred, False, releases=True))
                return deferred
        return Released(False, self._report_now(Reason.LEASE))

    def _end_writer(self, held: Held) -> bool:
        """Make the robot hold after a writer has released its lease. Return False if there is nothing to
        hold."""
        if held.under is not None:
            return self._trip(Reason.POLICY, f"{held.holder} ended", lapse=Lapse.ROLLOUT_ENDED)
        if self._live is not None or self._state.mode is Mode.LOST:
            return self._trip(Reason.LEASE, NOBODY_WRITES, lapse=Lapse.GIVEN_BACK)
        return False

    def _writer_stopped(self, pid: int) -> None:
        """Make the robot hold, as if the lease or the last setpoint had expired, because a stopped process
        can renew neither."""
        held = self._leases.held
        if held is None or self._live is None:
            return
        if held.owner.pid == pid:
            self._trip(Reason.LEASE, f"the process of {held.owner.holder} is stopped")
        elif held.pid == pid:
            self._trip(Reason.EXPIRED, f"the process of {held.holder} is stopped")

    # -- time

    def _look(self, now_ns: int, admitted: bool = False) -> None:
        """Check everything that may end the live target. ``admitted``: the conditions of the robot were
        checked just before."""
        live = self._live
        if live is not None and live.over(now_ns):
            self._trip(Reason.EXPIRED, "the setpoint expired", lapse=Lapse.EXPIRED)
        elif self._leases.held is None:
            self._trip(Reason.LEASE, NOBODY_WRITES, lapse=Lapse.GIVEN_BACK)
        elif why := self._leases.lapsed(now_ns, live is not None and live.latched):
            self._trip(Reason.LEASE, why)
        elif not admitted:
            self._look_at_conditions(now_ns, live=True)

    def _look_at_conditions(self, now_ns: int, live: bool) -> None:
        """Stop the robot if a condition is broken. While no target is live, only the conditions that
        always hold are checked."""
        if self._observation is None:
            return
        broken = self._admission.broken_condition(self._observation, now_ns, only_always=not live)
        if broken is not None:
            condition, refusal = broken
            cause = refusal.reason
            rank = rank_of_condition(self._driver, condition)
            self._trip(condition.reason, cause, safe_state=condition.safe_state, rank=rank)

    def _tell_decided(self, who: str, what: str, how: str | Refused, over: str = "") -> None:
        """Report a decision for the audit, which the root writes."""
        if self._audited:
            told = f"refused: {how.text}" if isinstance(how, Refused) else how
            self._guardian.tell(Decided(who, what, told, over))

    def _tell_alive(self, number: int) -> None:
        live = self._live is not None and self._state.mode is Mode.ARMED
        self._watchdog.tell(Alive(number, self._state.epoch, live))

    # -- stop, resume

    def _stop(self, message: Stop) -> StopReport | Deferred | None:
        if message.channel:  # a policy process or a visitor
            message = message.as_ordered()
        if message.reason in ORDERED:
            self._stopped_ns = self.context.received_ns
        deferred = self.context.defer()
        by = f"{message.reason} by {message.by}" if message.by else str(message.reason)
        lock = (message.by or "an operator") if message.lock else ""
        self._leases.stop()
        what = f"stop ({message.reason}{', locks' if message.lock else ''})"
        if self._trip(message.reason, by, lock):
            self._tell_decided(message.by, what, "ordered")
            self._stops.append(Waiting(self._state.epoch, deferred, message.lock))
            return deferred
        self._tell_decided(message.by, what, "nothing to do")
        if self._state.mode in _MADE_SAFE and not self._is_reported:
            self._stops.append(Waiting(self._state.epoch, deferred, message.lock))
            return deferred
        return self._report_now(message.reason)

    def _report_now(self, reason: Reason) -> StopReport:
        """Return a report when there is nothing to order: that of the last stop, while it is valid.

        Without one, only two robots are confirmed: one with nothing energised, and an armed one whose
        reason would be a hold.
        """
        state, safe_state = self._state, self._driver.fallbacks[reason]
        if state.mode in failsafe.SAFE or (state.mode is Mode.ARMED and reason in HOLDING_REASONS):
            return StopReport(reason, safe_state, state.epoch, True, ())
        if self._last_stop is not None and self._report_stands:
            return self._last_stop
        why = self._connect_error or f"the robot is {state.mode}"
        return StopReport(reason, safe_state, state.epoch, False, not_reached(self._driver, why))

    def _safety(self) -> StopReport | Deferred:
        """As ``_report_now``, but wait for a report that is due."""
        if self._state.mode in _MADE_SAFE and not self._is_reported:
            deferred = self.context.defer()
            self._stops.append(Waiting(self._state.epoch, deferred, False))
            return deferred
        return self._report_now(Reason.POLICY)

    def _trip(
        self,
        reason: Reason,
        cause: str,
        lock: str = "",
        safe_state: SafeState | None = None,
        rank: int | None = None,
        lapse: Lapse = Lapse.NONE,
    ) -> bool:
        """Order a safe state.

        Args:
            reason: Why.
            cause: The same for people.
            lock: Who pressed the e-stop; empty for a stop without a lock.
            safe_state: The safe state; None for the driver's one for this reason.
            rank: Rank of the cause; None for that of the reason.
            lapse: How the command ended, if it ended by itself.

        Returns:
            False if the failsafe machine has nothing to do.
        """
        safe_state = safe_state or self._driver.fallbacks[reason]
        if reason in failsafe.ENDING_REASONS:
            event = Event.END
        elif reason in HOLDING_REASONS and self._driver.energised(safe_state):
            event = Event.HOLD
        else:
            event = Event.STOP
        # The state is at least as severe as the one that the lost link has ordered.
        if event is Event.HOLD and self._state.mode is Mode.LOST:
            safe_state = SafeState(safe_state).or_more(self._driver.fallbacks[Reason.LINK])
        return self._step(event, safe_state, reason, cause, lock, rank, lapse)

    def _trip_again(self, reason: Reason) -> None:
        """Order the safe state again, for the present cause."""
        cause = self._cause
        self._trip(reason, cause.text, rank=cause.rank, lapse=cause.lapse)

    def _step(
        self,
        event: Event,
        safe_state: SafeState,
        reason: Reason,
        cause: str,
        lock: str = "",
        rank: int | None = None,
        lapse: Lapse = Lapse.NONE,
    ) -> bool:
        before = self._state
        self._state, action = failsafe.step(before, event, lock)
        makes_safe = action is Action.MAKE_SAFE
        if makes_safe:
            if event is not Event.HOLD or before.mode is not Mode.LOST:  # then the lost link stays the cause
                self._blame(cause, reason, rank_of(reason) if rank is None else rank, lapse)
            self._live = None
            self._report_stands = False
            self._transport.tell(MakeSafe(self._state.epoch, safe_state, reason))  # before any other message
            self._refuse_resumes(Refused(Code.STOPPED, cause, "resume again when that is over"))
        if self._state != before:
            self._tell_state()
        return makes_safe

    def _blame(self, text: str, reason: Reason, rank: int, lapse: Lapse = Lapse.NONE) -> None:
        """Set the cause, unless a more specific one was found a moment ago."""
        now_ns = self.context.received_ns
        known, seen = self._cause, self._observation
        goes_on = text == known.text  # the same cause again, as when a lost link comes back
        faults = known.faults if goes_on else {} if seen is None else dict(seen.faults)
        cause = Cause(text, reason, rank, now_ns + SOON_NS, faults, lapse)
        self._cause = known.or_more_specific(cause, now_ns)

    def _refuse_resumes(self, refusal: Refused) -> None:
        for resume in (*self._resumes, *self._rearming):
            resume.send(refusal.about(RESUME))
        self._resumes.clear()
        self._rearming.clear()

    def _newest_observation(self) -> Observation | Refused:
        """Return the newest observation if it is current. One from before a lost link is not."""
        seen = self._observation
        if seen is None:
            return Refused(Code.NO_OBSERVATION, "nothing was read yet", "wait for the first observation")
        old_s = (self.context.received_ns - seen.t_ns) / NS
        longest_s = max(self._driver.timing.state_ttl_s, OBSERVATION_S)
        if old_s <= longest_s:
            return seen
        why = f"the newest reading is {old_s:.1f} s old"
        return Refused(Code.STALE, why, "check the robot's cable and power", f"{old_s:.1f} s", f"{longest_s:g} s")

    def _observed(self, message: Observed) -> None:
        self._observation = message.observation
        if self._state.mode not in (Mode.ARMING, Mode.ARMED):
            cause = self._cause.refined(self._driver, message.observation, self.context.received_ns)
            if cause is not self._cause:
                self._cause = cause
                self._tell_state()
        self._writes, self._reads = message.writes, message.reads
        if self._state.mode is Mode.UNCONFIRMED and self._last_stop is not None:
            self._stop_again(self._last_stop, message.observation)

    def _stop_again(self, report: StopReport, observation: Observation) -> None:
        """Order the safe state again when every unconfirmed motor answers again."""
        stamp_ns = dict(zip(self._driver.axes, observation.stamp_ns, strict=True))
        heard_ns = min((stamp_ns.get(axis, observation.t_ns) for axis in report.unconfirmed), default=0)
        if heard_ns > self._last_stop_ns + _STOP_AGAIN_NS:
            self._trip_again(report.reason)

    def _safe_done(self, message: SafeDone) -> None:
        report = self._last_stop = message.report
        self._last_stop_ns = self.context.received_ns
        self._report_stands = True
        self._cause = self._cause.reported(self.context.received_ns)
        self._answer_stops()
        if report.epoch == self._state.epoch:
            self._go_on(message)
        waiting, self._grants = self._grants, []
        for lease, grant in waiting:
            if lease.epoch > report.epoch:
                self._grants.append((lease, grant))
            else:
                grant.send(lease)

    def _go_on(self, message: SafeDone) -> None:
        report = message.report
        if message.hold_failed:
            self._trip(Reason.FAULT, f"it could not hold: {message.hold_failed}")
        else:
            self._advance(Event.SAFE_CONFIRMED if report.confirmed else Event.SAFE_UNCONFIRMED)
            seen = message.observation or self._observation
            if self._state.mode is Mode.HOLDING and seen is not None:
                self._aim_where_held(report, seen)
        self._rearm()

    def _answer_stops(self) -> None:
        """Reply to each stop that is done.

        A stop is done when the wire has reported it; an e-stop also needs its lock on the disk. The
        reply is the first report that covers the stop, since a later one may be of a milder stop.
        """
        waiting, self._stops = self._stops, []
        for stop in waiting:
            report = stop.report or self._last_stop
            if report is None or stop.epoch > report.epoch:
                self._stops.append(stop)
            elif stop.locks and stop.epoch > self._lock.epoch:
                self._stops.append(stop._replace(report=report))
            elif stop.locks and self._lock.problem:
                stop.who.send(msgspec.structs.replace(report, note=self._lock.problem))
            elif stop.releases:
                stop.who.send(Released(True, report))
            else:
                stop.who.send(report)

    def _answer_resume(self, message: Resume) -> Resumed | Refused | Deferred:
        answer = self._resume(message)
        if isinstance(answer, Refused):
            answer = answer.about(RESUME)
        how = "ordered" if isinstance(answer, Deferred) else "armed already"
        self._tell_decided(message.by, RESUME, answer if isinstance(answer, Refused) else how)
        return answer

    def _resume(self, message: Resume) -> Resumed | Refused | Deferred:
        if 0 < message.asked_ns < self._stopped_ns:
            why = "the robot was stopped after that was asked for"
            return Refused(Code.STOPPED, why, "resume again when that is over")
        if self._state.mode in failsafe.WRITABLE and self._observation is not None:
            return self._resume_armed()
        if self._state.locked_by and not message.lift:
            why = f"e-stopped by {self._state.locked_by}"
            return Refused(Code.LOCKED_OUT, why, "an operator's resume() lifts the lockout")
        refusal = self._begin_to_arm()
        if refusal is not None:
            return refusal
        deferred = self.context.defer()
        self._resumes.append(deferred)
        return deferred

    def _begin_to_arm(self) -> Refused | None:
        mode = self._state.mode
        if self._no_standby and (mode, Event.RESUME) in failsafe.TRANSITIONS:
            why = f"a process that could stop the robot is missing: {self._no_standby}"
            return Refused(Code.NO_STANDBY, why, "try again in a moment: another one is being started")
        action = self._advance(Event.RESUME)
        if action is not Action.ARM:
            if mode in failsafe.OVER:
                return refuse_at_the_end(self._cause.text)
            if mode not in failsafe.LINKED:
                return Refused(Code.NOT_CONNECTED, f"not connected: {self._connect_error}")
            return Refused(Code.BUSY, f"the robot is {mode}", "try again when that is over")
        self._transport.tell(Arm(self._state.epoch))
        return None

    def _resume_armed(self) -> Resumed | Refused | Deferred:
        """Reply to a resume of an armed robot. If a condition is broken that arming mends, stop the robot
        and arm it again."""
        seen = self._newest_observation()
        if isinstance(seen, Refused):
            return seen
        broken = self._admission.broken_for_resume(seen, self.context.received_ns)
        if broken is None:
            return Resumed(self._state.epoch, seen)
        condition, refusal = broken
        if condition.on_resume is OnResume.REFUSE:
            return refusal
        safe_state = condition.safe_state or self._driver.fallbacks[condition.reason]
        cause, rank = refusal.reason, rank_of_condition(self._driver, condition)
        self._step(Event.STOP, safe_state, condition.reason, cause, rank=rank)
        deferred = self.context.defer()
        self._rearming.append(deferred)
        return deferred

    def _rearm(self) -> None:
        """Arm after the stop that ``_resume_armed`` ordered, if that is confirmed."""
        if not self._rearming or self._state.mode is Mode.STOPPING:
            return
        if self._state.mode is not Mode.DISARMED:
            named = ", ".join(self._last_stop.unconfirmed if self._last_stop else ())
            why = f"the robot has to be stopped first, and that is not confirmed by {named or 'it'}"
            self._refuse_resumes(Refused(Code.UNCONFIRMED, why, "look at the robot, then call resume()"))
            return
        refusal = self._begin_to_arm()
        if refusal is not None:
            self._refuse_resumes(refusal)
            return
        self._resumes, self._rearming = [*self._resumes, *self._rearming], []

    def _arm_done(self, message: ArmDone) -> None:
        if message.epoch != self._state.epoch or self._state.mode is not Mode.ARMING:
            return  # A stop came while the robot was being armed.
        if message.observation is None:
            cause = f"arming failed: {message.error}"
            self._step(Event.ARM_FAILED, self._driver.fallbacks[Reason.STOP], Reason.FAULT, cause)
            return
        self._cause = Cause()
        self._report_stands = False
        self._advance(Event.ARM_DONE)
        self._aim_at_measured(message.observation)
        for resume in self._resumes:
            resume.send(Resumed(self._state.epoch, message.observation))
        self._resumes.clear()

    def _aim_at_measured(self, observation: Observation) -> None:
        """Take the measured position as the first target, so that the robot does not jump."""
        self._observation = observation
        self._target = self._driver.first_target(observation)
        self._target_ns = self.context.received_ns
        self._live = None

    def _aim_where_held(self, report: StopReport, observation: Observation) -> None:
        before = self._target
        self._aim_at_measured(observation)
        self._target = held_target(self._driver, report, before, self._target)

    # -- the link

    def _link_up(self, message: LinkUp) -> None:
        self._facts = dict(message.facts)
        self._connect_error = ""
        self._observation = message.observation
        cause = self._cause if self._cause.text else Cause("the link was lost", rank=Rank.LINK)
        safe_state = self._driver.fallbacks[Reason.LINK]
        self._step(Event.LINK_UP, safe_state, Reason.LINK, cause.text, rank=cause.rank, lapse=cause.lapse)
        stop = self._last_stop
        if self._state.mode is Mode.DISARMED and stop is not None and not stop.confirmed:
            # It was ordered while the robot could not hear it.
            self._trip_again(stop.reason)

    def _link_lost(self, why: str) -> None:
        self._connect_error = why
        if self._state.mode in failsafe.LINKED:
            self._blame(f"the link was lost: {why}", Reason.LINK, Rank.LINK)
        self._live = None
        self._report_stands = False
        self._advance(Event.LINK_LOST)
        self._refuse_resumes(Refused(Code.NOT_CONNECTED, why))

    def _advance(self, event: Event, lock: str = "") -> Action:
        before = self._state
        self._state, action = failsafe.step(before, event, lock)
        if self._state != before:
            self._tell_state()
        return action

    def _tell_state(self) -> None:
        state = self._state
        self._guardian.tell(StateIs(state.mode, state.epoch, state.locked_by, self._cause.text))

    def _status(self) -> Status:
        observation = self._observation
        age_s = -1.0 if observation is None else (self.context.received_ns - observation.t_ns) / NS
        return Status(
            self._state.mode,
            self._state.epoch,
            self._state.mode in failsafe.LINKED,
            self._connect_error,
            self._state.locked_by,
            self._cause.text,
            self._leases.held.holder if self._leases.held else "",
            observation,
            age_s,
            self._target,
            self._writes,
            self._reads,
            self._refusals,
            self._last_refusal,
            self._last_stop,
            self._facts,
            self._lock.since if self._state.locked_by else "",
            self._no_standby,
            self._no_motion(),
            self._leases.rollout(self.context.received_ns),
            self._cause.lapse,
        )

    def _no_motion(self) -> Refused | None:
        refusal = self._admission.refuse_motion(self._known(), self.context.received_ns)
        return None if refusal is None else refusal.about(MOVE)

    # -- recordings

    def memory(self) -> GateMemory:
        return GateMemory(**{name: getattr(self, f"_{name}") for name in GateMemory.__struct_fields__})

    def recall(self, memory: GateMemory) -> None:
        """Restore a memory, for a replay."""
        for name in GateMemory.__struct_fields__:
            setattr(self, f"_{name}", getattr(memory, name))
