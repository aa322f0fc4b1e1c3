"""Start, watch and end the rollouts (policies and motions) of one robot, from the user's program.

A rollout is a policy object in this process, a motion in this process, or a named policy in a separate process.
One rollout runs at a time, under the program's lease (the right to command). Its status has the same form
wherever it runs.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import trio
from msgspec.structs import replace

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.loading import load
from strands_actors.kernel.answers import read_answer
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import ActorRef, AskTimeout, Unreachable
from strands_actors.supervisors import addresses, stop_result
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import GetSafety, Stop, StopReport
from strands_actors.supervisors.loading import describe_driver, without_secrets
from strands_actors.supervisors.root.messages import (
    START_TASK,
    GetTask,
    Operate,
    Rollout,
    StartTask,
    StopTask,
    TaskStatus,
)
from strands_actors.supervisors.stop_result import StopResult

from ..processes.robot_processes import Processes
from . import refusals
from .motions import Motion, RobotReading, Steps
from .writer import Writer

START_S = 2.0
"""Longest time for the start of a policy's process."""


class TaskEnd(NamedTuple):
    """A rollout (a policy or motion) that has ended.

    Attributes:
        status: The last status of the rollout.
        result: The result of the hold after the rollout.
    """

    status: TaskStatus
    result: StopResult


