"""Decide whether the gate accepts a setpoint or a service, and why not.

Pure: the gate passes in its state (``Known``) and the time. The checks of a setpoint run in the order
in which a person would want to read them, since the first that fails is the answer:

    mode          an e-stop, a tree that ends, no link, a robot that is not armed
    lease, epoch  another writer, or a command from before the last stop
    deadline      a command that is too late, or lies too far ahead
    conditions    of the robot: battery, a fault, a mode of its controller
    axes          names and values that the driver can read
    gates         limits of the driver: range, speed, step
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.contract.driver import Condition, Driver, GateState, Live, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import MOVE, Perform, Setpoint

from . import failsafe
from .failsafe import Mode
from .lease import Leases, refuse_by_deadline

_BUSY = Refused(Code.BUSY, "another service is under way", "wait until it is done")


class Known(NamedTuple):
    """The state of the gate on which a decision depends."""

    state: failsafe.State
    leases: Leases
    cause: str  # why the robot is in this state
    reason: Reason | None  # the reason of that cause
    connect_error: str
    observation: Observation | None
    target: tuple[float, ...]
    target_ns: int  # when the target was accepted
    live: Live | None
    in_service: bool  # a service of the driver is running


class Admitted(NamedTuple):
    """A setpoint that may go to the wire.

    Attributes:
        values: The target of every axis, in the driver's order.
        until_ns: When the motion that it starts has to end; 0 if it ends with the lease.
        deadline_ns: Latest time at which it may be written.
    """

    values: tuple[float, ...]
    until_ns: int
    deadline_ns: int


class Admission:
    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def setpoint(self, message: Setpoint, known: Known, now_ns: int) -> Admitted | Refused:
        """Return the setpoint for the wire, or a refusal."""
        answer = self._setpoint(message, known, now_ns)
        return answer.about(MOVE) if isinstance(answer, Refused) else answer

    def _setpoint(self, message: Setpoint, known: Known, now_ns: int) -> Admitted | Refused:
        """As ``setpoint``, without the verb in a refusal. The order of the checks is at the top."""
        refusal = (
            self._refuse_by_mode(known)
            or _refuse_by_lease(message, known)
            or refuse_by_deadline(message.deadline_ns, now_ns)
            or self._refuse_latched(message)
        )
        if refusal is not None:
            return refusal
        observation = known.observation
        if observation is None:
            return Refused(Code.NO_OBSERVATION, "nothing was read yet", "wait for the first observation")
        if known.in_service:
            return Refused(Code.BUSY, "one of the robot's own services is under way", "wait until it is done")
        broken = self.broken_condition(observation, now_ns)
        if broken is not None:
            return broken[1]
        state = GateState(
            now_ns,
            observation,
            known.target,
            known.target_ns,
            message.period_s > 0,
            message.period_s,
            known.live,
        )
        candidate = self._driver.parse(message.action, state)
        if isinstance(candidate, Refused):
            return candidate
        for gate in self._driver.gates:
            refusal = gate(candidate, state)
            if refusal is not None:
                return refusal
        until_ns = 0 if message.latched else message.deadline_ns
        if candidate.until_ns:
            until_ns = min(until_ns or candidate.until_ns, candidate.until_ns)
        return Admitted(candidate.values, until_ns, min(message.deadline_ns, until_ns or message.deadline_ns))

    def service(self, message: Perform, known: Known, now_ns: int) -> Refused | None:
        """Return a refusal of a service of the driver, or None. A service that moves the robot is
        refused whenever a setpoint would be refused."""
        refusal = self._refuse_service(message, known, now_ns)
        return None if refusal is None else refusal.about(message.service)

    def _refuse_service(self, message: Perform, known: Known, now_ns: int) -> Refused | None:
        service, state = message.service, known.state
        refusal = self._driver.check_service(service, message.arguments)
        if refusal is not None:
            return refusal
        if self._driver.SERVICES[service].acts:
            return Refused(Code.A_COMMAND, "it is a command", "send its arguments as an action")
        if state.locked_by:
            return Refused(Code.LOCKED_OUT, f"e-stopped by {state.locked_by}", "resume() lifts the lockout")
        if state.mode in failsafe.OVER:
            return refuse_at_the_end(known.cause)
        if state.mode not in failsafe.LINKED:
            return Refused(Code.NOT_CONNECTED, f"not connected: {known.connect_error}")
        if state.mode in (Mode.ARMING, Mode.STOPPING):
            return Refused(Code.BUSY, f"the robot is {state.mode}", "try again when that is over")
        refusal = _refuse_by_lease(message, known)
        if refusal is not None:
            return refusal
        refusal = self._refuse_by_mode(known) if self._driver.SERVICES[service].needs_armed else None
        if refusal is not None:
            return refusal
        what = self._driver.SERVICES[service]
        moves = known.live is not None or message.first is not None
        if moves and not (what.in_motion or what.ends_motion):
            return Refused(Code.LIVE, "the robot is being moved", "wait until that is over, or call stop()")
        if what.ends_motion and known.in_service:
            return _BUSY
        return self._refuse_to_move(known, now_ns) if what.moves else None

    def _refuse_to_move(self, known: Known, now_ns: int) -> Refused | None:
        if known.in_service:
            return _BUSY
        if known.observation is None:
            return Refused(Code.NO_OBSERVATION, "nothing was read yet", "wait for the first observation")
        return self.refuse_motion(known, now_ns)

    def refuse_motion(self, known: Known, now_ns: int) -> Refused | None:
        """Return the refusal that any setpoint would get now, by the mode or by a condition of the robot;
        None if there is none."""
        refusal = self._refuse_by_mode(known)
        if refusal is not None or known.observation is None:
            return refusal
        broken = self.broken_condition(known.observation, now_ns)
        return None if broken is None else broken[1]

    def broken_condition(
        self, observation: Observation, now_ns: int, only_always: bool = False
    ) -> tuple[Condition, Refused] | None:
        """Return the first condition of the robot that is broken, and its refusal.

        Args:
            observation: The newest observation.
            now_ns: The time.
            only_always: Check only the conditions that hold while no target is live.
        """
        for condition in self._driver.conditions:
            if condition.always or not only_always:
                refusal = condition.check(observation, now_ns)
                if refusal is not None:
                    return condition, refusal
        return None

    def broken_for_resume(self, observation: Observation, now_ns: int) -> tuple[Condition, Refused] | None:
        """Return the condition that keeps an armed robot from continuing, and its refusal.

        A condition that a person has to mend comes first, then the first one that arming mends.
        """
        broken = [
            (condition, refusal)
            for condition in self._driver.conditions
            if condition.on_resume is not OnResume.STAY_ARMED
            and (refusal := condition.check(observation, now_ns)) is not None
        ]
        by_hand = (each for each in broken if each[0].on_resume is OnResume.REFUSE)
        return next(by_hand, broken[0] if broken else None)

    def _refuse_by_mode(self, known: Known) -> Refused | None:
        mode = known.state.mode
        if known.state.locked_by:
            why = f"e-stopped by {known.state.locked_by}"
            return Refused(Code.LOCKED_OUT, why, "resume() lifts the lockout")
        if mode in failsafe.WRITABLE:
            return None
        if mode in failsafe.OVER:
            return refuse_at_the_end(known.cause)
        if mode not in failsafe.LINKED:
            why = "the restart budget is spent" if mode is Mode.FAILED else known.connect_error
            return Refused(Code.NOT_CONNECTED, f"not connected: {why}", "call connect_eagerly() first")
        if mode is Mode.ARMING:
            return Refused(Code.ARMING, "the robot is being energised", "try again when it is armed")
        cause = f" ({known.cause})" if known.cause else ""
        # FAULTED tells a program that the robot ended its motion, and not a person's stop.
        code = Code.FAULTED if known.reason == Reason.FAULT else Code.DISARMED
        why = f"the robot is {mode}{cause}"
        return Refused(code, why, "call resume() first", because=str(known.reason or ""))

    def _refuse_latched(self, message: Setpoint) -> Refused | None:
        """Refuse a latched command to a robot that would move on by it: a base, a drone, legs."""
        longest_s = self._driver.timing.oneshot_ttl_s
        if not message.latched or longest_s is None:
            return None
        why = f"{self._driver.robot} takes no command without an end"
        return Refused(Code.LATCHED, why, f"give it a lifetime, {longest_s:g} s", "latched", f"{longest_s:g} s")


def refuse_at_the_end(cause: str) -> Refused:
    """Return the refusal of every command to a tree that ends."""
    return Refused(Code.ENDING, f"the tree of this robot ends ({cause})", "start it again")


def _refuse_by_lease(message: Setpoint | Perform, known: Known) -> Refused | None:
    refusal = known.leases.refuse(message.lease, message.channel)
    if refusal is None and message.epoch != known.state.epoch:
        cause = f" ({known.cause})" if known.cause else ""
        return Refused(
            Code.STALE_EPOCH,
            f"prepared in epoch {message.epoch}, now it is {known.state.epoch}{cause}",
            "send it again",
            str(message.epoch),
            str(known.state.epoch),
            because=str(known.reason or ""),
        )
    return refusal
