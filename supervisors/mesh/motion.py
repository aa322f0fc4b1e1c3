"""Carry out motions for senders on the mesh: a named policy, a pose, and steps or a reset of a simulation.

For the duration of a motion, the root keeps a lease for the sender, so the sender need not stay connected. A motion
passes the same gate as every setpoint. On a real robot the operator must have allowed it beforehand, since nobody
can be asked over the mesh. It ends after its duration, and every stop ends it earlier. A policy runs in a separate
process, as it does for a local program.

How a motion ends (``_beat``): after its duration, or when its policy has done its last step, this process makes the
robot hold (``_hold``) and then releases the lease. This is the planned end, so the next command from the mesh needs
no resume. If a stop or another writer's lease ends the motion, this process does not make the robot hold.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.actor import Context
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.guard import not_approved, unapproved
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate import messages
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.lease import refuse_by_deadline
from strands_actors.supervisors.root.messages import Rollout, StartTask, StopTask, TaskStatus

from . import refusals
from . import schemas as mesh_json
from .command_rules import Shared
from .lease_rules import refuse_by_mode
from .policy_choice import choose

ASK_S = 0.1
START_S = 2.0
"""How long the start of a policy process may take."""
BEAT_S = 0.05
"""Period of heartbeats. Within this time after a stop, the robot is also free for other senders."""
LOOK_S = 0.02
"""Period of the check if a rollout has ended."""
_OVER_BY_ITSELF = (Lapse.EXPIRED, Lapse.ROLLOUT_ENDED)
"""Lapses by which a motion may end shortly before this process holds the robot."""
NO_OPERATOR = "on the mesh no operator can be asked"

Answer = Callable[[dict[str, Any] | Refused, bool], None]
"""Sends a result to the sender. The second argument is True for the final answer."""


class Motion:
    """Carry out the motions of one robot.

    Args:
        robot: Name of the robot.
        driver: Driver of the robot.
        context: The context of the actor that serves the commands.
        task: Returns the status of the robot's policy process.
        shared: State that the actors on the mesh share.
    """

    def __init__(
        self,
        robot: str,
        driver: Driver,
        context: Context,
        task: Callable[[], TaskStatus],
        shared: Shared,
    ) -> None:
        actors = addresses.of(robot)
        self._robot = robot
        self._driver = driver
        self._context = context
        self._gate: Ref = context.ref(actors.gate, Gate)
        self._tasks: Ref = context.node.ref(actors.tasks)
        self._task = task
        self._shared = shared
        self._stop_s = StopDeadlines.of(driver.timing.safe_s, driver.late_s).gate_s
        self._turn = trio.Lock()
        self._kept: messages.Lease | None = None
        self._keeper = ""
        """Name of the sender for which the lease ``_kept`` is kept."""
        self._free = trio.Event()
        """Set while no lease is kept and the last one was released."""
        self._free.set()
        self._until_ns = 0
        """Time at which the motion ends; 0 if it ends with the policy."""
        self._is_ending = False
        """True while the robot is brought to a hold at the end of a motion."""

    async def do(self, sender: str, own: messages.Lease | None, command: mesh_json.Motion, answer: Answer) -> None:
        """Carry out a motion and answer.

        Args:
            sender: The sender.
            own: The lease that the sender has acquired by ``acquire``; None without one.
            command: The command.
            answer: Sends the result. ``Execute`` is answered twice, when the policy starts and when it ends.
        """
        try:
            async with self._turn:
                result = self._refuse(command) or await self._do(sender, own, command)
        except (AskTimeout, Unreachable) as failure:
            result = busy.with_load(refusals.silent_wire(failure))
        if isinstance(result, Refused):
            answer(result.about(command.action), True)
        elif isinstance(command, mesh_json.Execute):
            answer({"within_s": command.duration + START_S + self._stop_s, **result}, False)
            answer(await self._ended(), True)
        else:
            answer(result, True)

    def kept_for(self, sender: str) -> int:
        """Return the number of the lease that this process keeps for a motion of this sender; 0 without one."""
        return self._kept.id if self._kept is not None and self._keeper == sender else 0

    def forget(self, sender: str) -> None:
        """Stop keeping a lease for a sender, since the sender has acquired a new one and sends the heartbeats
        itself."""
        if self._keeper == sender:
            self._kept = None

    # -- checks before a motion begins

    def _refuse(self, command: mesh_json.Motion) -> Refused | None:
        driver, action = self._driver, command.action
        # The command may have waited for an earlier motion, so its deadline may have passed.
        late = refuse_by_deadline(command.deadline_ns, self._context.clock.now_ns())
        if late is not None:
            return late
        keys: tuple[str, ...] = ()
        match command:
            case mesh_json.Start():
                if reason := driver.ROLLOUTS or driver.TASKS:
                    return refusals.no_rollout(driver.robot, reason)
                keys = driver.axes
            case mesh_json.SetJoints():
                longest_s = driver.timing.oneshot_ttl_s
                if longest_s is not None and command.duration > longest_s:
                    return refusals.too_long(driver.robot, command.duration, longest_s)
                keys = driver.to_approve(command.target_joints)
            case _ if action not in driver.SERVICES:
                return refusals.no_simulation(driver.robot)
        if driver.SIMULATED:
            return None
        names = unapproved({action, *driver.GUARDED}, (action, *keys), driver.TOPICS)
        return not_approved(names, NO_OPERATOR, can_ask=False) if names else None

    async def _do(
        self, sender: str, own: messages.Lease | None, command: mesh_json.Motion
    ) -> dict[str, Any] | Refused:
        if isinstance(command, mesh_json.Start):
            return await self._start(sender, own, command)
        lease = await self._lease(sender, own)
        if isinstance(lease, Refused):
            return lease
        match command:
            case mesh_json.SetJoints():
                return await self._pose(lease, sender, own, command)
            case mesh_json.Step():
                return await self._simulate(lease, sender, own, "step", {"steps": command.steps})
        return await self._reset(lease, sender, own)

    # -- the lease of a motion: acquire, keep and release it

    async def _lease(self, sender: str, own: messages.Lease | None) -> messages.Lease | Refused:
        """Return the lease for a motion: the sender's own lease, the one that is kept for it, or a new one."""
        status = await self._gate.ask(messages.GetStatus(), ASK_S)
        if not isinstance(status, messages.Status):
            return no_answer(status)
        refused = refuse_by_mode(status, self._shared.resumed_epoch) or status.no_motion
        if refused is not None:
            return refused
        if self._task().running:
            return refusals.policy_running()
        if own is not None and status.holder == holder_of(sender) and own.epoch == status.epoch:
            return own
        if self._kept is not None and self._keeper == sender and self._kept.epoch == status.epoch:
            return self._kept
        again = self.kept_for(sender) or (0 if own is None else own.id)
        answer = await self._gate.ask(messages.Acquire(holder_of(sender), again=again), messages.GRANT_S)
        return answer if isinstance(answer, messages.Lease | Refused) else no_answer(answer)

    def _keep(self, lease: messages.Lease, sender: str, own: messages.Lease | None, for_s: float) -> None:
        """Send heartbeats for the lease of a motion for ``for_s`` seconds; 0 means until the policy has ended. Do
        nothing for the sender's own lease, since the sender sends its heartbeats."""
        if lease == own:
            return
        until_ns = self._context.clock.now_ns() + round(for_s * NS) if for_s else 0
        is_new = self._kept != lease
        self._free = trio.Event()
        self._kept, self._keeper, self._until_ns = lease, sender, until_ns
        if is_new:
            self._context.start_soon(self._beat, lease)

    async def _beat(self, lease: messages.Lease) -> None:
        """Send heartbeats for a lease until its motion has ended, the robot is stopped, or the lease is replaced.
        Then release the lease."""
        due_ns = 0
        while self._kept == lease:
            now_ns = self._context.clock.now_ns()
            is_due = now_ns >= due_ns
            goes_on = self._is_running() and (not is_due or await self._is_of_now(lease))
            if not goes_on and await self._end(lease):
                break
            if is_due:
                self._gate.tell(messages.Beat(lease.id))
                due_ns = now_ns + round(BEAT_S * NS)
            await trio.sleep(min(BEAT_S, self._remaining_s()))
        if self._kept == lease:
            self._kept = None
        await self._give_up(lease)
        if self._kept is None:
            self._free.set()

    async def _end(self, lease: messages.Lease) -> bool:
        """Make the robot hold at the end of a motion, unless it has stopped already. Return False if the sender has
        meanwhile begun another motion under this lease.

        The next command waits until the robot holds, since it would be refused before.
        """
        async with self._turn:
            if self._kept == lease and self._is_running() and await self._is_of_now(lease):
                return False
            if self._kept == lease and (self._until_ns or self._task().exit_reason in ("duration", "n_steps")):
                self._is_ending = True
                await self._hold(lease)
                self._is_ending = False
            return True

    async def wait_for_hold(self) -> None:
        """Wait until the hold at the end of a motion is done."""
        if self._is_ending:
            async with self._turn:
                pass

    async def _hold(self, lease: messages.Lease) -> None:
        """Make the robot hold because the duration of a motion has passed. The next command from the mesh then
        needs no resume. If another writer has begun a motion meanwhile, do nothing."""
        by = holder_of(self._keeper)
        try:
            status = await self._status()
            if status is None or status.holder != by or self._kept != lease:
                return
            if status.epoch == lease.epoch + 1 and status.lapse in _OVER_BY_ITSELF:
                # The motion ended by itself before this process could order the hold. This is a planned end, too.
                self._shared.resumed_epoch = status.epoch
            if status.epoch != lease.epoch:
                return
            report = await self._gate.ask(messages.Stop(Reason.EXPIRED, by), self._stop_s)
        except (AskTimeout, Unreachable):
            # The gate did not answer. The setpoint ends by itself, and then the robot must be resumed.
            return
        if isinstance(report, messages.StopReport) and report.epoch == lease.epoch + 1:
            self._shared.resumed_epoch = report.epoch

    async def _is_of_now(self, lease: messages.Lease) -> bool:
        """Return False if the robot has stopped or held since the lease was given, which has ended the motion.
        Return True if the gate does not answer in time."""
        try:
            status = await self._status()
        except (AskTimeout, Unreachable):
            return True
        return status is None or status.epoch == lease.epoch

    async def _status(self) -> messages.Status | None:
        answer = await self._gate.ask(messages.GetStatus(), ASK_S)
        return answer if isinstance(answer, messages.Status) else None

    def _is_running(self) -> bool:
        return self._task().running if not self._until_ns else self._remaining_s() > 0

    def _remaining_s(self) -> float:
        """Return the seconds until the motion ends. For a policy the end is not known, so return ``LOOK_S``."""
        return max(0.0, (self._until_ns - self._context.clock.now_ns()) / NS) if self._until_ns else LOOK_S

    async def _give_up(self, lease: messages.Lease) -> None:
        """Release a lease, so that the next writer need not wait until it ends by itself."""
        try:
            await self._gate.ask(messages.Release(lease.id), self._stop_s)
        except (AskTimeout, Unreachable):
            return

    # -- motions by a policy (a rollout)

    async def _start(
        self, sender: str, own: messages.Lease | None, command: mesh_json.Start
    ) -> dict[str, Any] | Refused:
        chosen = await choose(self._driver, command, self._robot)
        if isinstance(chosen, Refused):
            return chosen
        location, options = chosen
        lease = await self._lease(sender, own)
        if isinstance(lease, Refused):
            return lease
        timing = self._driver.timing
        period_s = 1.0 / (command.control_frequency or timing.control_hz)
        rollout = Rollout(
            self._robot,
            self._driver.axes,
            command.instruction,
            period_s,
            max(timing.stream_ttl_s, 2 * period_s),
            command.duration,
            command.n_steps,
            lease.id,
            self._driver.table,
        )
        try:
            status = await self._tasks.ask(StartTask(location, options, rollout, command.deadline_ns), START_S)
        except (AskTimeout, Unreachable) as failure:
            # The policy must not start after its start was refused.
            self._tasks.tell(StopTask())
            status = refusals.policy_not_started(failure)
        if not isinstance(status, TaskStatus):
            if lease != own:
                await self._give_up(lease)
            return no_answer(status)
        self._keep(lease, sender, own, 0.0)
        return task_json(status)

    async def _ended(self) -> dict[str, Any]:
        while self._task().running:  # noqa: ASYNC110  # its process reports to another actor
            await trio.sleep(LOOK_S)
        # The lease is free now, so the receiver of this answer can send its next command at once.
        await self._free.wait()
        return task_json(self._task())

    # -- motions to a pose

    async def _pose(
        self, lease: messages.Lease, sender: str, own: messages.Lease | None, command: mesh_json.SetJoints
    ) -> dict[str, Any] | Refused:
        deadline_ns = self._context.clock.now_ns() + round(command.duration * NS)
        setpoint = messages.Setpoint(lease.id, lease.epoch, deadline_ns, command.target_joints)
        answer = await self._gate.ask(setpoint, ASK_S)
        if not isinstance(answer, messages.Accepted):
            if lease not in (own, self._kept):
                await self._give_up(lease)
            return no_answer(answer)
        self._keep(lease, sender, own, command.duration)
        return self._driver.accepted(command.target_joints, answer.values, answer.sensors)

    # -- steps and resets of a simulation

    async def _simulate(
        self,
        lease: messages.Lease,
        sender: str,
        own: messages.Lease | None,
        service: str,
        arguments: dict[str, Any],
    ) -> dict[str, Any] | Refused:
        within_s = self._driver.SERVICES[service].within_s + ASK_S
        async with self._beating(lease):
            perform = messages.Perform(lease.id, lease.epoch, service, arguments)
            answer = await self._gate.ask(perform, within_s)
        if lease not in (own, self._kept):
            await self._give_up(lease)
        return answer.result if isinstance(answer, messages.Performed) else no_answer(answer)

    async def _reset(
        self, lease: messages.Lease, sender: str, own: messages.Lease | None
    ) -> dict[str, Any] | Refused:
        """Stop the robot, reset the simulation, and energise the robot again."""
        by = holder_of(sender)
        report = await self._gate.ask(messages.Stop(Reason.STOP, by), self._stop_s)
        if not isinstance(report, messages.StopReport):
            return no_answer(report)
        if not report.confirmed:
            return refusals.unconfirmed_reset()
        anew = await self._gate.ask(messages.Acquire(by, again=lease.id), messages.GRANT_S)
        if not isinstance(anew, messages.Lease):
            return no_answer(anew)
        result = await self._simulate(anew, sender, None, "reset", {})
        if isinstance(result, Refused):
            return result
        resumed = await self._gate.ask(messages.Resume(by, lift=False), self._driver.timing.arm_s + 2.0)
        return result if isinstance(resumed, messages.Resumed) else no_answer(resumed)

    def _beating(self, lease: messages.Lease) -> _Beating:
        return _Beating(self._gate, lease)