class Rollouts:
    """The rollouts (policies and motions) of one robot.

    Only the trio loop of the ``RobotTree`` may call it, except ``running``.
    """

    def __init__(self, processes: Processes, writer: Writer, driver: Driver) -> None:
        self._processes = processes
        self._writer = writer
        self._driver = driver
        self._task = TaskStatus()
        self._has_process = False
        self.failure: Exception | None = None
        """The exception that the last policy of this process raised; None if it raised nothing."""
        self._over = trio.Event()
        self._scope: trio.CancelScope | None = None
        """The scope of the policy of this process."""
        self.no_operator: Refused | None = None
        """The refusal of ``operate`` during the present teleoperation; None if ``operate`` is allowed."""

    async def run_policy(
        self,
        policy: Any,
        instruction: str,
        duration_s: float,
        n_steps: int,
        hz: float | None,
        verb: str = "run_policy",
        load_s: float = 0.0,
        max_age_s: float = 0.0,
    ) -> TaskStatus | Refused:
        """Run ``policy`` in this process, and return at once.

        Args:
            policy: The policy object.
            instruction: Text for it.
            duration_s: Longest time in seconds.
            n_steps: Number of actions after which the policy ends; 0 for no limit. ``duration_s`` then has no
                effect.
            hz: Actions per second; None for the driver's control rate.
            verb: Name of the user's verb, for refusals.
            load_s: As in ``Rollout``.
            max_age_s: As in ``Rollout``.
        """
        async with self._writer.turn:
            refusal = await self._may_start(verb)
            if refusal is not None:
                return refusal
            rollout = replace(
                self._rollout(instruction, duration_s, n_steps, hz), load_s=load_s, max_age_s=max_age_s
            )
            return self._begin(rollout, lambda: policy)

    def _begin(self, rollout: Rollout, make: Callable[[], Any]) -> TaskStatus:
        self._has_process, self.failure, self._over = False, None, trio.Event()
        self._task = TaskStatus(running=True, instruction=rollout.instruction)
        self._scope = trio.CancelScope()
        self._processes.nursery.start_soon(self._run_policy, rollout, make, self._scope)
        return self._task

    async def _run_policy(self, rollout: Rollout, make: Callable[[], Any], scope: trio.CancelScope) -> None:
        from strands_actors.supervisors.policy import Policy

        ended = trio.Event()

        def report(status: TaskStatus) -> None:
            self._task = status
            if not status.running:
                ended.set()

        def failed(error: Exception) -> None:
            self.failure = error

        node = self._processes.node
        path = addresses.of(self._processes.robot).path("policy")
        gate, ask_s = self._processes.gate, self._processes.patience.ask_s
        cell = node.cell(path, lambda: Policy(rollout, make, report, gate, ask_s, failed))
        try:
            with scope:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(cell.run)
                    await ended.wait()
                    nursery.cancel_scope.cancel()
        finally:
            self._over.set()
            node.release(cell)

    async def start_task(
        self,
        provider: str,
        options: dict[str, Any],
        instruction: str,
        duration_s: float,
        hz: float | None,
        is_actor: bool = False,
        teleop: dict[str, Any] | None = None,
        load_s: float = 0.0,
        max_age_s: float = 0.0,
    ) -> TaskStatus | Refused:
        """Run a named policy in a separate process, and return at once. For a robot of another host it
        runs in this process.

        Args:
            provider: ``module:factory`` of the policy.
            options: Keyword arguments for the policy.
            instruction: Text for it.
            duration_s: Longest time in seconds.
            hz: Actions per second; None for the driver's control rate.
            is_actor: As in ``StartTask``.
            teleop: As in ``StartTask``; None for no teleoperation.
            load_s: As in ``Rollout``.
            max_age_s: As in ``Rollout``.
        """
        async with self._writer.turn:
            refusal = await self._may_start(START_TASK)
            if refusal is not None:
                return refusal
            rollout = replace(self._rollout(instruction, duration_s, 0, hz), load_s=load_s, max_age_s=max_age_s)
            tasks = self._processes.tasks
            if tasks is None:
                return self._begin(rollout, lambda: load(provider)(**options))
            deadline_ns = self._processes.node.clock.now_ns() + round(START_S * 1e9)
            order = StartTask(provider, options, rollout, deadline_ns, is_actor, teleop or {})
            try:
                answer = await tasks.ask(order, START_S)
            except (AskTimeout, Unreachable) as failure:
                return await self._never_started(tasks, failure)
            if isinstance(answer, TaskStatus):
                self._task, self._has_process = answer, True
        return read_answer(answer, TaskStatus, START_TASK)

    async def _never_started(self, tasks: ActorRef, failure: AskTimeout | Unreachable) -> Refused:
        """Undo the start of a policy that was not answered in time, and return the refusal.

        The policy must not start late, so the robot is stopped. After the stop, the gate gives the policy no lease
        (right to command) that is based on the caller's present lease. So a policy that has started, or still
        starts, cannot command the robot.
        """
        tasks.tell(StopTask())
        reason = busy.explained(str(failure))
        refused = stop_result.timed_out(reason, await self._hold(), "nothing of it will begin", "try again")
        return refused.about(START_TASK)

    async def move(self, verb: str, plan: Callable[[RobotReading], Motion | Refused]) -> Motion | Refused:
        """Begin a motion as a rollout of this process, and return at once.

        Args:
            verb: Name of the user's verb.
            plan: Plans the motion from the present state of the robot.

        Returns:
            The motion, if it has begun; a refusal if nothing moves.
        """
        async with self._writer.turn:
            self._processes.require()
            status = await self._processes.ask_status(verb)
            if isinstance(status, Refused):
                return status
            if status.no_motion is not None:
                return status.no_motion.about(verb)
            refusal = await self.refuse(verb, starts_another=True)
            if refusal is not None:
                return refusal
            observation = status.observation
            if observation is None:
                return refusals.no_reading(verb)
            motion = plan(RobotReading(observation, status.target, self._processes.node.clock.now_ns()))
            if isinstance(motion, Refused):
                return motion
            if motion.begins_apart:
                # The robot still moves to an earlier target, so let it hold at its present position first.
                await self._hold()
            refusal = await self._writer.acquire()
            if refusal is not None:
                return refusal
            rollout = replace(self._rollout(verb, math.inf, motion.n_steps, 1.0 / motion.period_s), driver={})
            keeps = motion.keeps and self._driver.timing.oneshot_ttl_s is None
            self._begin(replace(rollout, keeps=keeps), lambda: Steps(motion))
            return motion

    async def _may_start(self, verb: str) -> Refused | None:
        robot = self._processes.plan.robot
        if self._driver.ROLLOUTS:
            return refusals.no_rollouts(verb, robot, self._driver.ROLLOUTS)
        if self._driver.TASKS and verb == START_TASK:
            return refusals.no_tasks(verb, robot, self._driver.TASKS)
        self._processes.require()
        status = await self._processes.ask_status(verb)
        if isinstance(status, Refused):
            return status
        if status.mode not in (Mode.ARMED, Mode.HOLDING):
            return refusals.not_armed(verb, status.mode)
        if status.no_motion is not None:
            return status.no_motion.about(verb)
        return await self.refuse(verb, starts_another=True) or await self._writer.acquire()

    def _rollout(self, instruction: str, duration_s: float, n_steps: int, hz: float | None) -> Rollout:
        driver, lease = self._driver, self._writer.lease
        period_s = 1.0 / (hz or driver.timing.control_hz)
        over = lease.id if lease else 0
        lifetime_s = self._processes.plan.lifetime_s or driver.timing.stream_ttl_s
        ttl_s = max(lifetime_s, 2 * period_s)
        robot = self._processes.robot
        # If the number of steps is given, it alone limits the rollout.
        longest_s = math.inf if n_steps else duration_s
        plan = self._processes.plan
        description = describe_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        return Rollout(
            robot,
            driver.axes,
            instruction,
            period_s,
            ttl_s,
            longest_s,
            n_steps,
            over,
            driver.table,
            driver=without_secrets(description, plan.driver_class),
        )

    async def task(self) -> TaskStatus:
        """Return the status of the present rollout (policy or motion), or of the last one."""
        tasks = self._processes.tasks
        if tasks is not None and self._has_process and self._task.running:
            try:
                answer = await tasks.ask(GetTask(), 0.1)
            except (AskTimeout, Unreachable):
                return self._task
            if isinstance(answer, TaskStatus):
                self._task = answer
        return self._task

    async def wait(self) -> TaskStatus:
        """Wait for the end of the policy of this process, and return its status."""
        await self._over.wait()
        return self._task

    def operate(self, operator_input: Operate) -> Refused | None:
        """Send the operator's input to the teleoperation.

        Return a refusal if no teleoperation runs, or if it accepts no such input.
        """
        tasks = self._processes.tasks
        if tasks is None or not self._has_process or not self._task.running:
            return refusals.no_teleoperation()
        if self.no_operator is not None:
            return self.no_operator
        tasks.tell(operator_input)
        return None

    @property
    def running(self) -> bool:
        """Return True if a rollout (policy or motion) runs, by its last status. Any thread may call it, since it
        asks no process.
        """
        return self._task.running

    async def refuse(self, verb: str, starts_another: bool = False) -> Refused | None:
        """Return the refusal of a command while a rollout (policy or motion) runs; None if no rollout runs."""
        if (await self.task()).running:
            return refusals.task_running(verb, starts_another)
        return None

    async def stop_task(self) -> TaskEnd:
        """End the rollout, and return when the robot holds its position.

        A policy that does not answer cannot delay the hold.
        """
        from strands_actors.supervisors.policy import Policy

        processes = self._processes
        processes.require()
        if not (await self.task()).running:
            return TaskEnd(self._task, await self._safety())
        ref: ActorRef = processes.node.ref(addresses.of(processes.robot).policy, Policy)
        if processes.tasks is not None and self._has_process:
            ref = processes.tasks
        answer: Message | None = None
        # If the policy does not answer, ``_hold`` below ends its lease.
        with contextlib.suppress(AskTimeout, Unreachable):
            answer = await ref.ask(StopTask(), 2 * processes.patience.ask_s)
        if isinstance(answer, TaskStatus) and not answer.running:
            self._task = answer
            return TaskEnd(answer, await self._safety())
        result = await self._hold()
        self.end("stopped")
        return TaskEnd(self._task, result)

    async def _safety(self) -> StopResult:
        """Ask the gate, which checks each command, for the result of the last stop or hold."""
        processes = self._processes
        try:
            answer = await processes.gate.ask(GetSafety(), processes.patience.stop_s)
        except (AskTimeout, Unreachable) as failure:
            return stop_result.silent("stop_task", busy.explained(str(failure)), self._driver)
        return stop_result.of_answer("stop_task", answer, self._driver.axes)

    async def _hold(self) -> StopResult:
        """Let the robot hold its position, to end the target of a policy.

        The gate, which checks each command, does it. If the gate does not answer or refuses, the root process
        stops the robot.
        """
        processes = self._processes
        try:
            answer = await processes.gate.ask(Stop(Reason.POLICY, processes.holder), processes.patience.stop_s)
        except (AskTimeout, Unreachable):
            answer = None
        if isinstance(answer, StopReport):
            return stop_result.of_report(answer)
        return await processes.make_safe(Reason.POLICY, processes.holder, False)

    async def end_without_lease(self) -> None:
        """End a rollout (policy or motion) that lost its lease (right to command) when the caller acquired a new
        one.

        The rollout may not have noticed the loss yet.
        """
        if not (await self.task()).running:
            return
        tasks = self._processes.tasks
        if tasks is not None and self._has_process:
            # If no answer comes, the next ``task()`` reads the status.
            with contextlib.suppress(AskTimeout, Unreachable):
                await tasks.ask(StopTask(), 2 * self._processes.patience.ask_s)
        else:
            self.end("stop")

    def end(self, reason: str) -> None:
        """End the rollout (policy or motion) after the robot was stopped.

        A policy of this process is cancelled. A policy of another process gets a message, since it may not notice
        the stop before the robot is resumed. In both cases the status then shows an ended rollout.
        """
        tasks = self._processes.tasks
        if self._has_process and self._task.running and tasks is not None:
            tasks.tell(StopTask())
        if self._scope is not None:
            self._scope.cancel()
            self._scope = None
        task = self._task
        if task.running:
            self._task = replace(task, running=False, exit_reason=reason, exit_detail="", refusal="")
