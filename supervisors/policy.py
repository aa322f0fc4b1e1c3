"""The policy actor turns observations into setpoints.

The policy runs in a worker thread, which may block. The loop that sends setpoints does not wait for it. A policy
returns several actions at once (a chunk). They are buffered and sent at the control rate while the next chunk is
computed. That computation begins early enough to end before the buffer is empty, judged by the duration of the last
computation.

If the policy is late all the same, the buffer runs empty, the last setpoint expires, and the robot holds. This
works even if no process notices that the policy is late.

Each action in the buffer has the time at which its reading was requested. ``Rollout.max_age_s`` limits the age of
this reading when the action is sent: an older action is never sent. The first computation is often the slowest, as
it loads and compiles, and the robot does not move yet. So if its chunk is too old, it is dropped once, and computed
again from a new reading.
"""

from __future__ import annotations

import contextlib
import inspect
import logging
import math
import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import trio

from strands_actors.contract.axis import Axis
from strands_actors.contract.loading import load
from strands_actors.contract.positions import Positions
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy, gc_freeze
from strands_actors.kernel.mailbox import SUPERSEDED
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import ActorRef, AskTimeout, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.kernel.user_code import contained, describe_failure
from strands_actors.supervisors.gate.messages import (
    GRANT_S,
    Accepted,
    Acquire,
    GetObservation,
    Lease,
    Release,
    Setpoint,
)
from strands_actors.supervisors.root.messages import GetTask, Rollout, StopTask, TaskStatus

from . import addresses, refusals
from .gate.actions import plain
from .gate.gate import Gate

_log = logging.getLogger("strands_actors")

Action = dict[str, Any]
Infer = Callable[[dict[str, float], str], Sequence[Action]]

WITH_TOOL = "strands_actors.caller.poses.tool_actions:with_tool"
"""Lets a policy give poses of the arm's tool."""

ASK_S = 0.5
ASK_EVERY_S = 0.01
"""A stream with a shorter period than this, in seconds, is *quick*. A quick stream does not wait for answers. It
requests an answer to only one setpoint in this time. If the gate refuses another setpoint, it accepts no further
one, and that answer contains the refusal.

While the buffer is low, the answer to each setpoint of a quick stream also contains an observation. The next
computation takes the newest one, and needs no request of its own. A request takes about half a period at 500 Hz,
and a policy that returns one action at a time would wait for it at every step.
"""

MARGIN = 1.5
"""The next computation may take this factor times as long as the last one before the buffer is empty."""


