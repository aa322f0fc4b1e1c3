"""Run motions for senders on the mesh: a named policy, a pose, and steps and a reset of a simulation.

The root acquires a lease for the sender and keeps it for the duration of the motion, so the sender need
not stay connected. A motion passes the same gate as every setpoint. On a real robot the operator must have
allowed it beforehand, since on the mesh there is no operator to ask. It ends by itself after its duration,
and every stop ends it. A policy runs in a separate process, like a task of a local program.

How a motion ends, in ``_beat``: when its time is over, or its rollout has reached its duration or number
of steps, this process holds the robot (``_hold``) and then releases the lease. Such a hold is a regular
end: the next command from the mesh needs no resume. A stop, or another lease in its place, ends the
motion without a hold by this process.
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
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate import messages
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.lease import refuse_by_deadline
from strands_actors.supervisors.root.messages import Rollout, StartTask, StopTask, TaskStatus

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
NOBODY_TO_ASK = "on the mesh there is nobody to ask"

Answer = Callable[[dict[str, Any] | Refused, bool], None]
"""Sends a result to the sender. The second argument is True for the final answer."""


class Motion:
    """The motions of one robot.

    Args:
        robot: Its name.
        driver: Its driver.
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
        at = addresses.of(robot)
        self._robot = robot
        self._driver = driver
        self._context = context
        self._gate: Ref = context.ref(at.gate, Gate)
        self._tasks: Ref = context.node.ref(at.tasks)
        self._task = task
        self._shared = shared
        self._stop_s = StopDeadlines.of(driver.timing.safe_s, driver.late_s).gate_s
        self._turn = trio.Lock()
        self._kept: messages.Lease | None = None
        self._keeper = ""
        """The sender for which ``_kept`` is kept."""
        self._free = trio.Event()
        """Set while no lease is kept and the last one was released."""
        self._free.set()
        self._until_ns = 0
        """When the motion ends; 0: when the rollout ends."""
        self._is_ending = False
        """True while the hold at the end of a motion is carried out."""

    async def do(self, sender: str, own: messages.Lease | None, command: mesh_json.Motion, answer: Answer) -> None:
        """Carry out a motion and answer.

        Args:
            sender: The sender.
            own: The lease that the sender has acquired by ``acquire``; None if it has none.
            command: The command.
            answer: Sends the result. ``Execute`` is answered twice: at the start and at the end.
        """
        try:
            async with self._turn:
                result = self._refuse(command) or await self._do(sender, own, command)
        except (AskTimeout, Unreachable) as failure:
            result = Refused(
                Code.UNREACHABLE,
                busy.explained(f"the wire does not answer: {failure}"),
                "resume when the robot is back",
            )
        if isinstance(result, Refused):
            answer(result.about(command.action), True)
        elif isinstance(command, mesh_json.Execute):
            answer({"within_s": command.duration + START_S + self._stop_s, **result}, False)
            answer(await self._ended(), True)
        else:
            answer(result, True)

    def kept_for(self, sender: str) -> int:
        """Return the lease that is kept for a motion of this sender; 0 if there is no such lease."""
        return self._kept.id if self._kept is not None and self._keeper == sender else 0

    def forget(self, sender: str) -> None:
        """Stop keeping the lease of a sender that has replaced it by a lease which it keeps itself."""
        if self._keeper == sender:
            self._kept = None

    # -- checks

    def _refuse(self, command: mesh_json.Motion) -> Refused | None:
        driver, action = self._driver, command.action
        # The command may have waited for an earlier motion and be past its deadline now.
        late = refuse_by_deadline(command.deadline_ns, self._context.clock.now_ns())
        if late is not None:
            return late
        keys: tuple[str, ...] = ()
        match command:
            case mesh_json.Start():
                if why := driver.ROLLOUTS or driver.TASKS:
                    return Refused(Code.NO_ROLLOUT, f"{driver.robot}: {why}", "")
                keys = driver.axes
            case mesh_json.SetJoints():
                longest_s = driver.timing.oneshot_ttl_s
                if longest_s is not None and command.duration > longest_s:
                    why = f"{driver.robot} keeps no command on its own for {command.duration:g} s"
                    remedy = f"give a duration of at most {longest_s:g} s, or run a policy"
                    return Refused(Code.TOO_LONG, why, remedy, f"{command.duration:g}", f"{longest_s:g}")
                keys = driver.to_approve(command.target_joints)
            case _ if action not in driver.SERVICES:
                why = f"{driver.robot} is no simulation"
                return Refused(Code.NO_SIMULATION, why, "a robot is driven by start, set_joints and move")
        if driver.SIMULATED:
            return None
        names = unapproved({action, *driver.GUARDED}, (action, *keys), driver.TOPICS)
        return not_approved(names, NOBODY_TO_ASK, can_ask=False) if names else None

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

    # -- the lease

    async def _lease(self, sender: str, own: messages.Lease | None) -> messages.Lease | Refused:
        """Return the lease for a motion: the sender's own, one that is already kept for it, or a new one."""
        status = await self._gate.ask(messages.GetStatus(), ASK_S)
        if not isinstance(status, messages.Status):
            return no_answer(status)
        refused = refuse_by_mode(status, self._shared.resumed_epoch) or status.no_motion
        if refused is not None:
            return refused
        if self._task().running:
            return Refused(Code.RUNNING, "a task is already running", "stop it first")
        if own is not None and status.holder == holder_of(sender) and own.epoch == status.epoch:
            return own
        if self._kept is not None and self._keeper == sender and self._kept.epoch == status.epoch:
            return self._kept
        again = self.kept_for(sender) or (0 if own is None else own.id)
        answer = await self._gate.ask(messages.Acquire(holder_of(sender), again=again), messages.GRANT_S)
        return answer if isinstance(answer, messages.Lease | Refused) else no_answer(answer)

    def _keep(self, lease: messages.Lease, sender: str, own: messages.Lease | None, for_s: float) -> None:
        """Keep a lease for ``for_s`` seconds; 0: until the rollout ends. A sender keeps its own lease
        itself."""
        if lease == own:
            return
        until_ns = self._context.clock.now_ns() + round(for_s * NS) if for_s else 0
        is_new = self._kept != lease
        self._free = trio.Event()
        self._kept, self._keeper, self._until_ns = lease, sender, until_ns
        if is_new:
            self._context.start_soon(self._beat, lease)

    async def _beat(self, lease: messages.Lease) -> None:
        """Keep a lease until its motion is over, the robot is stopped, or another lease has replaced it."""
        due_ns = 0
        while self._kept == lease:
            now_ns = self._context.clock.now_ns()
            is_due = now_ns >= due_ns
            goes_on = self._is_wanted() and (not is_due or await self._is_of_now(lease))
            if not goes_on and await self._end(lease):
                break
            if is_due:
                self._gate.tell(messages.Beat(lease.id))
                due_ns = now_ns + round(BEAT_S * NS)
            await trio.sleep(min(BEAT_S, self._left_s()))
        if self._kept == lease:
            self._kept = None
        await self._give_up(lease)
        if self._kept is None:
            self._free.set()

    async def _end(self, lease: messages.Lease) -> bool:
        """Hold the robot at the end of a motion, if that is still necessary. Return False if the sender
        has meanwhile begun another motion under this lease.

        The next command waits until the hold is carried out, since it would be refused during the hold.
        """
        async with self._turn:
            if self._kept == lease and self._is_wanted() and await self._is_of_now(lease):
                return False
            if self._kept == lease and (self._until_ns or self._task().exit_reason in ("duration", "n_steps")):
                self._is_ending = True
                await self._hold(lease)
                self._is_ending = False
            return True

    async def until_held(self) -> None:
        """Wait while the hold at the end of a motion is carried out."""
        if self._is_ending:
            async with self._turn:
                pass

    async def _hold(self, lease: messages.Lease) -> None:
        """Hold the robot because the time of a motion is over. After such a hold, the next command from
        the mesh needs no resume. A motion that another writer has begun meanwhile is not ended."""
        by = holder_of(self._keeper)
        try:
            status = await self._status()
            if status is None or status.holder != by or self._kept != lease:
                return
            if status.epoch == lease.epoch + 1 and status.lapse in _OVER_BY_ITSELF:
                self._shared.resumed_epoch = status.epoch  # The motion ended by itself at the same time.
            if status.epoch != lease.epoch:
                return
            report = await self._gate.ask(messages.Stop(Reason.EXPIRED, by), self._stop_s)
        except (AskTimeout, Unreachable):
            return  # The setpoint expires by itself, and the robot must be resumed.
        if isinstance(report, messages.StopReport) and report.epoch == lease.epoch + 1:
            self._shared.resumed_epoch = report.epoch

    async def _is_of_now(self, lease: messages.Lease) -> bool:
        """Return False if the gate reports a later epoch, in which the motion under this lease has ended.
        Without an answer in time, return True."""
        try:
            status = await self._status()
        except (AskTimeout, Unreachable):
            return True
        return status is None or status.epoch == lease.epoch

    async def _status(self) -> messages.Status | None:
        answer = await self._gate.ask(messages.GetStatus(), ASK_S)
        return answer if isinstance(answer, messages.Status) else None

    def _is_wanted(self) -> bool:
        return self._task().running if not self._until_ns else self._left_s() > 0

    def _left_s(self) -> float:
        """Return the seconds until the motion ends; ``LOOK_S`` for a rollout, whose end is not known."""
        return max(0.0, (self._until_ns - self._context.clock.now_ns()) / NS) if self._until_ns else LOOK_S

    async def _give_up(self, lease: messages.Lease) -> None:
        """Release a lease. Otherwise it would lapse only a second after its last setpoint has expired."""
        try:
            await self._gate.ask(messages.Release(lease.id), self._stop_s)
        except (AskTimeout, Unreachable):
            return

    # -- a rollout

    async def _start(
        self, sender: str, own: messages.Lease | None, command: mesh_json.Start
    ) -> dict[str, Any] | Refused:
        chosen = await choose(self._driver, command, self._robot)
        if isinstance(chosen, Refused):
            return chosen
        where, options = chosen
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
            status = await self._tasks.ask(StartTask(where, options, rollout, command.deadline_ns), START_S)
        except (AskTimeout, Unreachable) as failure:
            self._tasks.tell(StopTask())  # A task that was not confirmed in time must not begin late.
            status = Refused(Code.TIMEOUT, f"{failure}; nothing of it will begin", "try again")
        if not isinstance(status, TaskStatus):
            if lease != own:
                await self._give_up(lease)
            return no_answer(status)
        self._keep(lease, sender, own, 0.0)
        return task_json(status)

    async def _ended(self) -> dict[str, Any]:
        while self._task().running:  # noqa: ASYNC110  # its process reports to another actor
            await trio.sleep(LOOK_S)
        await self._free.wait()  # After this answer, the receiver may send its next command at once.
        return task_json(self._task())

    # -- a pose

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

    # -- a simulation

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
        if not isinstance(report, messages.StopReport) or not report.confirmed:
            return no_answer(report) if not isinstance(report, messages.StopReport) else _NOT_SAFE
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
    """Keep a lease within a block that waits."""

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


_NOT_SAFE = Refused(Code.UNCONFIRMED, "the simulation does not confirm that it stands", "try again")


def holder_of(sender: str) -> str:
    """Return the name of the lease's holder that other callers read."""
    return f"{mesh_json.plain(sender)} on the mesh"


def no_answer(answer: Message | None) -> Refused:
    """Return the gate's refusal, or one for an answer of an unexpected type."""
    return (
        answer if isinstance(answer, Refused) else Refused(Code.NO_ANSWER, "the gate gave no answer", "try again")
    )


def task_json(status: TaskStatus) -> dict[str, Any]:
    """Return a rollout's status in the form of ``get_task_status``."""
    fields: dict[str, Any] = msgspec.structs.asdict(status)
    return {key: value if key in _COUNTED else value or None for key, value in fields.items()}


_COUNTED = ("running", "steps", "elapsed_s", "hz", "instruction")


__all__ = ["NOBODY_TO_ASK", "Motion", "holder_of", "no_answer", "task_json"]
