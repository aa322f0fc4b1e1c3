"""The gate: the actor through which every command to a robot passes.

The gate holds the failsafe state, the leases (rights to command) and the newest observation. ``failsafe`` decides
which state follows, ``admission`` which setpoint is accepted, and ``cause`` which cause of a stop is kept.

The gate reads no clock. A decision depends on its memory, the message, and the time at which the message was taken
from the mailbox, so that a recording can be replayed exactly. The gate never waits. It replies to a stop when the
transport (the actor that writes to the robot) has reported it, and handles other messages meanwhile.
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
    WriterEnded,
)
from strands_actors.supervisors.refusals import link_lost
from strands_actors.supervisors.root.messages import Decided, StateIs
from strands_actors.supervisors.root.stop_channel import not_reached
from strands_actors.supervisors.wire.messages import Alive, Arm, CarryOut, MakeSafe, Write

from . import failsafe, refusals
from .admission import Admission, GateSnapshot
from .cause import SOON_NS, Cause, Lapse, Rank, rank_of, rank_of_condition
from .failsafe import Action, Event, Mode
from .intervals import Intervals
from .lease import LEASE_TTL_NS, HeldLease, Leases
from .memory import GateMemory, Waiting
from .target_after_hold import target_after_hold

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
        transport: Address of the transport, which writes to the robot.
        watchdog: Address of the watchdog, which sends ticks and heartbeats.
        guardian: Address of the guardian in the root process, which restarts the wire process.
        start: First state of the failsafe machine. The gate of a restarted wire process continues with the last
            epoch (a counter of stops and holds).
        cause: Why the robot is in that state, for people.
        locked_since: When the robot was locked by an e-stop, ISO 8601; empty if it is not locked.
        no_standby: Why nothing may be energised yet. It is empty once the root has reported that its stop channel
            and the standby process are ready.
        audited: True to report every decision to the root, which writes the audit.
        secret: Key for the numbers of leases (rights to command), so that they cannot be guessed.
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
        # Numbers start high, so that a lease of an earlier wire process is not valid here.
        self._leases = Leases(0, secret=secret) if secret else Leases(start.epoch << 20)
        self._observation: Observation | None = None
        self._target: tuple[float, ...] = ()
        self._target_ns = 0
        self._live: Live | None = None
        self._stops: list[Waiting] = []
        self._lock = LockKept(0, locked_since)  # the lock that the root wrote to the disk last
        self._resumes: list[Deferred] = []
        self._rearming: list[Deferred] = []  # resumes that wait until the robot has stopped, and then arm it
        self._grants: list[tuple[Lease, Deferred]] = []  # leases that are given when the hold is done
        # Requests that wait for a running service, by the number of the service.
        self._services: dict[int, Deferred] = {}
        self._service = 0
        self._cause = Cause(cause)
        self._last_cause = ""  # the cause of the stop before the last arming
        self._connect_error = "not connected yet"
        self._facts: dict[str, object] = {}
        self._last_stop: StopReport | None = None
        self._last_stop_ns = 0
        # True if the robot has not moved, and the link was not lost, since the last report of a stop.
        self._report_stands = False
        self._stopped_ns = stopped_ns  # when a stop was last ordered
        self._ordered = SafeState.HOLD  # the safe state that was ordered last
        self._writes = self._reads = self._refusals = 0
        self._last_refusal = ""
        self._refused: dict[str, int] = {}
        self._setpoints = 0
        self._intervals = Intervals()

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
        | WriterEnded
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
                    self._check_conditions(message.now_ns, live=False)
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
            case WriterEnded():
                self._writer_ended(message.pid)
            case Acquire():
                return self._acquire(message)
            case Release():
                return self._release(message)
            case GetObservation():
                observation = self._newest_observation()
                return observation.about(OBSERVE) if isinstance(observation, Refused) else observation
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
                self._link_lost(message.cause)
        return None

    # -- setpoints of writers

    def _setpoint(self, message: Setpoint) -> Accepted | Refused:
        lease = self._leases.find(message.lease, message.channel)
        kept = None if lease is None else lease.refused
        code = "accepted"
        answer = kept or self._admit(message)
        if isinstance(answer, Refused):
            if lease is not None and not self.context.expects_answer:
                lease.refused = answer
            code = answer.code
            self._refusals += 1
            self._last_refusal = answer.text
            self._refused[code] = self._refused.get(code, 0) + 1
        elif 0 < message.period_s <= self._driver.timing.tick_s:
            self._look(self.context.received_ns, admitted=True)
            self._tell_alive(BROUGHT)
        if lease is not None and lease.last_decision != code:
            lease.last_decision = code
            self._tell_decided(
                lease.holder, "setpoint", answer if isinstance(answer, Refused) else code, lease.channel
            )
        return answer

    def _admit(self, message: Setpoint) -> Accepted | Refused:
        now_ns = self.context.received_ns
        admitted = self._admission.setpoint(message, self._snapshot(), now_ns)
        if isinstance(admitted, Refused):
            return admitted
        self._advance(Event.SETPOINT)
        self._setpoints += 1
        self._intervals.note(message.lease, message.period_s > 0, now_ns)
        self._report_stands = False
        self._target, self._target_ns = admitted.values, now_ns
        self._live = Live(admitted.until_ns or None)
        if self._leases.held is not None:
            self._leases.held.beat(now_ns + LEASE_TTL_NS)
            self._leases.held.steps += 1
        streamed = message.period_s > 0
        write = Write(message.epoch, admitted.deadline_ns, admitted.values, admitted.until_ns, streamed)
        self._transport.tell(write)
        newest = self._newest_observation() if message.observe else None
        observation = newest if isinstance(newest, Observation) else None
        return Accepted(self._state.epoch, admitted.values, self._read_beside(), observation)

    def _read_beside(self) -> dict[str, tuple[float, ...]]:
        """Return the sensor values that the reply to an accepted command contains (``ANSWERS_WITH`` of the
        driver)."""
        names, observation = self._driver.ANSWERS_WITH, self._observation
        if not names or observation is None:
            return {}
        return {name: observation.sensors[name] for name in names if name in observation.sensors}

    def _snapshot(self) -> GateSnapshot:
        return GateSnapshot(
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

    # -- services of the driver

    def _perform(self, message: Perform) -> Refused | Deferred:
        refusal = self._admission.service(message, self._snapshot(), self.context.received_ns)
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
        # The next command starts from the position where the service ended.
        if message.moved and self._observation is not None:
            self._target = self._driver.first_target(self._observation)
            self._target_ns = self.context.received_ns
        deferred = self._services.pop(message.number, None)
        if deferred is not None:
            deferred.send(message.refusal or Performed(message.result))

    # -- leases: give, release and end them

    def _acquire(self, message: Acquire) -> Lease | Refused | Deferred:
        """Give a lease, the right to command the robot. During a hold, the reply is sent only when the hold is
        done. The next command then starts from the held position, so axes that it does not name do not move."""
        answer = self._leases.acquire(message, self.context.received_ns, self._state.mode is Mode.HOLDING)
        if isinstance(answer, Refused):
            answer = answer.about(ACQUIRE)
        self._tell_decided(
            message.holder, ACQUIRE, answer if isinstance(answer, Refused) else "granted", message.channel
        )
        if isinstance(answer, Refused):
            return answer
        lease = Lease(answer, self._state.epoch)
        if not self._is_hold_pending:
            return lease
        deferred = self.context.defer()
        self._grants.append((lease, deferred))
        return deferred

    @property
    def _is_hold_pending(self) -> bool:
        """Return True while the robot is being brought to a hold that the wire has not reported yet."""
        return self._state.mode is Mode.HOLDING and not self._is_reported

    @property
    def _is_reported(self) -> bool:
        """Return True if the transport, which writes to the robot, has reported the result of the newest order of
        a safe state."""
        return self._last_stop is not None and self._last_stop.epoch >= self._state.epoch

    @property
    def _is_being_made_safe(self) -> bool:
        """Return True while the transport brings the robot to a safe state and has not reported it yet."""
        return self._state.mode in _MADE_SAFE and not self._is_reported

    def _release(self, message: Release) -> Released | Deferred:
        """Release a lease. If the robot must hold because of this, the reply is sent when the hold is reported."""
        lease = self._leases.release(message.lease, message.channel)
        if lease is not None:
            self._tell_decided(lease.holder, "release", "released", lease.channel)
            latched = lease.under is not None and self._live is not None and self._live.latched
            if not (message.keeps and latched and not message.channel) and self._end_writer(lease):
                deferred = self.context.defer()
                self._stops.append(Waiting(self._state.epoch, deferred, False, releases=True))
                return deferred
        return Released(False, self._report_now(Reason.LEASE))

    def _end_writer(self, lease: HeldLease) -> bool:
        """Make the robot hold after a writer has released its lease. Return False if no hold was ordered."""
        if lease.under is not None:
            return self._trip(Reason.POLICY, f"{lease.holder} ended", lapse=Lapse.ROLLOUT_ENDED)
        if self._live is not None or self._state.mode is Mode.LOST:
            return self._trip(Reason.LEASE, NOBODY_WRITES, lapse=Lapse.LEASE_RELEASED)
        return False

    def _writer_stopped(self, pid: int) -> None:
        """Make the robot hold when the operating system has suspended a writer's process (SIGSTOP). Such a process
        can send neither heartbeats nor setpoints."""
        lease = self._leases.held
        if lease is None or self._live is None:
            return
        if lease.owner.pid == pid:
            self._trip(Reason.LEASE, f"the process of {lease.owner.holder} is stopped")
        elif lease.pid == pid:
            self._trip(Reason.EXPIRED, f"the process of {lease.holder} is stopped")

    def _writer_ended(self, pid: int) -> None:
        """End the lease of an attached program that has ended, and that of its policy. If a setpoint is in force,
        the robot goes to its safe state for a lost writer. Other programs may acquire the lease from now on."""
        lease = self._leases.held
        if lease is None or lease.owner.pid != pid:
            return
        self._leases.held = None
        if self._live is not None:
            self._trip(Reason.LEASE, f"the process of {lease.owner.holder} has ended")

    # -- checks when time passes

    def _look(self, now_ns: int, admitted: bool = False) -> None:
        """Check everything that may end the setpoint in force. ``admitted`` is True if the robot's conditions
        (checks of its state) have just passed."""
        live = self._live
        if live is not None and live.over(now_ns):
            self._trip(Reason.EXPIRED, "the setpoint expired", lapse=Lapse.EXPIRED)
        elif self._leases.held is None:
            self._trip(Reason.LEASE, NOBODY_WRITES, lapse=Lapse.LEASE_RELEASED)
        elif cause := self._leases.lapsed(now_ns, live is not None and live.latched):
            self._trip(Reason.LEASE, cause)
        elif not admitted:
            self._check_conditions(now_ns, live=True)

    def _check_conditions(self, now_ns: int, live: bool) -> None:
        """Stop the robot if one of its conditions fails (checks of its state, declared by the driver). While no
        setpoint is in force (``live`` is False), check only those that must always pass."""
        if self._observation is None:
            return
        broken = self._admission.broken_condition(self._observation, now_ns, only_always=not live)
        if broken is not None:
            condition, refusal = broken
            cause = refusal.reason
            rank = rank_of_condition(self._driver, condition)
            self._trip(condition.reason, cause, safe_state=condition.safe_state, rank=rank)

    def _tell_decided(self, sender: str, order: str, result: str | Refused, over: str = "") -> None:
        """Send a decision to the root, which writes it to the audit."""
        if self._audited:
            text = f"refused: {result.text}" if isinstance(result, Refused) else result
            self._guardian.tell(Decided(sender, order, text, over))

    def _tell_alive(self, number: int) -> None:
        live = self._live is not None and self._state.mode is Mode.ARMED
        self._watchdog.tell(Alive(number, self._state.epoch, live))

    # -- stops and resumes

    def _stop(self, message: Stop) -> StopReport | Deferred | None:
        if message.channel:  # the sender is a policy process, or another program of the user
            message = message.as_ordered()
        if message.reason in ORDERED:
            self._stopped_ns = self.context.received_ns
        deferred = self.context.defer()
        by = f"{message.reason} by {message.by}" if message.by else str(message.reason)
        lock = (message.by or "an operator") if message.lock else ""
        self._leases.stop()
        order = f"stop ({message.reason}{', locks' if message.lock else ''})"
        if self._trip(message.reason, by, lock):
            self._tell_decided(message.by, order, "ordered")
            self._stops.append(Waiting(self._state.epoch, deferred, message.lock))
            return deferred
        self._tell_decided(message.by, order, "nothing to do")
        if self._is_being_made_safe:
            self._stops.append(Waiting(self._state.epoch, deferred, message.lock))
            return deferred
        return self._report_now(message.reason)

    def _report_now(self, reason: Reason) -> StopReport:
        """Return the report for ``reason`` when no stop has to be ordered.

        Two kinds of robots are confirmed as stopped: a robot with nothing energised, and an armed robot if
        ``reason`` only requires a hold. For any other robot, return the report of the last stop if that is still
        valid, and otherwise a report without a confirmation.
        """
        state, safe_state = self._state, self._driver.fallbacks[reason]
        if state.mode in failsafe.SAFE or (state.mode is Mode.ARMED and reason in HOLDING_REASONS):
            return StopReport(reason, safe_state, state.epoch, True, ())
        if self._last_stop is not None and self._report_stands:
            return self._last_stop
        problem = self._connect_error or f"the robot is {state.mode}"
        return StopReport(reason, safe_state, state.epoch, False, not_reached(self._driver, problem))

    def _safety(self) -> StopReport | Deferred:
        """Return the report of the last stop (``_report_now``). If a stop is not reported yet, reply when it is."""
        if self._is_being_made_safe:
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
            reason: The reason, for programs.
            cause: The reason, for people.
            lock: Name of the operator that pressed the e-stop; empty for a stop without a lock.
            safe_state: The safe state; None for the one that the driver declares for this reason.
            rank: Rank of the cause; None for the usual rank of the reason.
            lapse: How the command ended, if no stop or fault ended it.

        Returns:
            False if the failsafe machine has nothing to do.
        """
        safe_state = SafeState(safe_state or self._driver.fallbacks[reason])
        if reason in ORDERED and self._is_being_made_safe:
            safe_state = safe_state.or_more(self._ordered.cut_short)
        if reason in failsafe.ENDING_REASONS:
            event = Event.END
        elif reason in HOLDING_REASONS and self._driver.energised(safe_state):
            event = Event.HOLD
        else:
            event = Event.STOP
        # The lost link has already ordered a safe state. A hold must not replace it by a milder one.
        if event is Event.HOLD and self._state.mode is Mode.LOST:
            safe_state = safe_state.or_more(self._driver.fallbacks[Reason.LINK])
        return self._step(event, safe_state, reason, cause, lock, rank, lapse)

    def _trip_again(self, reason: Reason) -> None:
        """Order the safe state once more, and keep the present cause."""
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
            # A hold after a lost link keeps the lost link as the cause.
            if event is not Event.HOLD or before.mode is not Mode.LOST:
                self._blame(cause, reason, rank_of(reason) if rank is None else rank, lapse)
            self._live = None
            self._report_stands = False
            self._ordered = safe_state
            # Send the order to stop before any other message.
            self._transport.tell(MakeSafe(self._state.epoch, safe_state, reason))
            self._refuse_resumes(refusals.resume_stopped(cause))
        if self._state != before:
            self._tell_state()
        return makes_safe

    def _blame(self, text: str, reason: Reason, rank: int, lapse: Lapse = Lapse.NONE) -> None:
        """Set the cause of the stop, unless a more specific cause was found shortly before."""
        now_ns = self.context.received_ns
        present, observation = self._cause, self._observation
        # True if this cause is already set, for example when a lost link comes back.
        goes_on = text == present.text
        faults = present.faults if goes_on else {} if observation is None else dict(observation.faults)
        cause = Cause(text, reason, rank, now_ns + SOON_NS, faults, lapse)
        self._cause = present.or_more_specific(cause, now_ns)

    def _refuse_resumes(self, refusal: Refused) -> None:
        for resume in (*self._resumes, *self._rearming):
            resume.send(refusal.about(RESUME))
        self._resumes.clear()
        self._rearming.clear()

    def _newest_observation(self) -> Observation | Refused:
        """Return the newest observation, or a refusal if it is too old, for example after a lost link."""
        observation = self._observation
        if observation is None:
            return refusals.not_read_yet()
        old_s = (self.context.received_ns - observation.t_ns) / NS
        longest_s = max(self._driver.timing.state_ttl_s, OBSERVATION_S)
        if old_s <= longest_s:
            return observation
        return refusals.stale_reading(old_s, longest_s)

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
        """Order the safe state once more when all unconfirmed motors answer again. For a motor that the robot never
        reports (stamp 0), an observation of the robot counts."""
        stamp_ns = dict(zip(self._driver.axes, observation.stamp_ns, strict=True))
        received_ns = (stamp_ns.get(axis) or observation.t_ns for axis in report.unconfirmed)
        last_received_ns = min(received_ns, default=0)
        if last_received_ns > self._last_stop_ns + _STOP_AGAIN_NS:
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
            self._trip(Reason.FAULT, f"the robot could not hold: {message.hold_failed}")
        else:
            self._advance(Event.SAFE_CONFIRMED if report.confirmed else Event.SAFE_UNCONFIRMED)
            observation = message.observation or self._observation
            if self._state.mode is Mode.HOLDING and observation is not None:
                self._aim_at_held(report, observation)
        self._rearm()

    def _answer_stops(self) -> None:
        """Reply to each order of a stop that is done.

        A stop is done when the wire has reported it. For an e-stop, its lock must also be on the disk. The reply
        contains the first report after the order, since a later report may be of a milder stop.
        """
        waiting, self._stops = self._stops, []
        for stop in waiting:
            report = stop.report or self._last_stop
            if report is None or stop.epoch > report.epoch:
                self._stops.append(stop)
            elif stop.locks and stop.epoch > self._lock.epoch:
                self._stops.append(stop._replace(report=report))
            elif stop.locks and self._lock.problem:
                stop.reply.send(msgspec.structs.replace(report, note=self._lock.problem))
            elif stop.releases:
                stop.reply.send(Released(True, report))
            else:
                stop.reply.send(report)

    def _answer_resume(self, message: Resume) -> Resumed | Refused | Deferred:
        answer = self._resume(message)
        if isinstance(answer, Refused):
            answer = answer.about(RESUME)
        how = "ordered" if isinstance(answer, Deferred) else "armed already"
        self._tell_decided(message.by, RESUME, answer if isinstance(answer, Refused) else how)
        return answer

    def _resume(self, message: Resume) -> Resumed | Refused | Deferred:
        if 0 < message.requested_ns < self._stopped_ns:
            return refusals.stopped_since_resume()
        if self._state.mode in failsafe.WRITABLE and self._observation is not None:
            return self._resume_armed()
        if self._state.locked_by and not message.lift:
            return refusals.resume_locked_out(self._state.locked_by)
        refusal = self._begin_to_arm(message.lift)
        if refusal is not None:
            return refusal
        deferred = self.context.defer()
        self._resumes.append(deferred)
        return deferred

    def _begin_to_arm(self, lifts: bool = False) -> Refused | None:
        mode = self._state.mode
        if self._no_standby and (mode, Event.RESUME) in failsafe.TRANSITIONS:
            return refusals.no_standby(self._no_standby)
        action = self._advance(Event.RESUME)
        if action is not Action.ARM:
            if mode in failsafe.OVER:
                return refusals.ending(self._cause.text)
            if mode not in failsafe.LINKED:
                return refusals.not_connected(self._connect_error)
            return refusals.busy_for_resume(mode)
        self._transport.tell(Arm(self._state.epoch, lifts))
        return None

    def _resume_armed(self) -> Resumed | Refused | Deferred:
        """Reply to a resume of an armed robot. If a condition (a check of the robot's state) fails that passes
        again after arming, stop the robot and arm it again."""
        observation = self._newest_observation()
        if isinstance(observation, Refused):
            return observation
        broken = self._admission.broken_for_resume(observation, self.context.received_ns)
        if broken is None:
            return Resumed(self._state.epoch, observation)
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
        """Arm the robot after the stop that ``_resume_armed`` ordered, if that stop is confirmed."""
        if not self._rearming or self._state.mode is Mode.STOPPING:
            return
        if self._state.mode is not Mode.DISARMED:
            report = self._last_stop
            self._refuse_resumes(refusals.stop_unconfirmed(report.unconfirmed if report else ()))
            return
        refusal = self._begin_to_arm()
        if refusal is not None:
            self._refuse_resumes(refusal)
            return
        self._resumes, self._rearming = [*self._resumes, *self._rearming], []

    def _arm_done(self, message: ArmDone) -> None:
        if message.epoch != self._state.epoch or self._state.mode is not Mode.ARMING:
            # A stop came before the arming was done.
            return
        if message.observation is None:
            cause = f"arming failed: {message.error}"
            self._step(Event.ARM_FAILED, self._driver.fallbacks[Reason.STOP], Reason.FAULT, cause)
            return
        self._last_cause, self._cause = self._cause.text or self._last_cause, Cause()
        self._report_stands = False
        self._advance(Event.ARM_DONE)
        self._aim_at_measured(message.observation)
        for resume in self._resumes:
            resume.send(Resumed(self._state.epoch, message.observation))
        self._resumes.clear()

    def _aim_at_measured(self, observation: Observation) -> None:
        """Use the measured position as the target from which the next command starts, so that the robot does not
        jump."""
        self._observation = observation
        self._target = self._driver.first_target(observation)
        self._target_ns = self.context.received_ns
        self._live = None

    def _aim_at_held(self, report: StopReport, observation: Observation) -> None:
        before = self._target
        self._aim_at_measured(observation)
        self._target = target_after_hold(self._driver, report, before, self._target)

    # -- the link to the robot, and the state of the gate

    def _link_up(self, message: LinkUp) -> None:
        self._facts = dict(message.facts)
        self._connect_error = ""
        self._observation = message.observation
        cause = self._cause if self._cause.text else Cause("the link was lost", rank=Rank.LINK)
        safe_state = self._driver.fallbacks[Reason.LINK]
        self._step(Event.LINK_UP, safe_state, Reason.LINK, cause.text, rank=cause.rank, lapse=cause.lapse)
        stop = self._last_stop
        if self._state.mode is Mode.DISARMED and stop is not None and not stop.confirmed:
            # The stop was ordered while the robot was not connected, so order it again.
            self._trip_again(stop.reason)

    def _link_lost(self, reason: str) -> None:
        self._connect_error = reason
        if self._state.mode in failsafe.LINKED:
            self._blame(f"the link was lost: {reason}", Reason.LINK, Rank.LINK)
        self._live = None
        self._report_stands = False
        self._advance(Event.LINK_LOST)
        self._refuse_resumes(link_lost(reason))

    def _advance(self, event: Event, lock: str = "") -> Action:
        before = self._state
        self._state, action = failsafe.step(before, event, lock)
        if self._state != before:
            self._tell_state()
        return action

    def _tell_state(self) -> None:
        state = self._state
        self._guardian.tell(StateIs(state.mode, state.epoch, state.locked_by, self._present_cause))

    @property
    def _present_cause(self) -> str:
        """Return why the robot is in its present mode; empty if it is armed. A setpoint arms a robot that holds,
        and the gate keeps the cause of the hold for the refusals of older commands."""
        return "" if self._state.mode in (Mode.ARMING, Mode.ARMED) else self._cause.text

    def _status(self) -> Status:
        observation = self._observation
        age_s = -1.0 if observation is None else (self.context.received_ns - observation.t_ns) / NS
        return Status(
            self._state.mode,
            self._state.epoch,
            self._state.mode in failsafe.LINKED,
            self._connect_error,
            self._state.locked_by,
            self._present_cause,
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
            self._cause.text or self._last_cause,
            dict(self._refused),
            self._setpoints,
            tuple(self._intervals.counts),
            self._intervals.total_s,
        )

    def _no_motion(self) -> Refused | None:
        refusal = self._admission.refuse_motion(self._snapshot(), self.context.received_ns)
        return None if refusal is None else refusal.about(MOVE)

    # -- memory for recordings and replays

    def memory(self) -> GateMemory:
        return GateMemory(**{name: getattr(self, f"_{name}") for name in GateMemory.__struct_fields__})

    def recall(self, memory: GateMemory) -> None:
        """Restore the state of the gate from a recording, for a replay."""
        for name in GateMemory.__struct_fields__:
            setattr(self, f"_{name}", getattr(memory, name))
