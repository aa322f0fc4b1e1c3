"""A handle on one robot: synchronous verbs, safe to call from any thread. Each call is a message to
the robot's actors; nothing here touches hardware."""

from __future__ import annotations

import functools
import math
import os
import threading
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar, overload

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import shown
from strands_actors.contract.wire import Observation, WireDown
from strands_actors.kernel.messages import Refused
from strands_actors.policies.registry import DEFAULT_PROVIDER
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.gate.messages import Status
from strands_actors.supervisors.loading import build_driver
from strands_actors.supervisors.root.messages import TaskStatus, TreeReport
from strands_actors.surfaces.agents.approval import APPROVE_S, Approval, approval_of
from strands_actors.surfaces.agents.calls import read
from strands_actors.surfaces.agents.tool import RobotTool
from strands_actors.surfaces.agents.use import perform, use
from strands_actors.surfaces.cameras.handle import Cameras

from . import envelopes as answers
from . import forked, moving, reference_names, verbs
from .bus import Bus
from .envelopes import Answer, PendingAnswer
from .liveness import Liveness
from .plan import Plan, completed
from .portal import portal
from .processes import CLEANED_UP
from .tree import RobotTree
from .twin_process import TwinProcess
from .verbs import Verb, VerbHere, answered, answered_here
from .vocabulary import call_of, find_verb, is_command, verb_names

if TYPE_CHECKING:
    from strands_actors.surfaces.cameras.frames import Frame
    from strands_actors.teleoperation.teleoperator import Teleoperator

TELEOP_LOOK_S = 0.1
"""Between two looks at whether a teleoperation has ended."""

T = TypeVar("T")


