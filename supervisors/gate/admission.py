"""Decide whether the gate accepts a setpoint or a service of the driver, and give the reason if not.

Pure: the gate passes in its state (``GateSnapshot``) and the time. The first check that fails gives the refusal. So
the checks of a setpoint are in the order that helps a person most:

    mode          an e-stop, processes that are being ended, no link, a robot that is not armed
    lease, epoch  another writer has the lease, or the command was made before the last stop
    deadline      the deadline has passed, or is too far ahead
    conditions    a check of the robot's state has failed: battery, a fault, a mode of its controller
    axes          the driver does not know a name, or cannot read a value
    gates         a limit of the driver: range, speed, step
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.contract.driver import Condition, Driver, GateState, Live, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import MOVE, Perform, Setpoint

from . import failsafe, refusals
from .failsafe import Mode
from .lease import Leases, refuse_by_deadline


class GateSnapshot(NamedTuple):
    """The part of the gate's state on which the answer to a setpoint or a service depends."""

    state: failsafe.State
    leases: Leases
    cause: str  # why the robot is in this mode, for people
    reason: Reason | None  # the same as ``Reason``; None if there is no cause
    connect_error: str
    observation: Observation | None
    target: tuple[float, ...]
    target_ns: int  # time at which the gate accepted the target
    live: Live | None
    in_service: bool  # a service of the driver is running


class Admitted(NamedTuple):
    """A setpoint that the gate has accepted, for the process that writes to the robot.

    Attributes:
        values: The target of every axis, in the driver's order.
        until_ns: When the motion that it starts has to end; 0 if it ends with its writer's lease (right to
            command).
        deadline_ns: Latest time at which it may be written.
    """

    values: tuple[float, ...]
    until_ns: int
    deadline_ns: int