class Buffer:
    """Actions that wait to be sent, one in each period.

    The buffer is ``low`` when the policy must compute the next chunk. This is so when the remaining actions last no
    longer than ``MARGIN`` times the last computation, or are at most half of the last chunk. For a quick stream one
    more action must remain, since its period is about as long as a thread may wait for a processor.
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = period_s * NS
        self._actions: deque[tuple[Action, int]] = deque()
        self._least = 0

    def __len__(self) -> int:
        return len(self._actions)

    @property
    def low(self) -> bool:
        return len(self._actions) <= self._least

    def add(self, chunk: Sequence[Action], took_ns: int, observed_ns: int = 0) -> None:
        """Add the actions of a chunk.

        Args:
            chunk: The actions.
            took_ns: Duration of their computation.
            observed_ns: Time of the reading from which they were computed.
        """
        if not chunk:
            # The policy needs one more observation first. The buffer is still as low as before.
            return
        self._actions.extend((action, observed_ns) for action in chunk)
        lasts = MARGIN * took_ns / self._period_ns
        spare = math.ceil(lasts) if self._period_ns < ASK_EVERY_S * NS else int(lasts)
        self._least = max(len(chunk) // 2, spare)

    def next(self) -> tuple[Action, int]:
        """Return the next action, and the time of the reading from which it was computed."""
        return self._actions.popleft()


def as_infer(policy: Any) -> Infer:
    """Return a policy as a function from (observation, instruction) to a list of actions.

    Args:
        policy: An object with ``get_actions_sync``, ``get_actions`` or ``step``, or a callable.

    Raises:
        TypeError: The object is no policy.
    """
    if callable(getattr(policy, "get_actions_sync", None)):
        return lambda observation, instruction: _chunk(policy.get_actions_sync(observation, instruction), policy)
    if callable(getattr(policy, "get_actions", None)):
        return lambda observation, instruction: _chunk(policy.get_actions(observation, instruction), policy)
    if callable(getattr(policy, "step", None)):
        return lambda observation, _: _chunk(policy.step(observation))
    if callable(policy):
        return lambda observation, _: _chunk(policy(observation))
    raise TypeError(
        f"{type(policy).__name__} is no policy. "
        "Give an object with get_actions_sync, get_actions or step, or a callable"
    )


def prepare(policy: Any, axes: Sequence[str], hz: float, table: Sequence[Axis] = ()) -> None:
    """Pass the axes and the control rate of the robot to a policy and reset it, if the policy has these methods
    (``docs/drivers.md``)."""
    if not hasattr(policy, "get_actions") and not hasattr(policy, "get_actions_sync"):
        return
    settings = (("set_robot_state_keys", list(axes)), ("set_control_frequency", hz), ("set_robot_axes", table))
    for setter, value in settings:
        if callable(tell := getattr(policy, setter, None)):
            tell(value)
    if callable(reset := getattr(policy, "reset", None)):
        reset()


def _chunk(result: Any, policy: Any = None) -> Sequence[Action]:
    """Return the list of actions in the result of a policy.

    Some policies blend each list of actions into the last one (``supports_rtc``). Of these, only the first
    ``execution_horizon`` actions are used. Of other policies all actions are used.
    """
    if inspect.isawaitable(result):
        # This import takes 8 ms, and few policies need it.
        import asyncio

        result = asyncio.run(_await(result))
    if isinstance(result, Mapping):
        return (plain(result),)
    if isinstance(result, Sequence) and all(isinstance(action, Mapping) for action in result):
        horizon = policy.execution_horizon if getattr(policy, "supports_rtc", False) else len(result)
        return [plain(action) for action in result[:horizon]]
    raise TypeError(f"the policy returned {type(result).__name__}, not an action or a list of actions")


async def _await(result: Any) -> Any:
    return await result


def _ignore(value: Any) -> None:
    """Do nothing. It stands for ``actions_left`` or ``set_reading`` of a policy that does not need the value."""


class _Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Policy(Actor):
    """One run of a policy. It calls ``report`` with its status from time to time, and once at its end."""

    def __init__(
        self,
        rollout: Rollout,
        make: Callable[[], Any],
        report: Callable[[TaskStatus], None],
        gate: ActorRef | None = None,
        ask_s: float = ASK_S,
        failed: Callable[[Exception], object] = lambda error: None,
    ) -> None:
        """Prepare one run of a policy.

        Args:
            rollout: The settings of the run.
            make: Makes the policy, in the worker thread.
            report: Called with each status.
            gate: The gate of a robot on another host; None for the gate of ``rollout.robot``.
            ask_s: Timeout for an answer of the gate, in seconds.
            failed: Called with an exception of the policy.
        """
        self._failed = failed
        self._rollout = rollout
        self._remote_gate = gate
        self._ask_s = ask_s
        self._make = make
        self._report = report
        self._buffer = Buffer(rollout.period_s)
        self._actions_requested = trio.Event()
        self._actions_requested.set()
        self._lease: Lease | None = None
        self._acquiring = trio.Lock()
        self._steps = 0
        self._ask_every = max(1, round(ASK_EVERY_S / rollout.period_s))
        self._is_quick = self._ask_every > 1
        self._answer_is_due = False
        # The newest observation from the answer to a setpoint, the time of that answer, and the number of setpoints
        # whose answers will contain one.
        self._observation: Observation | None = None
        self._observed_ns = 0
        self._observations_due = 0
        self._answered = trio.Event()  # a new event after each answer that may contain an observation
        self._began_ns = 0
        self._last_ns = 0
        self._ended: TaskStatus | None = None
        self._oldest_ns = 0
        self._has_dropped = False

    async def started(self) -> None:
        own: ActorRef = self.context.ref(addresses.of(self._rollout.robot).gate, Gate)
        self._gate = self._remote_gate or own
        self._began_ns = self.context.clock.now_ns()
        self.context.start_soon(self._infer)
        self.context.every(self._rollout.period_s, _Tick)
        self._report(self._status())

    async def receive(self, message: _Tick | StopTask | GetTask) -> TaskStatus | None:
        match message:
            case _Tick():
                await self._tick(message.now_ns)
            case StopTask():
                await self._end("stopped", "")
                return self._status()
            case GetTask():
                return self._status()
        return None

    async def _tick(self, now_ns: int) -> None:
        rollout = self._rollout
        if self._ended is not None:
            return
        if self._lease is None and rollout.load_s:
            if now_ns - self._began_ns >= rollout.load_s * NS:
                await self._end("policy", f"it returned no action within {rollout.load_s:g} s")
        elif now_ns - self._began_ns >= rollout.duration_s * NS:
            await self._end("duration", f"the duration of {rollout.duration_s:g} s has passed")
        elif self._buffer and self._lease is not None:
            action, observed_ns = self._buffer.next()
            age_ns = now_ns - observed_ns
            if self._is_too_old(age_ns):
                await self._end("policy", _too_old(age_ns, rollout.max_age_s))
            else:
                self._oldest_ns = max(self._oldest_ns, age_ns)
                await self._send(action, now_ns)
        elif self._steps and now_ns - self._last_ns > rollout.ttl_s * NS:
            await self._end("policy", busy.explained(f"no action for {rollout.ttl_s * 1e3:g} ms"))
        if self._buffer.low:
            self._actions_requested.set()

    def _is_too_old(self, age_ns: int) -> bool:
        return 0.0 < self._rollout.max_age_s * NS < age_ns

    async def _send(self, action: Action, now_ns: int) -> None:
        assert self._lease is not None
        rollout = self._rollout
        deadline_ns = now_ns + round(rollout.ttl_s * NS)
        last = bool(rollout.n_steps) and self._steps + 1 >= rollout.n_steps
        observe = self._is_quick and not last and self._buffer.low
        keeps = last and rollout.keeps
        period_s = 0.0 if keeps else rollout.period_s
        setpoint = Setpoint(
            self._lease.id, self._lease.epoch, deadline_ns, action, period_s, latched=keeps, observe=observe
        )
        if last:
            if not await self._ask(setpoint):
                return
        elif observe:
            self._observations_due += 1
            self.context.start_soon(self._ask_to_observe, setpoint)
        elif self._steps % self._ask_every or self._answer_is_due:
            self._gate.tell(setpoint)
        elif not await self._ask_for_a_while(setpoint):
            return
        self._steps += 1
        self._last_ns = now_ns
        if last:
            await self._end("n_steps", f"{self._steps} steps are done")
        elif self._steps % (8 * self._ask_every) == 1:
            self._report(self._status())

    async def _ask_for_a_while(self, setpoint: Setpoint) -> bool:
        """Send a setpoint and wait for its answer, for half a period at most. A quick stream does not wait at all.

        If the answer comes later, the stream continues meanwhile: the next setpoints need no answer. If the answer
        is a refusal, it ends the run when it comes.
        """
        self._answer_is_due = True
        answered = trio.Event()

        async def ask() -> None:
            await self._ask(setpoint)
            self._answer_is_due = False
            answered.set()

        self.context.start_soon(ask)
        if not self._is_quick:
            with trio.move_on_after(self._rollout.period_s / 2):
                await answered.wait()
        return self._ended is None

    async def _ask_to_observe(self, setpoint: Setpoint) -> None:
        await self._ask(setpoint)
        self._observations_due -= 1
        self._answered.set()
        self._answered = trio.Event()

    async def _ask(self, setpoint: Setpoint) -> bool:
        """Send a setpoint. Return True if the gate accepted it. If not, the run has ended."""
        try:
            answer = await self._gate.ask(setpoint, self._ask_s)
        except (AskTimeout, Unreachable) as failure:
            await self._end("publish", busy.explained(f"the gate does not answer: {failure}"))
            return False
        if isinstance(answer, Refused) and answer.code == SUPERSEDED.code:
            # The gate dropped this setpoint because a newer one came before it was read. The newer one is checked
            # instead.
            return True
        if isinstance(answer, Refused):
            reason = "stop" if answer.code in (Code.STALE_EPOCH, Code.DISARMED, Code.LOCKED_OUT) else "gate"
            await self._end(reason, answer.text, answer.code)
            return False
        assert isinstance(answer, Accepted)
        if answer.observation is not None:
            self._observation, self._observed_ns = answer.observation, self.context.clock.now_ns()
        return True

    async def _infer(self) -> None:
        try:
            infer, report_remaining, show_reading = await trio.to_thread.run_sync(
                contained, self._ready, abandon_on_cancel=True
            )
            with contextlib.ExitStack() as moving:
                while self._ended is None:
                    await self._actions_requested.wait()
                    began_ns = self.context.clock.now_ns()
                    observation = await self._observe()
                    if observation is None:
                        return
                    report_remaining(len(self._buffer))
                    show_reading(observation)
                    chunk = await trio.to_thread.run_sync(
                        contained,
                        infer,
                        self._positions(observation),
                        self._rollout.instruction,
                        abandon_on_cancel=True,
                    )
                    took_ns = self.context.clock.now_ns() - began_ns
                    if chunk and self._lease is None:
                        if self._is_too_old(took_ns):
                            if self._has_dropped:
                                await self._end("policy", _too_old(took_ns, self._rollout.max_age_s))
                                return
                            self._has_dropped = True
                            continue
                        if not await self._acquire():
                            return
                        moving.enter_context(gc_freeze.frozen_objects())
                        if self._rollout.load_s:
                            self._began_ns = self.context.clock.now_ns()
                    self._buffer.add(chunk, self.context.clock.now_ns() - began_ns, began_ns)
                    # During the computation, ticks have requested more actions. These were just added.
                    self._actions_requested = trio.Event()
                    if not chunk:
                        await trio.sleep(self._rollout.period_s)
                    if self._buffer.low:
                        self._actions_requested.set()
        # The user's code may raise anything. This must end the run, but not the actor.
        except Exception as error:
            _log.error("%s: its policy failed", self._rollout.robot, exc_info=error)
            self._failed(error)
            await self._end("policy", describe_failure(error))

    def _ready(self) -> tuple[Infer, Callable[[int], None], Callable[[Observation], None]]:
        """Make the policy. Return it as a function, and two functions that are called before each computation: one
        gets the number of remaining actions, the other gets the whole reading with velocities and sensors."""
        policy = self._make()
        infer = as_infer(policy)
        if self._rollout.driver:
            infer = load(WITH_TOOL)(infer, self._rollout.driver, bool(getattr(policy, "reads_pose", False)))
        prepare(policy, self._rollout.axes, 1.0 / self._rollout.period_s, self._rollout.table)
        return infer, getattr(policy, "actions_left", _ignore), getattr(policy, "set_reading", _ignore)

    async def _observe(self) -> Observation | None:
        while self._observation is None and self._observations_due:
            await self._answered.wait()
        if self._ended is not None:
            return None
        answer_s = (self.context.clock.now_ns() - self._observed_ns) / NS
        newest, self._observation = self._observation, None
        if newest is not None and answer_s <= self._rollout.period_s:
            return newest
        try:
            observation = await self._gate.ask(GetObservation(), self._ask_s)
        except (AskTimeout, Unreachable) as failure:
            await self._end("publish", busy.explained(f"the gate does not answer: {failure}"))
            return None
        if not isinstance(observation, Observation):
            await self._end("gate", getattr(observation, "text", "no observation"))
            return None
        return observation

    def _positions(self, observation: Observation) -> dict[str, float]:
        return Positions(zip(self._rollout.axes, observation.position, strict=True))

    async def _acquire(self) -> bool:
        """Acquire the lease (the right to command the robot) when the first action is ready. Until then the script
        may still move the robot."""
        rollout = self._rollout
        async with self._acquiring:
            if self._ended is not None:
                return False
            request = Acquire(
                f"policy of {rollout.robot}", rollout.over, os.getpid(), instruction=rollout.instruction
            )
            try:
                lease = await self._gate.ask(request, self._ask_s + GRANT_S)
            except (AskTimeout, Unreachable) as failure:
                lease = busy.with_load(refusals.silent_gate(str(failure)))
            if isinstance(lease, Lease):
                self._lease = lease
                return True
        await self._end("refused", getattr(lease, "text", "no lease"), getattr(lease, "code", ""))
        return False

    async def _end(self, reason: str, detail: str, refusal: str = "") -> None:
        if self._ended is not None:
            return
        status = self._status()
        self._ended = TaskStatus(
            False, status.steps, status.elapsed_s, reason, detail, refusal, status.instruction, status.hz,
            action_age_s=status.action_age_s,
        )  # fmt: skip
        # If a lease was requested, wait for the reply, so that this lease is released, too.
        async with self._acquiring:
            pass
        if self._lease is not None:
            # The gate makes the robot hold before it releases the lease. If the gate does not answer, the setpoint
            # and the lease end by themselves, and the status reports it.
            try:
                await self._gate.ask(Release(self._lease.id, self._keeps(reason)), self._ask_s)
            except (AskTimeout, Unreachable) as failure:
                self._ended = self._not_confirmed(failure)
        self._report(self._ended)

    def _keeps(self, reason: str) -> bool:
        """Return True if the last setpoint stays in force after the run. This is so only if all steps were done."""
        return self._rollout.keeps and reason == "n_steps"

    def _not_confirmed(self, failure: Exception) -> TaskStatus:
        """Return the status of a run that has ended without a confirmed hold."""
        ended = self._status()
        expires_ms = self._rollout.ttl_s * 1e3
        note = f"the gate does not confirm that the robot holds ({failure}); its setpoint lives {expires_ms:g} ms"
        reason = "unreachable" if ended.exit_reason == "stopped" else ended.exit_reason
        detail = f"{ended.exit_detail}. {note}" if ended.exit_detail else note
        return msgspec.structs.replace(ended, exit_reason=reason, exit_detail=detail)

    def _status(self) -> TaskStatus:
        if self._ended is not None:
            return self._ended
        elapsed_s = (self.context.clock.now_ns() - self._began_ns) / NS
        hz = self._steps / elapsed_s if elapsed_s > 0 else 0.0
        instruction, age_s = self._rollout.instruction, self._oldest_ns / NS
        return TaskStatus(True, self._steps, elapsed_s, instruction=instruction, hz=hz, action_age_s=age_s)


def _too_old(age_ns: int, max_age_s: float) -> str:
    """Return why an action is not sent."""
    return busy.explained(
        f"the next action was computed from a reading that is {age_ns / NS:.2f} s old (limit {max_age_s:g} s)"
    )
