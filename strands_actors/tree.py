"""The caller's end of one robot's tree, on trio: starts it, writes to it, ends it.

``Robot`` puts synchronous verbs on it, ``open_robot`` hands it to a trio program.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from typing import Any

import trio

from .drill.certificate import TWIN, clause
from .engine import SIM, Engine, EngineDown
from .mesh.config import MeshConfig
from .rundir import Name, Note
from .runtime.contract import Driver, Observation, Reason
from .runtime.messages import Message, Refused
from .runtime.node import AskTimeout, Node, Ref, Unreachable
from .runtime.process import ChildProcess, start
from .runtime.zenoh_mesh import unix_endpoint
from .supervisors import addresses
from .supervisors.actions import plain
from .supervisors.failsafe import LINKED, Mode
from .supervisors.gate import Gate
from .supervisors.guardian import Guardian
from .supervisors.lines import keep_line
from .supervisors.loading import describe_driver
from .supervisors.messages import (
    Accepted,
    Acquire,
    Beat,
    Describe,
    Fence,
    GetMesh,
    GetObservation,
    GetStatus,
    GetTask,
    Lease,
    OnMesh,
    Perform,
    Performed,
    Release,
    Resume,
    Resumed,
    Rollout,
    Setpoint,
    Shutdown,
    StartTask,
    Status,
    Stop,
    StopReport,
    StopTask,
    TaskStatus,
    TreeReport,
)
from .supervisors.policy import Policy
from .supervisors.root import Root
from .supervisors.tasks import Tasks

BEAT_S = 0.04
COMMAND_S = 0.25
"""A command that has not reached the wire by then never will."""
ASK_S = 0.5
STOP_S = 2.0
CONNECT_S = 12.0
RETRY_S = 3.0
"""The wire's longest pause between two attempts to open it, and one attempt."""
FENCE_S = 3.0


class NotConnected(Exception):
    """There is no tree, or it does not answer."""