class _Beating:
    """Send heartbeats for a lease while the code in an ``async with`` block waits."""

    def __init__(self, gate: Ref, lease: messages.Lease) -> None:
        self._gate = gate
        self._lease = lease
        self._nursery = trio.open_nursery()

    async def __aenter__(self) -> None:
        self._open = await self._nursery.__aenter__()
        self._open.start_soon(self._beat)

    async def __aexit__(self, *how: Any) -> bool | None:
        self._open.cancel_scope.cancel()
        return await self._nursery.__aexit__(*how)

    async def _beat(self) -> None:
        while True:
            self._gate.tell(messages.Beat(self._lease.id))
            await trio.sleep(BEAT_S)


def holder_of(sender: str) -> str:
    """Return the name under which a sender on the mesh holds a lease, as other callers see it."""
    return f"{mesh_json.plain(sender)} on the mesh"


def no_answer(answer: Message | None) -> Refused:
    """Return the gate's refusal, or a new refusal if the gate's reply has an unexpected type."""
    return answer if isinstance(answer, Refused) else refusals.silent_gate()


def task_json(status: TaskStatus) -> dict[str, Any]:
    """Return the status of a policy in the form of ``get_task_status``."""
    fields: dict[str, Any] = msgspec.structs.asdict(status)
    return {key: value if key in _COUNTED else value or None for key, value in fields.items()}


_COUNTED = ("running", "steps", "elapsed_s", "hz", "instruction")


__all__ = ["NO_OPERATOR", "Motion", "holder_of", "no_answer", "task_json"]
