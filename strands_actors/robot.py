"""``Robot(...)``: one robot with synchronous verbs, safe to call from any thread.

The verbs and envelopes are those of the drivers page. Each call is a message to the robot's actors; nothing
here touches hardware.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import math
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from concurrent.futures import Future
from typing import Any, TypeVar

import trio

from . import answers
from .answers import Answer, PendingAnswer
from .factory import Plan, plan
from .liveness import Liveness
from .policies import resolve_provider
from .portal import open_caller, portal
from .runtime.contract import Observation
from .runtime.messages import Refused
from .runtime.node import AskTimeout, Unreachable
from .supervisors.messages import Resumed, Status, StopReport, TaskStatus
from .tree import NotConnected, RobotTree

_log = logging.getLogger("strands_actors")

T = TypeVar("T")


def Robot(name: str, mode: str = "sim", **keywords: Any) -> RealRobot:  # a factory named as on the drivers page
    """A handle on one robot; nothing is started before ``connect_eagerly()``.

    ``transport="twin"`` runs the robot's twin behind its real wire; otherwise ``port`` says where the robot
    is. Raise ``ValueError`` or ``TypeError`` with what would be accepted.
    """
    return RealRobot(plan(name, mode, **keywords))


class RealRobot:
    """A robot behind its wire. Made by ``Robot(...)``."""

    tool_type = "robot"

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._liveness = Liveness()
        self._tree: RobotTree | None = None
        self._driver = plan.driver_class(plan.robot, plan.port, plan.options)
        self._closed = False

    @property
    def tool_name(self) -> str:
        return self._plan.tool_name

    @property
    def name(self) -> str:
        """Its name among the robots that run: ``tool_name``, numbered when that was taken."""
        return self.tool_name if self._tree is None else self._tree.robot

    def __repr__(self) -> str:
        return f"<Robot {self.tool_name} ({self._plan.robot}, {self._plan.transport or self._plan.port})>"

    # -- the loop

    def _call(self, verb: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
        self._liveness.enter()
        try:
            return portal().call(verb, *args)
        finally:
            self._liveness.leave()

    def _verb(self, run: Callable[[RobotTree], Coroutine[Any, Any, Answer]], name: str) -> Answer:
        """Run a verb on the tree; what keeps it from running at all is an error envelope."""
        tree = self._tree
        if tree is None:
            why = "this robot was cleaned up. make a new one" if self._closed else _NOT_CONNECTED
            return answers.error(f"{name}: {why}")
        try:
            return self._call(run, tree)
        except _NO_ANSWER as failure:
            return answers.error(f"{name}: {failure}")

    # -- lifecycle

    def connect_eagerly(self) -> str | None:
        """Start the tree, connect, and arm at the measured position. None, or why not."""
        if self._closed:
            return "connect: this robot was cleaned up. make a new one"
        return self._call(self._connect)

    async def _connect(self) -> str | None:
        if self._tree is None:
            shared, plan = portal(), self._plan
            self._tree = RobotTree(
                shared.node,
                shared.nursery,
                shared.endpoint,
                plan.driver_class,
                plan.robot,
                plan.tool_name,
                plan.port,
                plan.options,
                plan.transport,
                self._liveness.look,
                plan.drill_age_s,
            )
        return await self._tree.connect()

    @property
    def is_connected(self) -> bool:
        """Whether frames arrive from the robot, not whether a port is open."""
        status = self._status()
        return status is not None and status.connected and 0 <= status.age_s < 1.0

    def cleanup(self) -> Answer:
        """Make the robot safe and end everything that was started for it. Harmless when called again."""
        tree, self._tree, self._closed = self._tree, None, True
        if tree is None:
            return answers.success({"stopped": True, "reason": "nothing was running"})
        report = self._call(tree.cleanup)
        return answers.success({"stopped": True}) if report is None else answers.stopped(report)

    def __enter__(self) -> RealRobot:
        problem = self.connect_eagerly()
        if problem is not None:
            self.cleanup()
            raise ConnectionError(problem)
        return self

    def __exit__(self, *_: object) -> None:
        self.cleanup()

    # -- verbs

    def send_action(self, action: Mapping[str, Any], robot_name: str | None = None) -> Answer:
        """One command: joints by name, in the driver's units. Refused with a reason, or written."""

        async def run(tree: RobotTree) -> Answer:
            answer = await tree.send_action(action)
            if isinstance(answer, Refused):
                return answers.refused(answer)
            return answers.success(tree.driver.commanded(action, answer.values))

        return self._verb(run, "move")

    def get_observation(self) -> dict[str, float]:
        """Positions by joint, in the driver's units; {} (and a log line that says why) when there is none."""

        async def run(tree: RobotTree) -> Answer:
            answer = await tree.observe()
            if isinstance(answer, Refused):
                return answers.refused(answer)
            return answers.success(tree.driver.as_json(answer.position))

        answer = self._verb(run, "observe")
        if answer["status"] == "error":
            _log.warning("%s", answer["content"][0]["text"])
            return {}
        observation: dict[str, float] = answer["content"][0]["json"]
        return observation

    def stop(self) -> Answer | PendingAnswer:
        """De-energise every motor and report each. Works as ``stop()`` and as ``await stop()``."""

        async def run(tree: RobotTree) -> Answer:
            answer = await tree.stop()
            return answers.stopped(answer) if isinstance(answer, StopReport) else answers.refused(answer)

        return self._now_or_soon(functools.partial(self._verb, run, "stop"), run, "stop")

    def get_status(self) -> Answer | PendingAnswer:
        """What the tree says of itself. Works as ``get_status()`` and as ``await get_status()``."""

        async def run(tree: RobotTree) -> Answer:
            return answers.success(self._describe(await tree.status()))

        return self._now_or_soon(lambda: answers.success(self._describe(self._status())), run, "status")

    def resume(self) -> Answer:
        """Lift a lockout, restart what has died, energise at the measured position. Restarts no motion."""

        async def run(tree: RobotTree) -> Answer:
            answer = await tree.resume()
            if isinstance(answer, Resumed):
                position = tree.driver.as_json(answer.observation.position)
                return answers.success({"armed": True, "epoch": answer.epoch, "position": position})
            return answers.refused(answer)

        return self._verb(run, "resume")

    def run_policy(
        self,
        policy: Any = None,
        instruction: str = "",
        duration: float = 30.0,
        n_steps: int | None = None,
        control_frequency: float | None = None,
        policy_object: Any = None,
    ) -> Answer:
        """Run a policy of this process: an object with ``get_actions`` or ``step``, or a callable. Returns at
        once; ``n_steps`` wins over ``duration`` (seconds)."""
        policy = policy if policy is not None else policy_object
        problem = _check_rollout(duration, n_steps, control_frequency)
        if problem is None and policy is None:
            problem = "policy is None. give an object with get_actions_sync, get_actions or step, or a callable"
        if problem is not None:
            return answers.error(f"run_policy: {problem}")

        async def run(tree: RobotTree) -> Answer:
            try:
                status = await tree.run_policy(policy, instruction, duration, n_steps or 0, control_frequency)
            except TypeError as failure:
                return answers.error(str(failure))
            if isinstance(status, Refused):
                return answers.refused(status)
            return answers.success(answers.task(status))

        return self._verb(run, "run_policy")

    def start_task(
        self,
        instruction: str = "",
        policy_port: int | None = None,
        policy_host: str = "localhost",
        policy_provider: str = "mock",
        duration: float = 30.0,
        control_frequency: float | None = None,
        **options: Any,
    ) -> Answer:
        """Run a named policy in a process of its own. Returns at once."""
        problem = _check_rollout(duration, None, control_frequency)
        if problem is not None:
            return answers.error(f"start_task: {problem}")
        if policy_port is not None:
            options |= {"host": policy_host, "port": policy_port}
        try:
            provider = resolve_provider(policy_provider)
        except ValueError as failure:
            return answers.error(f"start_task: {failure}")

        async def run(tree: RobotTree) -> Answer:
            all_options = {"axes": list(tree.driver.axes), **options}
            status = await tree.start_task(provider, all_options, instruction, duration, control_frequency)
            if isinstance(status, Refused):
                return answers.refused(status)
            return answers.success(answers.task(status))

        return self._verb(run, "start_task")

    def get_task_status(self) -> Answer:
        tree = self._tree
        if tree is None:
            return answers.success(answers.task(TaskStatus()))

        async def run(tree: RobotTree) -> Answer:
            return answers.success(answers.task(await tree.task()))

        return self._verb(run, "task")

    def stop_task(self) -> Answer:
        """End the rollout; returns when the robot holds, whatever the policy does."""

        async def run(tree: RobotTree) -> Answer:
            status = await tree.stop_task()
            if isinstance(status, Refused):
                return answers.refused(status)
            return answers.success(answers.task(status))

        return self._verb(run, "stop_task")

    def tree(self) -> dict[str, Any] | None:
        """Processes and actors, as ``strands-actors tree --json`` shows them; None when there are none."""
        tree = self._tree
        report = None if tree is None else self._call(tree.describe)
        return None if report is None else answers.tree(report)

    # -- helpers

    def _status(self) -> Status | None:
        tree = self._tree
        return None if tree is None else self._call(tree.status)

    def _describe(self, status: Status | None) -> dict[str, Any]:
        driver, tree = self._driver, self._tree
        json: dict[str, Any] = {
            "tool_name": self.tool_name,
            "robot": self._plan.robot,
            "connected": False,
            "connect_error": _NOT_CONNECTED if tree is None else tree.problem or "the wire does not answer",
            "firmware_watchdog": driver.firmware_watchdog,
            "unit": driver.unit,
        }
        if status is None:
            return json
        return json | {
            "connected": status.connected,
            "connect_error": status.connect_error or None,
            "state": status.mode,
            "epoch": status.epoch,
            "locked_by": status.locked_by or None,
            "cause": status.cause or None,
            "lease": status.holder or None,
            "observation_age_s": None if status.age_s < 0 else round(status.age_s, 4),
            "writes": status.writes,
            "reads": status.reads,
            "refusals": status.refusals,
            "last_refusal": status.last_refusal or None,
            "ladder": {str(reason): rung for reason, rung in driver.ladder.items()},
            "faults": {} if status.observation is None else dict(status.observation.faults),
            "sensors": {} if status.observation is None else answers.sensors(status.observation),
            **status.facts,
        }

    def _now_or_soon(
        self, now: Callable[[], Answer], run: Callable[[RobotTree], Coroutine[Any, Any, Answer]], name: str
    ) -> Answer | PendingAnswer:
        """Inside a running asyncio loop: under way at once, to be awaited without blocking the loop."""
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return now()
        tree = self._tree
        if tree is None:
            done: Future[Answer] = Future()
            done.set_result(now())
            return PendingAnswer(done)

        async def safely() -> Answer:
            try:
                return await run(tree)
            except _NO_ANSWER as failure:
                return answers.error(f"{name}: {failure}")

        return PendingAnswer(portal().submit(safely))