class RealRobot(RobotTool):
    """A robot behind its wire. Made by ``Robot(...)``. A strands-agents tool (``stream``,
    ``tool_spec``).

    Verbs may be called from any thread. Inside a running asyncio loop (an agent, a notebook)
    ``stream``, ``stop`` and ``get_status`` are to be awaited and do not block it; the others wait
    for their answer: milliseconds.
    """

    LAZY: ClassVar[frozenset[str]] = frozenset({"move", "move_to"})
    """Verbs of this program that connect by themselves when nobody has, as the driver's services do;
    never to a robot of another host, where connecting resumes one that holds."""
    OTHERS_CONNECT: ClassVar[bool] = False
    """Whether they do so for an agent, too: what energises a robot is for the program to decide."""

    def __init__(self, plan: Plan, approval: Approval | None = None, arm: bool = True) -> None:
        self._plan = plan
        self._arm = arm
        self._approval = approval or approval_of(plan.driver_class, (), None, APPROVE_S)
        self._liveness = Liveness()
        self._opened: RobotTree | None = None
        self._pid = os.getpid()
        self._driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        self._closed = False
        self._asked_to_connect = False
        self._connecting_first = threading.Lock()
        self._observing = verbs.Observing()
        self._completing = trio.Lock()  # two threads may connect at once

    @property
    def tool_name(self) -> str:
        return self._plan.tool_name

    @property
    def driver(self) -> Driver:
        return self._driver

    @property
    def name(self) -> str:
        """Return its name among the robots that run: ``tool_name``, numbered when that was
        taken."""
        return self.tool_name if self._tree is None else self._tree.robot

    @property
    def robot_name(self) -> str:
        """Return what ``send_action(robot_name=...)`` takes for this robot, as strands-robots calls
        it."""
        return self.name

    @property
    def twin_process(self) -> TwinProcess | None:
        """Return the process of its twin, if it has one."""
        return self._plan.twin_process

    @property
    def transport(self) -> str | None:
        """Return what is instead of a port: ``twin``, ``sim``."""
        return self._plan.transport

    @property
    def data_config(self) -> Any:
        return self._plan.data_config

    def __repr__(self) -> str:
        where = self._plan.at or self._plan.transport or self._plan.port
        return f"<Robot {self.tool_name} ({self._plan.robot}, {where})>"

    @property
    def _tree(self) -> RobotTree | None:
        """None in a forked child, too: the tree is its parent's."""
        return self._opened if self._pid == os.getpid() else None

    @property
    def _forked(self) -> RobotTree | None:
        """Return the tree of the parent, in a child that was forked from it."""
        return self._opened if self._pid != os.getpid() else None

    # -- the loop

    def _call(self, verb: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
        with self._liveness:
            return portal().call(verb, *args)

    def _verb(self, verb: Verb, name: str, *args: Any) -> Answer:
        """Run a verb on the tree; what keeps it from running at all is an error envelope."""
        tree = self._ready(name)
        if isinstance(tree, str):
            return answers.error(f"{name}: {tree}")
        return self._call(answered, name, verb, tree, *args)

    def _verb_here(self, here: VerbHere, verb: Verb, name: str, *args: Any) -> Answer:
        """As ``_verb``, but in this thread, unless the loop has to."""
        tree = self._ready(name)
        if isinstance(tree, str):
            return answers.error(f"{name}: {tree}")
        with self._liveness:
            answer = answered_here(name, here, tree, *args)
        return self._call(answered, name, verb, tree, *args) if answer is None else answer

    def _ready(self, name: str) -> RobotTree | str:
        """Return the tree for a verb, or why there is none."""
        if self._forked is not None:
            return forked.why_unknown(self._pid, self._forked.robot)
        if not (self._asked_to_connect or self._closed or self._plan.at) and self._connects(name):
            problem = self._connect_first()
            # A service may be what mends the reason why it is not armed.
            if problem is not None and (name in self.LAZY or self._tree is None):
                return f"not connected: {problem}"
        return self._tree or (CLEANED_UP if self._closed else _NOT_CONNECTED)

    def _connects(self, name: str) -> bool:
        """Return whether a verb connects by itself: a command, and a service that is no stop."""
        if is_command(self._driver, name):
            return "move" in self.LAZY
        service = self._plan.driver_class.services(self._plan.options).get(name)
        return name in self.LAZY or (service is not None and service.stops is None)

    def _connect_first(self) -> str | None:
        """Connect once, whichever thread is first: the others wait for it. Not tried again when
        there is a tree: a stop during bring-up must stand."""
        with self._connecting_first:
            if self._asked_to_connect:
                return None
            problem = self._connect_now()
            self._asked_to_connect = self._opened is not None
            return problem

    # -- lifecycle

    def connect_eagerly(self) -> str | None:
        """Start the tree, connect, and arm at the measured position (unless it was made with
        ``arm=False``). None, or why not."""
        self._asked_to_connect = True
        return _told(self._connect_now())

    def ensure_connected(self) -> str | None:
        """Connect as the first command does, unless that was done. None, or why not. Who stopped it
        meanwhile finds it stopped."""
        return _told(CLEANED_UP if self._closed else self._connect_first())

    def _connect_now(self) -> str | None:
        """Return why it is not connected, without the verb."""
        if self._closed:
            return CLEANED_UP
        try:
            return self._call(self._connect)
        except OSError as failure:  # there is no loop to connect in
            return str(failure)

    async def _connect(self) -> str | None:
        if self._tree is None and (problem := await self._complete()):
            return problem
        tree = self._tree
        if tree is None:
            shared = portal()
            tree = RobotTree(shared.node, shared.nursery, shared.entrance, self._plan, self._liveness.look)
            self._pid = os.getpid()
            self._opened = tree
        if self._closed:  # looked at last, as ``cleanup()`` sets it first: one of the two sees the other
            self._opened = None
            return CLEANED_UP
        return await tree.connect(self._arm)

    async def _complete(self) -> str | None:
        """Have the robot say what only it can tell."""
        try:
            async with self._completing:
                self._plan = plan = await completed(self._plan)
        except WireDown as down:
            return str(down)
        self._driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        return None

    @property
    def is_connected(self) -> bool:
        """Return whether frames arrive from the robot, not whether a port is open."""
        status = self._status()
        return status is not None and status.connected and 0 <= status.age_s < 1.0

    def cleanup(self) -> Answer:
        """Make the robot safe and end everything that was started for it, by a connect that is
        under way too: that one is refused, and energises nothing any more. Harmless when called
        again."""
        parents = self._forked
        if parents is not None:
            unknown = forked.unknown("cleanup", self._pid, parents.robot, self._driver)
            return answers.stop_result("cleanup", unknown)
        self._closed = True  # before anything is looked at: see ``_connect``
        tree, self._opened = self._tree, None
        if tree is None:
            return answers.stop_result("cleanup", stop_result.Confirmed(stop_result.NothingRan()))
        return answers.stop_result("cleanup", self._call(tree.cleanup))

    def __enter__(self) -> Self:
        try:
            problem = self.connect_eagerly()
        except BaseException:  # Ctrl-C: no block begins, so none ends
            self.cleanup()
            raise
        if problem is not None:
            self.cleanup()
            raise ConnectionError(problem)
        return self

    def __exit__(self, *_: object) -> None:
        answers.warn_unless_safe(self.name, self.cleanup())

    # -- verbs

    def send_action(self, action: Mapping[str, Any], robot_name: str | None = None) -> Answer:
        """Send one command: joints by name, in the driver's units. Refused with a reason, or
        written. ``robot_name``: who it is meant for, where a program has several; another robot's
        is refused."""
        if refused := verbs.refuse_name(robot_name, self._plan, self.name):
            return refused
        return self._verb_here(verbs.send_action_here, verbs.send_action, "move", action)

    def move_to(self, targets: Mapping[str, Any], seconds: float = moving.DEFAULT_S, wait: bool = True) -> Answer:
        """Move the named joints to their targets in so many seconds, smoothly, from where they are.

        Args:
            targets: A number for each joint, in the driver's units. Others stay where they are.
            seconds: How long it takes. Refused, with the least, when that is too fast for a joint.
            wait: Return when the motion is over, with ``position`` as measured then. False: return at
                once. ``get_task_status()`` tells how it goes, ``stop_task()`` ends it.
        """
        return self._in_time("move_to", moving.move_to, targets, seconds, wait)

    def move_along(self, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool = True) -> Answer:
        """Move to the first of ``rows`` as ``move_to`` does, then along all of them.

        Args:
            rows: Targets, in the driver's units, of the same joints in each row. A speed is sent as its
                row has it, and zero after the last.
            hz: Rows a second. Between two of them a joint goes in a straight line.
            wait: As in ``move_to``.
        """
        return self._in_time("move_along", moving.move_along, rows, hz, wait)

    def _in_time(self, name: str, verb: Verb, *args: Any) -> Answer:
        """Run a verb that may wait for a motion. Ctrl-C ends the motion."""
        try:
            return self._verb(verb, name, *args)
        except KeyboardInterrupt:
            self._verb(moving.end_motion, "stop_task")
            raise

    def release(self) -> Answer:
        """Give the lease up, so that others, on the mesh too, may move the robot. What was latched
        is held."""
        return self._verb(verbs.release, "release")

    @overload
    def get_observation(self, images: Literal[False] = False) -> dict[str, float]: ...
    @overload
    def get_observation(self, images: bool) -> dict[str, Any]: ...
    def get_observation(self, images: bool = False) -> dict[str, Any]:
        """Return positions by joint, in the driver's units; {} (and a log line that says why, once)
        when there is none. ``images``: and of each camera, by its name, the newest ``Frame``, or a
        ``Stale`` that says why there is none that is new enough. Nothing is waited for."""
        seen: dict[str, Any] = self._observing.positions(self._get_observation())
        return seen | self._cameras.looks() if images else seen

    def read_camera(self, name: str, max_age_ms: float | None = None) -> Frame:
        """Return the newest picture of a camera (``cameras=``), at once. ``max_age_ms``: how old it
        may be; by default three periods of the camera, and at least 200. Raise ``StaleFrame`` when
        there is none so new, ``ValueError`` for a name that is none."""
        return self._cameras.read(name, max_age_ms)

    @property
    def _cameras(self) -> Cameras:
        tree = self._tree
        return Cameras(self._plan.cameras, self._plan.driver_class) if tree is None else tree.cameras

    def state(self) -> Answer:
        """Return what the robot measures now: positions and velocities, with their age, and what
        its driver has beside them under the names of its users: a UR's TCP pose, wrench and modes,
        a G1's imu and FSM."""
        return self._verb(verbs.get_state, "state")

    @property
    def bus(self) -> Bus:
        """Return the servos of a robot on a serial bus, to be read as lerobot's are:
        ``arm.bus.sync_read("Present_Position")``. Raise ``AttributeError`` for a robot without
        one."""
        if self._plan.driver_class.PORT_KIND != "serial":
            raise AttributeError  # and ``__getattr__`` says why
        return Bus(self._driver, self._newest)

    def service(self, name: str, *values: Any, action: Mapping[str, Any] | None = None, **arguments: Any) -> Answer:
        """Do one of the driver's own services. Each is a method, too:
        ``robot.release_sport_mode(attempts=3)``, or ``robot.release_sport_mode(3)``. ``values``: of
        its arguments in their order. ``action``: a command that is written first; when it is refused,
        so is the service."""
        named = verbs.name_values(self._plan, name, values, arguments)
        if isinstance(named, Refused):
            return answers.refused(named)
        return self._verb_here(verbs.service_here, verbs.service, name, name, named, action)

    def command(self, name: str, *values: Any, wait: bool = True, **inputs: Any) -> Answer:
        """Do one of the verbs that the driver declares for agents. Each is a method, too: ``robot.home()``,
        ``robot.move(0.2, duration_s=3.0)``, ``robot.set_torque(True)``. ``wait``: of one that lasts,
        return when it is over."""
        call = call_of(self._driver, name, values, inputs)
        if isinstance(call, Refused):
            return answers.refused(call)
        if call.kind == "stop":
            return self._stop_now(name)
        if call.verb.does == "status":
            return self._get_status()
        if call.verb.does == "action" and call.held_s is None:
            return self._verb_here(verbs.send_action_here, verbs.send_action, name, call.action)
        return self._in_time(name, perform, call, wait)

    if not TYPE_CHECKING:  # robot.pyi names the services of each robot, so that a slip is seen

        def __getattr__(self, name: str) -> Any:
            """Return the driver's own services and verbs as methods, and names of strands-robots."""
            if name == "bus":
                raise AttributeError(f"{self._plan.robot} has no bus of servos. Use state() or get_observation()")
            plan = self.__dict__.get("_plan")
            if name == "mesh":
                return reference_names.Mesh(lambda: self.name)
            if find_verb(self.__dict__.get("_driver"), name) and not verbs.is_service(plan, name):
                return functools.partial(self.command, name)
            own = reference_names.ALIASES.get(name, "")
            if (
                own
                and not verbs.is_service(plan, name)
                and (hasattr(type(self), own) or verbs.is_service(plan, own))
            ):
                return getattr(self, own)
            verbs.require_service(self, plan, name)
            return functools.partial(self.service, name)

    def __dir__(self) -> list[str]:
        services = self._plan.driver_class.services(self._plan.options)
        return sorted({*super().__dir__(), *services, *verb_names(self._driver)})

    def stop(self) -> Answer | PendingAnswer:
        """De-energise every motor and report each. Works as ``stop()`` and as ``await stop()``. In a
        forked child the command line stops it, which takes half a second."""
        return self._now_or_soon(lambda: self._stop_now("stop"), verbs.stop, "stop")

    def get_status(self) -> Answer | PendingAnswer:
        """Return what the tree says of itself. Works as ``get_status()`` and as ``await
        get_status()``."""
        return self._now_or_soon(self._get_status, verbs.get_status, "status")

    def resume(self) -> Answer:
        """Lift a lockout, restart what has died, energise at the measured position. Restarts no
        motion."""
        return self._verb(verbs.resume, "resume")

    def run_policy(
        self,
        policy: Any = None,
        instruction: str = "",
        duration: float = 30.0,
        n_steps: int | None = None,
        control_frequency: float | None = None,
        policy_object: Any = None,
        wait: bool = False,
        robot_name: str | None = None,
    ) -> Answer:
        """Run a policy of this process: an object with ``get_actions`` or ``step``, or a callable.
        Returns at once; ``n_steps`` wins over ``duration`` (seconds). ``wait``: return when it has
        ended, with its status, and raise what the policy raised. ``robot_name``: who it is meant for,
        as in ``send_action``."""
        if refused := verbs.refuse_name(robot_name, self._plan, self.name, "run_policy"):
            return refused
        run = verbs.run_policy(policy, policy_object, instruction, duration, n_steps, control_frequency, wait)
        return run if isinstance(run, Answer) else self._verb(run, "run_policy")

    def start_task(
        self,
        instruction: str = "",
        policy_port: int | None = None,
        policy_host: str = "localhost",
        policy_provider: str = DEFAULT_PROVIDER,
        duration: float = 30.0,
        control_frequency: float | None = None,
        **options: Any,
    ) -> Answer:
        """Run a named policy (``mock``, ``remote`` at ``policy_host:policy_port``, one of another
        package) in a process of its own, built there from ``options``. Returns at once."""
        start = verbs.start_task(
            self._driver,
            policy_provider,
            policy_host,
            policy_port,
            options,
            instruction,
            duration,
            control_frequency,
        )
        return start if isinstance(start, Answer) else self._verb(start, "start_task")

    def get_task_status(self) -> Answer:
        """Return the present rollout, or the last one: the same keys for every driver."""
        if self._tree is None and self._forked is None:
            return answers.success(answers.task(TaskStatus()))
        return self._verb(verbs.get_task_status, "task")

    def stop_task(self) -> Answer:
        """End the rollout; returns when the robot holds, whatever the policy does."""
        return self._verb(verbs.stop_task, "stop_task")

    # -- teleoperation

    def attach_teleop(
        self,
        leader: Teleoperator | str,
        hz: float = 100.0,
        map_fn: Callable[..., Any] | None = None,
        deadman: str | None = None,
        max_speed: float | None = None,
        duration: float | None = None,
        **options: Any,
    ) -> Answer:
        """Have the robot led, in a process of its own, until ``stop_task()``. Returns at once;
        ``get_task_status()`` says how it goes. ``map_fn``: from the leader's positions by joint to
        the robot's; a function of a module. ``deadman``: ``"gripper"``, a leader's own, squeezed
        twice, or ``"key"``, told by ``operate()``. ``max_speed``: degrees a second; a frame that
        asks for more is refused. ``duration``: seconds. ``leader`` may be a name, such as
        ``"so101_leader"``: then ``options`` (``port``, ``id``) are those of ``Teleoperator(...)``."""
        from strands_actors.teleoperation.teleoperator import Teleoperator
        from strands_actors.teleoperation.verbs import attach  # for who leads a robot

        if isinstance(leader, str):
            try:
                leader = Teleoperator(leader, **options)
            except (TypeError, ValueError) as failure:
                return answers.error(f"teleoperate: {failure}")
        elif options:
            unused = ", ".join(options)
            return answers.error(
                f"teleoperate: {unused} of a leader that is made already. give it to Teleoperator(...)"
            )
        begin = attach(self._driver, leader, hz, map_fn, deadman, max_speed, duration)
        return begin if isinstance(begin, Answer) else self._verb(begin, "teleoperate")

    def teleoperate(
        self,
        leader: Teleoperator | str | None = None,
        hz: float = 100.0,
        map_fn: Callable[..., Any] | None = None,
        deadman: str | None = None,
        max_speed: float | None = None,
        duration: float | None = None,
        block: bool | None = None,
        **options: Any,
    ) -> Answer:
        """As ``attach_teleop``, and wait until it has ended; Ctrl-C ends it, and the robot
        holds. Without a ``leader``: the one that was attached leads on, and ``duration`` (with
        ``block=True``) ends it. ``block``: whether to wait; left out, with a leader only."""
        given: object = block
        if not (given is None or isinstance(given, bool)):  # the text "no" would be a yes
            return answers.error(f"teleoperate: block is {shown(given)}. give True or False")
        end_s = math.inf
        if leader is None:
            if options or hz != 100.0 or map_fn or deadman or max_speed is not None or (duration and not block):
                return answers.error(
                    "teleoperate: the leader that is attached keeps its settings. give them to attach_teleop()"
                )
            if duration is not None:
                end_s = time.monotonic() + duration
            answer = self.get_task_status()
            if answer["status"] == "success" and not answer["content"][0]["json"]["running"]:
                why = "no leader is attached"
                answer = answers.error(f"teleoperate: {why}. give a Teleoperator, or call attach_teleop() first")
        else:
            answer = self.attach_teleop(leader, hz, map_fn, deadman, max_speed, duration, **options)
        if not (leader is not None if block is None else block):
            return answer
        try:
            while answer["status"] == "success" and answer["content"][0]["json"]["running"]:
                time.sleep(TELEOP_LOOK_S)
                answer = self.get_task_status() if time.monotonic() < end_s else self.stop_task()
        except KeyboardInterrupt:
            answer = self.stop_task()
        return answer

    def operate(self, held: bool, **rates: float) -> Answer:
        """Tell the teleoperation what its operator does: whether the dead-man is held, and of a
        ``keyboard`` how fast each axis is to go, -1..1. It stands for 0.2 s: tell it again. What is
        neither is refused, and tells it nothing."""
        from strands_actors.teleoperation.verbs import operate

        run = operate(self._driver, held, rates)
        return run if isinstance(run, Answer) else self._verb(run, "operate")

    # -- as a tool

    async def use_tool(self, given: object, by: str) -> Answer:
        """Do what a tool's input asks for, from an asyncio loop."""
        import asyncio  # who has a loop has it; a script without one is spared 8 ms

        call = read(self._driver, given)
        if isinstance(call, Refused):
            return answers.refused(call)
        if self._tree is None and call.verb.does == "status":
            return self._get_status()
        name = call.verb.name
        tree: RobotTree | str | None = self._tree
        if self._forked is not None:
            if call.kind == "stop":
                return await asyncio.to_thread(self._stop_from_child)
            tree = self._ready(name)
        elif tree is None and not self.OTHERS_CONNECT:
            tree = CLEANED_UP if self._closed else _NOT_CONNECTED
        elif tree is None:
            tree = await asyncio.to_thread(self._ready, _NAMES.get(call.verb.does, name))
        if isinstance(tree, str):
            return answers.error(f"{name}: {tree}")
        with self._liveness:
            doing = portal().submit(answered, name, use, tree, call, self._approval, by)
            return await asyncio.wrap_future(doing)

    def tree(self) -> dict[str, Any] | None:
        """Processes and actors, as ``strands-actors tree --json`` shows them; None when nothing was
        started from here. The state of a tree that does not answer is ``unreachable``."""
        tree = self._tree
        if self._forked is not None:
            return answers.tree(TreeReport(self._forked.robot, answers.UNREACHABLE, 0, (), ()))
        report = None if tree is None else self._call(tree.describe)
        return None if report is None else answers.tree(report)

    # -- helpers

    def _stop_now(self, name: str) -> Answer:
        if self._forked is not None:
            return self._stop_from_child()
        return self._verb_here(verbs.stop_here, verbs.stop, name)

    def _stop_from_child(self) -> Answer:
        assert self._forked is not None
        return answers.stop_result("stop", forked.stop(self._forked.robot, self._driver))

    def _get_observation(self) -> Answer:
        return self._verb_here(verbs.get_observation_here, verbs.get_observation, "observe")

    def _newest(self) -> Observation:
        """Return the newest observation. Raise ``ConnectionError`` without one."""
        status = self._status()
        if status is None or status.observation is None or not status.connected:
            raise ConnectionError(f"bus: {CLEANED_UP if self._closed else _NOT_CONNECTED}")
        return status.observation

    def _status(self) -> Status | None:
        tree = self._tree
        return None if tree is None else self._call(tree.status)

    def _get_status(self) -> Answer:
        tree, plan = self._ready("status"), self._plan
        if isinstance(tree, str):
            return answers.success(answers.status(plan.tool_name, plan.robot, self._driver, tree, None, {}))
        return self._call(answered, "status", verbs.get_status, tree)

    def _now_or_soon(self, now: Callable[[], Answer], verb: Verb, name: str) -> Answer | PendingAnswer:
        """Inside a running asyncio loop: under way at once, to be awaited without blocking the
        loop."""
        if not answers.in_asyncio():
            return now()
        if self._tree is None:
            done: Future[Answer] = Future()
            done.set_result(now())
            return PendingAnswer(done)
        self._liveness.enter()
        future = portal().submit(answered, name, verb, self._tree)
        future.add_done_callback(lambda _: self._liveness.leave())
        return PendingAnswer(future)


_NAMES = {"action": "move", "torque": "resume", "sensors": "observe", "state": "observe"}
"""The robot's own verb for what an agent's verb does."""

_NOT_CONNECTED = "not connected; call connect_eagerly() first"


def _told(problem: str | None) -> str | None:
    return None if problem is None else f"connect: {problem}"