class Admission:
    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def setpoint(self, message: Setpoint, snapshot: GateSnapshot, now_ns: int) -> Admitted | Refused:
        """Return the setpoint for the wire, or a refusal."""
        answer = self._setpoint(message, snapshot, now_ns)
        return answer.about(MOVE) if isinstance(answer, Refused) else answer

    def _setpoint(self, message: Setpoint, snapshot: GateSnapshot, now_ns: int) -> Admitted | Refused:
        """Return the setpoint to write to the robot, or a refusal that does not yet name the refused operation.
        The module explains the order of checks."""
        refusal = (
            self._refuse_by_mode(snapshot)
            or _refuse_by_lease(message, snapshot)
            or refuse_by_deadline(message.deadline_ns, now_ns)
            or self._refuse_latched(message)
        )
        if refusal is not None:
            return refusal
        observation = snapshot.observation
        if observation is None:
            return refusals.not_read_yet()
        if snapshot.in_service:
            return refusals.running_service()
        broken = self.broken_condition(observation, now_ns)
        if broken is not None:
            return broken[1]
        state = GateState(
            now_ns,
            observation,
            snapshot.target,
            snapshot.target_ns,
            message.period_s > 0,
            message.period_s,
            snapshot.live,
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

    def service(self, message: Perform, snapshot: GateSnapshot, now_ns: int) -> Refused | None:
        """Return a refusal for a service of the driver; None if it may run.

        A service that moves the robot is refused whenever a setpoint would be refused. A service that energises the
        robot is refused until a resume has armed it.
        """
        refusal = self._refuse_service(message, snapshot, now_ns)
        return None if refusal is None else refusal.about(message.service)

    def _refuse_service(self, message: Perform, snapshot: GateSnapshot, now_ns: int) -> Refused | None:
        service, state = message.service, snapshot.state
        refusal = self._driver.check_service(service, message.arguments)
        if refusal is not None:
            return refusal
        if self._driver.SERVICES[service].acts:
            return refusals.command_as_service()
        if state.locked_by:
            return refusals.locked_out(state.locked_by)
        if state.mode in failsafe.OVER:
            return refusals.ending(snapshot.cause)
        if state.mode not in failsafe.LINKED:
            return refusals.not_connected(snapshot.connect_error)
        if state.mode in (Mode.ARMING, Mode.STOPPING):
            return refusals.busy_for_service(state.mode)
        refusal = _refuse_by_lease(message, snapshot)
        if refusal is not None:
            return refusal
        declared = self._driver.SERVICES[service]
        # Only a resume arms a robot. So a service that energises is refused on a stopped robot, as a setpoint is.
        refusal = self._refuse_by_mode(snapshot) if declared.arms(message.arguments) else None
        if refusal is not None:
            return refusal
        moves = snapshot.live is not None or message.first is not None
        if moves and not (declared.in_motion or declared.ends_motion):
            return refusals.in_motion()
        if declared.ends_motion and snapshot.in_service:
            return refusals.other_running_service()
        return self._refuse_to_move(snapshot, now_ns) if declared.moves else None

    def _refuse_to_move(self, snapshot: GateSnapshot, now_ns: int) -> Refused | None:
        if snapshot.in_service:
            return refusals.other_running_service()
        if snapshot.observation is None:
            return refusals.not_read_yet()
        return self.refuse_motion(snapshot, now_ns)

    def refuse_motion(self, snapshot: GateSnapshot, now_ns: int) -> Refused | None:
        """Return the refusal that every setpoint would get now, because of the failsafe mode, or of a failed check
        of the robot's state (its conditions). Return None if setpoints are possible."""
        refusal = self._refuse_by_mode(snapshot)
        if refusal is not None or snapshot.observation is None:
            return refusal
        broken = self.broken_condition(snapshot.observation, now_ns)
        return None if broken is None else broken[1]

    def broken_condition(
        self, observation: Observation, now_ns: int, only_always: bool = False
    ) -> tuple[Condition, Refused] | None:
        """Return the first condition (a check of the robot's state, declared by its driver) that fails, with its
        refusal. None if all conditions pass.

        Args:
            observation: The newest observation.
            now_ns: The time.
            only_always: True to check only the conditions that must also pass while no setpoint is in force.
        """
        for condition in self._driver.conditions:
            if condition.always or not only_always:
                refusal = condition.check(observation, now_ns)
                if refusal is not None:
                    return condition, refusal
        return None

    def broken_for_resume(self, observation: Observation, now_ns: int) -> tuple[Condition, Refused] | None:
        """Return the failed condition (a check of the robot's state) because of which an armed robot may not
        continue, with its refusal; None if it may continue.

        A condition that only a person can repair comes before one that arming again repairs.
        """
        broken = [
            (condition, refusal)
            for condition in self._driver.conditions
            if condition.on_resume is not OnResume.STAY_ARMED
            and (refusal := condition.check(observation, now_ns)) is not None
        ]
        by_hand = (each for each in broken if each[0].on_resume is OnResume.REFUSE)
        return next(by_hand, broken[0] if broken else None)

    def _refuse_by_mode(self, snapshot: GateSnapshot) -> Refused | None:
        mode = snapshot.state.mode
        if snapshot.state.locked_by:
            return refusals.locked_out(snapshot.state.locked_by)
        if mode in failsafe.WRITABLE:
            return None
        if mode in failsafe.OVER:
            return refusals.ending(snapshot.cause)
        if mode not in failsafe.LINKED:
            if mode is Mode.FAILED:
                return refusals.restarts_spent()
            return refusals.not_connected_for_motion(snapshot.connect_error)
        if mode is Mode.ARMING:
            return refusals.arming()
        # With FAULTED, a program can see that the robot itself ended its motion. After a person's stop the code is
        # DISARMED.
        code = Code.FAULTED if snapshot.reason == Reason.FAULT else Code.DISARMED
        return refusals.not_armed(code, mode, snapshot.cause, str(snapshot.reason or ""))

    def _refuse_latched(self, message: Setpoint) -> Refused | None:
        """Refuse a latched command (without an end) to a robot that would not stop by itself: a base, a drone,
        legs."""
        longest_s = self._driver.timing.oneshot_ttl_s
        if not message.latched or longest_s is None:
            return None
        return refusals.latched(self._driver.robot, longest_s)


def _refuse_by_lease(message: Setpoint | Perform, snapshot: GateSnapshot) -> Refused | None:
    refusal = snapshot.leases.refuse(message.lease, message.channel)
    if refusal is None and message.epoch != snapshot.state.epoch:
        because = str(snapshot.reason or "")
        return refusals.stale_epoch(message.epoch, snapshot.state.epoch, snapshot.cause, because)
    return refusal