_NO_ANSWER = (NotConnected, AskTimeout, Unreachable)
_NOT_CONNECTED = "not connected; call connect_eagerly() first"


def _check_rollout(duration: float, n_steps: int | None, hz: float | None) -> str | None:
    if isinstance(duration, bool) or not isinstance(duration, int | float) or not 0 < duration < math.inf:
        return f"duration is {duration!r}. give seconds, finite and above 0"
    if n_steps is not None and (isinstance(n_steps, bool) or not isinstance(n_steps, int) or n_steps < 1):
        return f"n_steps is {n_steps!r}. give a whole number above 0"
    if hz is not None and (isinstance(hz, bool) or not isinstance(hz, int | float) or not 0 < hz <= 1000):
        return f"control_frequency is {hz!r}. give hertz, above 0 and at most 1000"
    return None


@contextlib.asynccontextmanager
async def open_robot(name: str, mode: str = "sim", **keywords: Any) -> AsyncIterator[RobotTree]:
    """One robot for a trio program: connected and armed inside the block, safe and gone after it.

    Raise ``ConnectionError`` when it cannot be connected, and what ``Robot`` raises for bad arguments.
    """
    wanted = plan(name, mode, **keywords)
    async with open_caller() as (node, nursery, endpoint):
        tree = RobotTree(
            node,
            nursery,
            endpoint,
            wanted.driver_class,
            wanted.robot,
            wanted.tool_name,
            wanted.port,
            wanted.options,
            wanted.transport,
            drill_age_s=wanted.drill_age_s,
        )
        try:
            problem = await tree.connect()
            if problem is not None:
                raise ConnectionError(problem)
            yield tree
        finally:
            with trio.CancelScope(shield=True):
                await tree.cleanup()


__all__ = ["Observation", "RealRobot", "Robot", "open_robot"]