class RobotTree:
    """One robot. All methods belong to the trio loop of ``nursery``."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        endpoint: str,
        driver_class: type[Driver],
        kind: str,
        wanted_name: str,
        port: str,
        options: dict[str, Any],
        transport: str | None,
        liveness: Callable[[], tuple[bool, float]] = lambda: (True, 0.0),
        engine: Engine | None = None,
        owns_engine: bool = True,
        mesh: MeshConfig = MeshConfig(),  # noqa: B008  # frozen
        drill_age_s: float | None = None,
    ) -> None:
        """``engine``: the twin's process behind ``transport``. It ends with the robot that owns it."""
        self.driver: Driver = driver_class(kind, port, options)
        self.kind = kind
        self.robot = wanted_name  # until the tree is started: then the name it could get
        self._wanted_name = wanted_name
        self._driver_class = driver_class
        self._node = node
        self._nursery = nursery
        self._endpoint = endpoint
        self._port = port
        self._options = options
        self.transport = transport
        self._liveness = liveness
        self._mesh = mesh
        self._drill_age_s = drill_age_s
        self._name: Name | None = None
        self._root_process: ChildProcess | None = None
        self.engine = engine
        self._owns_engine = owns_engine
        self._lease: Lease | None = None
        self._scope: trio.CancelScope | None = None
        self._policy_scope: trio.CancelScope | None = None
        self._task = TaskStatus()
        self._task_is_remote = False
        self.problem = ""
        """Why the last attempt to connect failed."""
        self.facts: dict[str, Any] = {}
        """What the wire said of itself when it last answered."""
        self._stops = 0
        self._starting = trio.Lock()
        self._writing = trio.Lock()
        """One command of this caller at a time: the gate keeps the newest of those that wait, and each may take
        the lease anew."""
        self.closed = False

    @property
    def tool_name(self) -> str:
        """The name it was given; among the robots that run it may have a number."""
        return self._wanted_name

    # -- start and end

    async def connect(self, arm: bool = True) -> str | None:
        """Start the tree if need be, wait for the link, arm and take the lease (unless ``arm`` is false: then
        nothing is energised). None, or why not."""
        if self.closed:
            return "connect: this robot was cleaned up. make a new one"
        try:
            async with self._starting:
                self.problem = await self._connect(arm) or ""
                return self.problem or None
        except (NotConnected, AskTimeout, Unreachable, OSError, ValueError) as failure:
            self.problem = f"connect: {str(failure).removeprefix('connect: ')}"
            return self.problem

    async def _connect(self, arm: bool) -> str | None:
        stops = self._stops
        if self._root_process is not None:
            # What it says of the link may be from before its present pause between two attempts.
            status = await self._wait_linked(RETRY_S)
        else:
            await self._start()
            try:
                status = await self._wait_linked()
                await self._require_mesh()
            except NotConnected:
                await self._end_root()  # it would go on trying, and take the port from whoever has it next
                raise
        if not arm:
            return None
        if status.mode not in (Mode.ARMED, Mode.HOLDING):
            if status.locked_by:
                return f"connect: e-stopped by {status.locked_by}. resume() lifts the lockout"
            answer = await self._energise(stops)
            if not isinstance(answer, Resumed):
                return _text(answer)
        async with self._writing:
            refusal = await self._acquire()
        return None if refusal is None else refusal.text

    async def _start(self) -> None:
        if self.engine is not None:
            try:
                await self.engine.start()
            except EngineDown as down:
                raise NotConnected(str(down)) from None
            self._port = self.engine.door if self.transport == SIM else self.engine.port
        if self._name is None:
            self._name = Name(self._wanted_name)
            self.robot = self._name.name
        name = self._name
        at = addresses.of(self.robot)
        listen, wire_listen, mesh = (unix_endpoint(name.socket(role)) for role in ("root", "wire", "mesh"))
        args = {
            "robot": self.robot,
            "driver": describe_driver(self._driver_class, self.kind, self._port, self._options) | self._drill(),
            "caller_pid": os.getpid(),
            "twin_pid": 0 if self.engine is None else self.engine.pid,
            "listen": listen,
            "wire_listen": wire_listen,
            "connect": [self._endpoint],
            "mesh": {
                "listen": [mesh, *self._mesh.listens],
                "connect": self._mesh.connects,
                "settings": self._mesh.robot_settings(),
            },
        }
        self._root_process = start("strands_actors.supervisors.root:main", args, pass_fds=[name.lock_fd])
        name.publish(Note(self.robot, self.kind, self._root_process.pid, [listen, wire_listen], [mesh]))
        node = self._node
        self._gate: Ref = node.ref(at.gate, Gate, sender=f"{node.address}/{self.robot}")
        self._guardian: Ref = node.ref(at.guardian, Guardian)
        self._root: Ref = node.ref(at.root, Root)
        self._tasks: Ref = node.ref(at.tasks, Tasks)
        self._scope = trio.CancelScope()
        self._nursery.start_soon(self._attend, self._root_process, self._scope)

    def _drill(self) -> dict[str, Any]:
        """For the gate: whether a stop drill is required, and was passed."""
        if self._drill_age_s is None:
            return {}
        port = TWIN if self.transport == "twin" else self._port
        return {"drill": clause(self._driver_class, self.kind, port, self._options, self._drill_age_s)}

    async def _attend(self, process: ChildProcess, scope: trio.CancelScope) -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(process.link(self._node).run)
                nursery.start_soon(keep_line, self._node, self.robot)
                nursery.start_soon(self._beat)
                await process.wait()
                nursery.cancel_scope.cancel()

    async def _wait_linked(self, patience_s: float = 0.0) -> Status:
        """``patience_s``: how long to wait for a link that was lost."""
        began = trio.current_time()
        deadline = began + CONNECT_S
        status: Status | None = None
        while trio.current_time() < deadline:
            assert self._root_process is not None
            if not self._root_process.alive:
                raise NotConnected("the root process ended")
            try:
                answer = await self._gate.ask(GetStatus(), ASK_S)
            except (AskTimeout, Unreachable):
                await trio.sleep(0.005)
                continue
            assert isinstance(answer, Status)
            status = answer
            if status.mode in LINKED and status.mode != Mode.STOPPING:
                return status
            lost = status.connect_error and status.connect_error != "not connected yet"
            if lost and trio.current_time() >= began + patience_s:
                raise NotConnected(status.connect_error)
            await trio.sleep(0.01)
        raise NotConnected(f"no answer within {CONNECT_S:g} s" if status is None else status.connect_error)

    async def _require_mesh(self) -> None:
        """A robot that was to be reached from elsewhere and is not has not been started."""
        try:
            answer = await self._root.ask(GetMesh(), CONNECT_S)
        except (AskTimeout, Unreachable) as failure:
            raise NotConnected(f"the root does not say whether it is on the mesh: {failure}") from failure
        if isinstance(answer, OnMesh) and answer.problem:
            raise NotConnected(answer.problem)

    async def _beat(self) -> None:
        while True:
            await trio.sleep(BEAT_S)
            alive, answered_ago_s = self._liveness()
            if self._lease is not None and alive:
                self._gate.tell(Beat(self._lease.id, answered_ago_s))

    async def cleanup(self) -> StopReport | None:
        """Make safe, end the tree. The report, or None when nothing was running."""
        self.closed = True
        self._end_policy("cleanup")
        report = await self._end_root()
        if self.engine is not None and self._owns_engine:
            await self.engine.close()
        return report

    async def _end_root(self) -> StopReport | None:
        process = self._root_process
        report: StopReport | None = None
        if process is not None:
            # A root that does not answer is fenced at once; the wire then makes itself safe.
            if await self.describe() is not None:
                with contextlib.suppress(AskTimeout, Unreachable):
                    answer = await self._root.ask(Shutdown(Reason.CLEANUP, self._holder), FENCE_S)
                    report = answer if isinstance(answer, StopReport) else None
                with trio.move_on_after(FENCE_S):
                    await process.wait()
            await process.fence()
            await self._forget(process)
        if self._name is not None:
            self._name.release()
            self._name = None
        return report

    async def _forget(self, process: ChildProcess) -> None:
        if self._scope is not None:
            self._scope.cancel()
        self._root_process = None
        self._lease = None

    # -- writing

    @property
    def _arm_s(self) -> float:
        """How long arming may take, and a little more."""
        return self.driver.timing.arm_s + 2.0

    @property
    def _holder(self) -> str:
        return f"{self._wanted_name} in process {os.getpid()}"

    def _require(self) -> None:
        if self.closed:
            raise NotConnected("this robot was cleaned up. make a new one")
        if self._root_process is None:
            raise NotConnected("not connected. call connect_eagerly() first")

    async def _acquire(self) -> Refused | None:
        answer = await self._gate.ask(Acquire(self._holder, pid=os.getpid()), ASK_S)
        if isinstance(answer, Lease):
            self._lease = answer
            return None
        return answer if isinstance(answer, Refused) else Refused("lease", "no lease")

    async def release(self) -> Refused | None:
        """Give the lease up: others, on the mesh too, may then move the robot. A target that was latched is held.
        The next command of ours takes the lease again, if nobody else has it."""
        self._require()
        if (await self.task()).running:
            return Refused("running", "release: a task is running", "call stop_task() first")
        async with self._writing:
            lease, self._lease = self._lease, None
            if lease is not None:
                await self._gate.ask(Release(lease.id), ASK_S)
        return None

    async def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        """One command: gated, then written, then kept for as long as the driver says."""
        self._require()
        refusal = _refuse_shape(action)
        if refusal is not None:
            return refusal
        async with self._writing:
            return await self._send_action(action)

    async def _send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        if (await self.task()).running:
            return Refused("running", "move: a task is running", "call stop_task() first")
        answer = await self._send(action)
        if isinstance(answer, Refused) and answer.code in ("stale_epoch", "no_lease"):
            # Held since, or the wire restarted: an explicit new command may take the lease anew. A robot
            # that is disarmed or locked out refuses it all the same.
            refusal = await self._acquire()
            answer = refusal or await self._send(action)
        return answer

    async def _send(self, action: Mapping[str, Any]) -> Accepted | Refused:
        lease = self._lease
        if lease is None:
            refusal = await self._acquire()
            if refusal is not None or self._lease is None:
                return refusal or Refused("lease", "move: no lease")
            lease = self._lease
        ttl_s = self.driver.timing.oneshot_ttl_s
        deadline_ns = self._node.clock.now_ns() + round(1e9 * (COMMAND_S if ttl_s is None else ttl_s))
        setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, plain(action), 0.0, ttl_s is None)
        try:
            answer = await self._gate.ask(setpoint, ASK_S)
        except AskTimeout:
            # It must not execute late: fence and stop.
            await self._fence(Reason.WIRE, "a command timed out")
            return Refused("timeout", f"move: no answer within {ASK_S:g} s; the robot was stopped", "resume()")
        except Unreachable as failure:
            return Refused("unreachable", f"move: {failure}", "resume() when the robot is back")
        return answer if isinstance(answer, Accepted | Refused) else Refused("no_answer", "move: no answer")

    async def perform(self, service: str, arguments: Mapping[str, Any]) -> Performed | Refused:
        """One of the driver's own services (``Driver.SERVICES``), under this caller's lease."""
        self._require()
        refusal = self.driver.check_service(service, arguments)
        if refusal is not None:
            return refusal
        async with self._writing:
            if (await self.task()).running:
                return Refused("running", f"{service}: a task is running", "call stop_task() first")
            refusal = await self._acquire()
            if refusal is not None or self._lease is None:
                return refusal or Refused("lease", f"{service}: no lease")
            message = Perform(self._lease.id, self._lease.epoch, service, plain(arguments))
            try:
                answer = await self._gate.ask(message, self.driver.SERVICES[service].within_s + ASK_S)
            except AskTimeout:
                await self._fence(Reason.WIRE, f"{service} timed out")  # it must not be done late
                return Refused("timeout", f"{service}: no answer; the robot was stopped", "resume()")
            except Unreachable as failure:
                return Refused("unreachable", f"{service}: {failure}", "resume() when the robot is back")
        return answer if isinstance(answer, Performed | Refused) else Refused("no_answer", f"{service}: no answer")

    async def stop(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopReport | Refused:
        """Make safe. When the wire does not answer, the root fences it and writes by its own path."""
        self._require()
        self._stops += 1
        try:
            answer = await self._gate.ask(Stop(reason, self._holder, lock), STOP_S)
        except (AskTimeout, Unreachable):
            answer = await self._fence(reason, self._holder, lock)
        self._end_policy("stop")
        return answer if isinstance(answer, StopReport | Refused) else Refused("no_answer", "stop: no answer")

    async def _fence(self, reason: Reason, by: str, lock: bool = False) -> StopReport | Refused:
        try:
            answer = await self._guardian.ask(Fence(reason, by, lock), FENCE_S)
        except (AskTimeout, Unreachable) as failure:
            # Neither the wire nor the root answers. Without its root the wire makes itself safe.
            if self._root_process is not None:
                await self._root_process.fence()
            why = f"neither wire nor root answers ({failure}); the root was ended"
            named = ", ".join(self.driver.axes)
            return Refused("unconfirmed", f"stop: {why}. not confirmed by {named}", "look at the robot")
        return answer if isinstance(answer, StopReport | Refused) else Refused("no_answer", "stop: no answer")

    async def resume(self, lift: bool = True) -> Resumed | Refused:
        """Lift a lockout, or start again what has died; energise at the measured position. No motion.
        ``lift=False`` only energises: for who is no operator."""
        if self.closed:
            raise NotConnected("this robot was cleaned up. make a new one")
        async with self._starting:
            return await self._resume(lift)

    async def _resume(self, lift: bool) -> Resumed | Refused:
        stops = self._stops
        if not await self._root_answers():
            if not lift:  # whether it was locked is no longer known
                remedy = "an operator's resume() starts it again"
                return Refused("not_connected", "resume: the tree does not answer", remedy)
            if self._root_process is not None:
                await self._root_process.fence()
                await self._forget(self._root_process)
            await self._start()
        await self._wait_linked()
        answer = await self._energise(stops, lift)
        if isinstance(answer, Resumed):
            async with self._writing:
                refusal = await self._acquire()
                if refusal is None:
                    await self._end_task()
            return refusal or answer
        return answer if isinstance(answer, Refused) else Refused("no_answer", "resume: no answer")

    async def _end_task(self) -> None:
        """The lease is ours: a rollout from before has lost its own, whether it has noticed or not."""
        if not (await self.task()).running:
            return
        if self._task_is_remote:
            with contextlib.suppress(AskTimeout, Unreachable):  # then the next task() tells
                await self._tasks.ask(StopTask(), ASK_S * 2)
        else:
            self._end_policy("stop")

    async def _energise(self, stops: int, lift: bool = True) -> Message | None:
        """Have the gate arm, unless it was told to stop since (``stops``: how often it had been before)."""
        if self._stops != stops:
            return Refused("stopped", "resume: stopped meanwhile", "resume again when that is over")
        answer: Message | None = None
        failure: Exception = NotConnected("the wire ended while it was arming; try again")
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._watch_arming, nursery.cancel_scope)
            try:
                answer = await self._gate.ask(Resume(self._holder, lift), self._arm_s)
            except (AskTimeout, Unreachable) as error:
                failure = error
            nursery.cancel_scope.cancel()
        if answer is None:
            raise failure
        return answer

    async def _watch_arming(self, asked: trio.CancelScope) -> None:
        """A gate that dies takes the question with it: its successor, which does not arm, gives it away."""
        idle = 0
        while idle < 2:
            await trio.sleep(0.2)
            status = await self.status()
            idle = 0 if status is None or status.mode in (Mode.ARMING, Mode.STOPPING) else idle + 1
        asked.cancel()

    async def _root_answers(self) -> bool:
        """Whether the root lives and still keeps a wire; once its restart budget is spent only a new tree helps."""
        process = self._root_process
        if process is None or not process.alive:
            return False
        report = await self.describe()
        return report is not None and report.state != Mode.FAILED

    # -- reading

    async def observe(self) -> Observation | Refused:
        self._require()
        try:
            answer = await self._gate.ask(GetObservation(), ASK_S)
        except (AskTimeout, Unreachable) as failure:
            return Refused("unreachable", f"observe: {failure}", "resume() when the robot is back")
        return answer if isinstance(answer, Observation | Refused) else Refused("no_answer", "no answer")

    async def status(self) -> Status | None:
        """None when the wire does not answer."""
        if self._root_process is None:
            return None
        try:
            answer = await self._gate.ask(GetStatus(), 0.1)
        except (AskTimeout, Unreachable):
            return None
        if not isinstance(answer, Status):
            return None
        self.facts |= answer.facts
        return answer

    async def describe(self) -> TreeReport | None:
        """Processes and actors of the tree; None when the root does not answer."""
        if self._root_process is None:
            return None
        try:
            answer = await self._root.ask(Describe(), ASK_S)
        except (AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, TreeReport) else None

    # -- rollouts

    async def run_policy(
        self, policy: Any, instruction: str, duration_s: float, n_steps: int, hz: float | None
    ) -> TaskStatus | Refused:
        """Run ``policy`` in this process. Returns at once."""
        async with self._writing:
            refusal = await self._may_start("run_policy")
            if refusal is not None:
                return refusal
            rollout = self._rollout(instruction, duration_s, n_steps, hz)
            self._task_is_remote = False
            self._task = TaskStatus(running=True, instruction=instruction)
            self._policy_scope = trio.CancelScope()
            self._nursery.start_soon(self._run_policy, rollout, policy, self._policy_scope)
            return self._task

    async def _run_policy(self, rollout: Rollout, policy: Any, scope: trio.CancelScope) -> None:
        ended = trio.Event()

        def report(status: TaskStatus) -> None:
            self._task = status
            if not status.running:
                ended.set()

        path = addresses.of(self.robot).path("policy")
        cell = self._node.cell(path, lambda: Policy(rollout, lambda: policy, report))
        try:
            with scope:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(cell.run)
                    await ended.wait()
                    nursery.cancel_scope.cancel()
        finally:
            self._node.release(cell)

    async def start_task(
        self, provider: str, options: dict[str, Any], instruction: str, duration_s: float, hz: float | None
    ) -> TaskStatus | Refused:
        """Run a named policy in a process of its own. Returns at once."""
        async with self._writing:
            refusal = await self._may_start("start_task")
            if refusal is not None:
                return refusal
            message = StartTask(provider, options, self._rollout(instruction, duration_s, 0, hz))
            answer = await self._tasks.ask(message, ASK_S * 4)
            if isinstance(answer, TaskStatus):
                self._task, self._task_is_remote = answer, True
        return answer if isinstance(answer, TaskStatus | Refused) else Refused("no_answer", "no answer")

    async def _may_start(self, verb: str) -> Refused | None:
        if self.driver.ROLLOUTS:
            return Refused("no_rollout", f"{verb}: {self.kind}: {self.driver.ROLLOUTS}", "call send_action()")
        if self.driver.TASKS and verb == "start_task":
            return Refused("no_task", f"{verb}: {self.kind}: {self.driver.TASKS}", "call run_policy()")
        self._require()
        status = await self.status()
        if status is None or status.mode not in (Mode.ARMED, Mode.HOLDING):
            mode = "not connected" if status is None else status.mode
            return Refused("not_armed", f"{verb}: the robot is {mode}", "connect_eagerly() or resume() first")
        if (await self.task()).running:
            return Refused("running", f"{verb}: a task is already running", "call stop_task() first")
        return await self._acquire()

    def _rollout(self, instruction: str, duration_s: float, n_steps: int, hz: float | None) -> Rollout:
        timing = self.driver.timing
        period_s = 1.0 / (hz or timing.control_hz)
        over = self._lease.id if self._lease else 0
        ttl_s = max(timing.stream_ttl_s, 2 * period_s)
        return Rollout(self.robot, self.driver.axes, instruction, period_s, ttl_s, duration_s, n_steps, over)

    async def task(self) -> TaskStatus:
        """The present task's status, or the last one's."""
        if self._task_is_remote and self._task.running:
            try:
                answer = await self._tasks.ask(GetTask(), 0.1)
            except (AskTimeout, Unreachable):
                return self._task
            if isinstance(answer, TaskStatus):
                self._task = answer
        return self._task

    async def stop_task(self) -> TaskStatus | Refused:
        """End the rollout. Returns when the robot holds, whatever the policy does."""
        self._require()
        if not (await self.task()).running:
            return self._task
        local = self._node.ref(addresses.of(self.robot).policy, Policy)
        ref = self._tasks if self._task_is_remote else local
        try:
            answer = await ref.ask(StopTask(), ASK_S * 2)
        except (AskTimeout, Unreachable):
            answer = await self._gate.ask(Stop(Reason.POLICY, self._holder), STOP_S)
            self._end_policy("stopped")
        if isinstance(answer, TaskStatus):
            self._task = answer
        return self._task

    def _end_policy(self, reason: str) -> None:
        if self._policy_scope is not None:
            self._policy_scope.cancel()
            self._policy_scope = None
        task = self._task
        if task.running:
            self._task = TaskStatus(False, task.steps, task.elapsed_s, reason, "", "", task.instruction, task.hz)


def _refuse_shape(action: object) -> Refused | None:
    if isinstance(action, Mapping):
        return None
    kind = type(action).__name__
    return Refused("not_a_mapping", f"move: the action is a {kind}", "it must be a mapping of joints to numbers")


def _text(answer: object) -> str:
    return answer.text if isinstance(answer, Refused) else "no answer"
