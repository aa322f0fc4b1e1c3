"""The handle of one robot: synchronous methods that any thread may call.

Each call becomes a message to the robot's actors. Nothing here touches hardware.
"""

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
from strands_actors.supervisors.root.messages import UNREACHABLE, TaskStatus, TreeReport
from strands_actors.surfaces.agents.approval import APPROVE_S, Approval, approval_of
from strands_actors.surfaces.agents.calls import read
from strands_actors.surfaces.agents.tool import RobotTool
from strands_actors.surfaces.agents.use import perform, use
from strands_actors.surfaces.cameras.handle import Cameras

from ..processes.plan import Plan
from ..processes.robot_processes import CLEANED_UP
from ..processes.twin_process import TwinProcess
from ..resolve.planning import completed
from ..session.liveness import Liveness
from ..session.portal import portal
from ..session.tree import RobotTree
from . import envelopes as answers
from . import forked, moving, posing, reference_names, running, verbs
from .bus import Bus
from .envelopes import Answer, PendingAnswer
from .progress import LOOK_S, Show
from .verbs import Verb, VerbHere, answered, answered_here
from .vocabulary import call_of, find_verb, is_command, verb_names

if TYPE_CHECKING:
    from strands_actors.surfaces.cameras.frames import Frame
    from strands_actors.teleoperation.teleoperator import Teleoperator

TELEOP_LOOK_S = 0.1
"""Period at which ``teleoperate`` checks whether the teleoperation has ended."""

T = TypeVar("T")


class RealRobot(RobotTool):
    """Hardware, or a simulated robot (twin) that speaks the protocol of the hardware. ``Robot(...)`` makes it.

    The object is also a tool for strands-agents (``stream``, ``tool_spec``). Any thread may call its
    methods.

    Most methods return an envelope and do not raise. It is one of

        {"status": "success", "content": [{"json": {...}}]}
        {"status": "error", "content": [{"text": "what happened, and what to do"}, {"json": {...}}]}

    A refusal has a ``refused`` object in its JSON, with ``code``, ``reason`` and ``remedy``. "Keys",
    below, are the keys of the JSON of a success.

    Inside a running asyncio loop (an agent, a notebook), await ``stream``, ``stop`` and
    ``get_status``: they do not block the loop. The other methods block until their reply comes, which
    takes some milliseconds; with ``wait=True`` they block until the end of the motion.

    The services and verbs that the robot's driver declares are methods, too: ``robot.home()``.

    Example:
        with Robot("so101", mode="real", port="/dev/ttyACM0") as arm:  # connects and arms
            arm.move_to({"shoulder_pan": 10.0}, seconds=2.0)
            print(arm.get_observation())
    """

    LAZY: ClassVar[frozenset[str]] = frozenset({"move", "move_to", "run"})
    """Methods that connect the robot if the program has not done so. The driver's services and commands connect
    it, too. None of them connects to a robot that another program has started (``_is_shared``).
    """
    OTHERS_CONNECT: ClassVar[bool] = False
    """True if a call by an agent connects as well. False for hardware: the program decides what
    energises a robot."""

    def __init__(self, plan: Plan, approval: Approval | None = None, arm: bool = True) -> None:
        self._plan = plan
        self._arm = arm
        self._approval = approval or approval_of(plan.driver_class, (), None, APPROVE_S)
        self._liveness = Liveness()
        self._opened: RobotTree | None = None
        self._pid = os.getpid()
        self._driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        self._closed = False
        self._connect_requested = False
        self._connecting_first = threading.Lock()
        self._observing = verbs.Observing()
        # Two threads may connect at once. Only one of them may complete the plan.
        self._completing = trio.Lock()

    @property
    def id(self) -> str:
        """The robot's id, as it was given by ``id=``."""
        return self._plan.tool_name

    @property
    def tool_name(self) -> str:
        """The robot's id, under its name in strands-robots. It is also the name of the tool for agents."""
        return self._plan.tool_name

    @property
    def driver(self) -> Driver:
        """The driver of the robot. It declares axes, units, limits and services."""
        return self._driver

    @property
    def name(self) -> str:
        """The robot's name among the robots that run.

        It is ``id``, with a number if another robot has that id.
        """
        return self.tool_name if self._tree is None else self._tree.robot

    @property
    def robot_name(self) -> str:
        """The robot's name, for ``send_action(robot_name=...)``.

        It equals ``name``, which strands-robots calls ``robot_name``.
        """
        return self.name

    @property
    def twin_process(self) -> TwinProcess | None:
        """The process that simulates the robot; None for hardware."""
        return self._plan.twin_process

    @property
    def transport(self) -> str | None:
        """The transport that replaces a port, such as ``twin`` or ``sim``; None if the robot is at a port."""
        return self._plan.transport

    @property
    def data_config(self) -> Any:
        """The ``data_config`` of ``Robot(...)``, kept unchanged for code that builds a policy."""
        return self._plan.data_config

    def __repr__(self) -> str:
        address = self._plan.host_address or self._plan.transport or self._plan.port
        return f"<Robot {self.tool_name} ({self._plan.robot}, {address})>"

    @property
    def _tree(self) -> RobotTree | None:
        """The interface to the robot's processes; None before the first connect, and in a forked child.

        A forked child cannot use these processes, since they belong to its parent.
        """
        return self._opened if self._pid == os.getpid() else None

    @property
    def _forked(self) -> RobotTree | None:
        """The parent's ``_tree``, if this process was forked after the connect; otherwise None."""
        return self._opened if self._pid != os.getpid() else None

    # -- the loop

    def _call(self, verb: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
        with self._liveness:
            return portal().call(verb, *args)

    def _verb(self, verb: Verb, name: str, *args: Any) -> Answer:
        """Run a verb in the background loop. Return an error envelope if the robot is not connected."""
        tree = self._ready(name)
        if isinstance(tree, str):
            return answers.error(f"{name}: {tree}")
        return self._call(answered, name, verb, tree, *args)

    def _verb_here(self, blocking: VerbHere, verb: Verb, name: str, *args: Any) -> Answer:
        """Run a verb as ``_verb`` does, but in the calling thread if possible."""
        tree = self._ready(name)
        if isinstance(tree, str):
            return answers.error(f"{name}: {tree}")
        with self._liveness:
            answer = answered_here(name, blocking, tree, *args)
        return self._call(answered, name, verb, tree, *args) if answer is None else answer

    def _ready(self, name: str) -> RobotTree | str:
        """Return the tree (the robot's processes) for a verb, or the reason as text why there is no tree.

        Connect first, if this verb may connect a robot.
        """
        if self._forked is not None:
            return forked.reason_unavailable(self._pid, self._forked.robot)
        if not (self._connect_requested or self._closed or self._is_shared) and self._connects(name):
            problem = self._connect_first()
            # The robot may be connected but not armed. The called service may repair the cause, so it runs.
            if problem is not None and (name in self.LAZY or self._tree is None):
                return f"not connected: {problem}"
        return self._tree or (CLEANED_UP if self._closed else _NOT_CONNECTED)

    @property
    def _is_shared(self) -> bool:
        """True if another program has started the robot.

        A command then never connects, since that would energise a robot that a person may have stopped.
        """
        return bool(self._plan.host_address) or self._plan.attached

    def _connects(self, name: str) -> bool:
        """Return True if a verb connects the robot: a command, or a service that is not a stop."""
        if is_command(self._driver, name):
            return "move" in self.LAZY
        service = self._plan.driver_class.services(self._plan.options).get(name)
        return name in self.LAZY or (service is not None and service.stops is None)

    def _connect_first(self) -> str | None:
        """Connect once. If several threads call this, one connects and the others wait.

        A later call does not connect again. Otherwise it would energise a robot that was stopped during the
        first connect.
        """
        with self._connecting_first:
            if self._connect_requested:
                return None
            problem = self._connect_now()
            self._connect_requested = self._opened is not None
            return problem

    # -- lifecycle

    def connect_eagerly(self) -> str | None:
        """Start the robot's processes, connect, and energise (arm) the robot at its measured position.

        With ``Robot(..., arm=False)`` it connects only, and energises nothing.

        Returns:
            None if the robot is connected (and armed), otherwise the reason as text.
        """
        self._connect_requested = True
        return _with_verb(self._connect_now())

    def ensure_connected(self) -> str | None:
        """Connect if no call has connected yet, as the first command does.

        Unlike ``connect_eagerly`` it does not arm a robot again that was stopped meanwhile.

        Returns:
            None if it is connected, otherwise the reason as text.
        """
        return _with_verb(CLEANED_UP if self._closed else self._connect_first())

    def _connect_now(self) -> str | None:
        """Connect. Return None, or why it failed, as text without the name of the verb."""
        if self._closed:
            return CLEANED_UP
        try:
            return self._call(self._connect)
        except OSError as failure:  # The loop could not be started.
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
        # ``cleanup()`` sets ``_closed`` before it reads ``_opened``. This method sets ``_opened`` before it
        # reads ``_closed``. So if both run at once, at least one of the methods notices the other.
        if self._closed:
            self._opened = None
            return CLEANED_UP
        return await tree.connect(self._arm)

    async def _complete(self) -> str | None:
        """Read the options that only the robot knows (``Driver.complete``), and make a new plan and driver.

        Return None, or why the robot could not be read.
        """
        try:
            async with self._completing:
                self._plan = plan = await completed(self._plan)
        except WireDown as down:
            return str(down)
        self._driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        return None

    @property
    def is_connected(self) -> bool:
        """True if a reading came from the robot within the last second.

        An open port alone does not count.
        """
        status = self._status()
        return status is not None and status.connected and 0 <= status.age_s < 1.0

    def cleanup(self) -> Answer:
        """Make the robot safe, and end all processes that were started for it.

        A connect that runs at the same time fails, and energises nothing. A second call changes nothing. The
        object cannot be used again: make a new one.

        Returns:
            A success only if every motor confirmed the safe state. The keys are those of ``stop``.
        """
        parents = self._forked
        if parents is not None:
            unknown = forked.unknown("cleanup", self._pid, parents.robot, self._driver)
            return answers.stop_result("cleanup", unknown)
        # ``_connect`` relies on this order of ``_closed`` and ``_opened``.
        self._closed = True
        tree, self._opened = self._tree, None
        if tree is None:
            return answers.stop_result("cleanup", stop_result.Confirmed(stop_result.NothingRan()))
        return answers.stop_result("cleanup", self._call(tree.cleanup))

    def __enter__(self) -> Self:
        try:
            problem = self.connect_eagerly()
        except BaseException:
            # Python does not call ``__exit__`` if Ctrl-C interrupts ``__enter__``.
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
        """Send one setpoint to the robot. The setpoint is checked against the robot's limits, then written.

        It connects first if the program has not done so.

        Args:
            action: Target by joint, in the driver's units. ``get_status()`` has the unit. A position that is
                not named keeps its target. A speed that is not named goes to zero.
            robot_name: The robot that the command is meant for, in a program with several robots. The
                name of another robot is refused.

        Returns:
            A success if the setpoint was accepted. Keys: those of the driver, usually ``commanded`` (the
            accepted target by joint) and ``unit``.

        Example:
            answer = arm.send_action({"shoulder_pan": 10.0})
            if answer["status"] == "error":
                print(answer["content"][0]["text"])
        """
        if refused := verbs.refuse_name(robot_name, self._plan, self.name):
            return refused
        return self._verb_here(verbs.send_action_here, verbs.send_action, "move", action)

    def move_to(
        self,
        targets: Mapping[str, Any] | None = None,
        seconds: float | None = None,
        wait: bool = True,
        *,
        xyz: Sequence[float] | None = None,
        rpy: Sequence[float] | None = None,
        quat: Sequence[float] | None = None,
        frame: Literal["base", "tool"] | None = None,
        speed: float | None = None,
        linear: bool | None = None,
        keep_out: Sequence[Mapping[str, Sequence[float]]] | None = None,
    ) -> Answer:
        """Move the named joints smoothly to their targets, or the tool of an arm to a pose.

        The motion is a stream of setpoints. It is at rest at both ends. ``stop_task()`` and Ctrl-C end the
        motion, and the robot holds its position. A pose that cannot be reached is refused before anything moves.

        Args:
            targets: Target by joint, in the driver's units. Other joints stay where they are.
            seconds: Duration of a motion to ``targets``, above 0 and at most 600 s. None: 2 s. If it is too
                short for a joint, the motion is refused, and the refusal has the shortest possible time.
            wait: True returns at the end of the motion. False returns at once; ``get_task_status()``
                then shows the progress.
            xyz: Position of the tool in m. None keeps the position, if an orientation is given.
            rpy: Orientation of the tool as roll, pitch and yaw in degrees, about the fixed axes x, y and z.
                None keeps the orientation. An arm with five joints keeps it as nearly as the position allows.
            quat: The orientation as w, x, y, z, in place of ``rpy``.
            frame: ``base`` (the default): the pose is in the frame of the arm's base. ``tool``: it is relative
                to the present pose of the tool, along the axes of the tool.
            speed: Top speed of the tool in m/s, above 0 and at most 3. None: 0.1. The motion takes longer
                if a joint cannot follow.
            linear: True (the default) moves the tool along a straight line. False interpolates the joints.
            keep_out: Boxes that the arm may not enter: ``{"center": (x, y, z), "size": (x, y, z)}``, in m, along
                the axes of the base. They count for this motion only.

        Returns:
            A success if the motion has ended as planned (or has begun, with ``wait=False``). Keys:
            ``commanded``, ``unit``, ``seconds``; after the end ``took_s`` and ``position``, as measured
            by joint; with ``wait=False`` ``running``. A motion to a pose adds ``pose``, the planned pose at
            the end, and after the end ``measured_pose``, both with the keys of ``get_pose``.

        Example:
            here = arm.get_pose()["content"][0]["json"]["xyz"]
            arm.move_to(xyz=(here[0], here[1] + 0.05, here[2]))  # 5 cm to the left of the base
        """
        pose = posing.given(xyz=xyz, rpy=rpy, quat=quat, frame=frame, speed=speed, linear=linear, keep_out=keep_out)
        return self._in_time("move_to", posing.move_to, targets, seconds, wait, pose)

    def get_pose(self) -> Answer:
        """Return the measured pose of the arm's tool, in the frame of the arm's base.

        The tool of an arm is the middle of its flange, or a point between the fingers of its gripper. It is
        computed from the newest reading of the joints and the model of the arm.

        Returns:
            Keys: ``xyz`` in m, ``rpy`` (roll, pitch and yaw in degrees about the fixed axes x, y and z), and
            ``quat`` (the same orientation as w, x, y, z). If the controller of the arm reports the position of a
            tool, also ``reported_xyz``, and ``apart_m``, its distance from ``xyz``: the controller includes the
            tool centre point that is configured in it.
        """
        return self._verb(posing.get_pose, "get_pose")

    def move_along(self, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool = True) -> Answer:
        """Move to the first of ``rows`` as ``move_to`` does, then along all rows.

        Every step is checked against the robot's limits before anything moves.

        Args:
            rows: Targets by joint, in the driver's units. Every row names the same joints. The speeds of a row
                are sent unchanged, and zero is sent after the last row.
            hz: Rows per second, above 0 and at most 1000. Between two rows a joint moves in a straight
                line. The whole path takes at most 600 s.
            wait: As in ``move_to``.

        Returns:
            As ``move_to``, and ``rows``: their number.
        """
        return self._in_time("move_along", moving.move_along, rows, hz, wait)

    def _in_time(self, name: str, verb: Verb, *args: Any) -> Answer:
        """Run a verb that may wait for the end of a motion. Ctrl-C ends the motion."""
        try:
            return self._verb(verb, name, *args)
        except KeyboardInterrupt:
            self._verb(moving.end_motion, "stop_task")
            raise

    def release(self) -> Answer:
        """Release the lease, so that other programs (also on the mesh) may move the robot.

        The lease is the right to command the robot. If a target is still in force, the robot holds its position
        instead. The next command of this program acquires the lease again, if it is free.

        Returns:
            A success if the lease is released. Keys: ``released``, and those of ``stop``.
        """
        return self._verb(verbs.release, "release")

    @overload
    def get_observation(self, images: Literal[False] = False) -> dict[str, float]: ...
    @overload
    def get_observation(self, images: bool) -> dict[str, Any]: ...
    def get_observation(self, images: bool = False) -> dict[str, Any]:
        """Return the newest measured position of each joint, in the driver's units.

        It returns the last reading, and does not wait for a new one.

        Args:
            images: True adds the newest ``Frame`` of each camera under the camera's name; if the picture is too
                old, a ``Stale`` object with the reason.

        Returns:
            Position by joint, and no envelope. It is {} if there is no reading; the log then has the
            reason, once.
        """
        observation: dict[str, Any] = self._observing.positions(self._get_observation())
        return observation | self._cameras.looks() if images else observation

    def read_camera(self, name: str, max_age_ms: float | None = None) -> Frame:
        """Return the newest picture of a camera, without waiting.

        Args:
            name: Name of the camera, as in ``Robot(cameras=...)``.
            max_age_ms: Greatest age of the picture. None: three periods of the camera, and at least
                200 ms.

        Raises:
            StaleFrame: The newest picture is older, or there is no picture.
            ValueError: The robot has no camera of this name.
        """
        return self._cameras.read(name, max_age_ms)

    @property
    def _cameras(self) -> Cameras:
        tree = self._tree
        return Cameras(self._plan.cameras, self._plan.driver_class) if tree is None else tree.cameras

    def state(self) -> Answer:
        """Return the newest readings of the robot.

        Returns:
            Keys: ``positions`` and ``velocities`` by joint (null if unknown), ``unit``, ``age_s`` (seconds
            since the reading), ``state`` (such as ``armed`` or ``holding``), ``robot``. ``joints`` and
            ``joint_velocities`` are the same values under their names in strands-robots. A driver may add more:
            a UR its TCP pose, wrench and modes, a G1 its IMU and FSM.
        """
        return self._verb(verbs.get_state, "state")

    @property
    def bus(self) -> Bus:
        """The servos of a robot on a serial bus.

        Read them as in lerobot: ``arm.bus.sync_read("Present_Position")``.

        Raises:
            AttributeError: The robot has no serial bus.
        """
        if self._plan.driver_class.PORT_KIND != "serial":
            # Python then calls ``__getattr__``, which raises an ``AttributeError`` with a text.
            raise AttributeError
        return Bus(self._driver, self._newest)

    def service(self, name: str, *values: Any, action: Mapping[str, Any] | None = None, **arguments: Any) -> Answer:
        """Run a service of the robot's driver.

        Each service is a method, too: ``robot.release_sport_mode(attempts=3)``, or
        ``robot.release_sport_mode(3)``.

        Args:
            name: Name of the service.
            values: Arguments by position, in the service's order.
            action: A setpoint to write first. If it is refused, the service does not run.
            arguments: Arguments by name.

        Returns:
            A success with the result of the service as JSON.
        """
        named = verbs.name_values(self._plan, name, values, arguments)
        if isinstance(named, Refused):
            return answers.refused(named)
        return self._verb_here(verbs.service_here, verbs.service, name, name, named, action)

    def command(self, name: str, *values: Any, wait: bool = True, **inputs: Any) -> Answer:
        """Run a verb that the driver declares for agents.

        Each verb is a method, too: ``robot.home()``, ``robot.move(0.2, duration_s=3.0)``,
        ``robot.set_torque(True)``.

        Args:
            name: Name of the verb.
            values: Inputs by position.
            wait: If the verb takes time, True returns at its end, False at once.
            inputs: Inputs by name. Write ``_`` for a dot: ``linear_x``.

        Returns:
            An envelope. Its keys depend on the verb.
        """
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

    # robot.pyi lists the services of each robot. If a type checker saw this method, it would accept misspelled
    # names.
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return a service or verb of the driver as a method, or a method by its name in strands-robots."""
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
        """Stop the robot, and report the result of each motor.

        A stop de-energises every motor, or brings it to the state that the driver declares for a stop. Call it
        as ``stop()`` or as ``await stop()``. It needs no lease, and ends any motion or policy. If the process
        that talks to the robot does not answer, another process kills it and stops the robot over a separate
        path. In a forked child the command line stops the robot, which takes half a second.

        Returns:
            A success only if every motor confirmed its safe state. Keys: ``stopped``, ``reason``, ``safe_state``,
            ``path`` (``wire`` for the usual connection, ``stop_channel`` for the separate path), ``took_ms``,
            ``unconfirmed`` (joints), ``note``, and ``motors``: by joint ``id``, ``written``, ``acknowledged``,
            ``safe``, ``detail``. An error has the same keys if a report came.
        """
        return self._now_or_soon(lambda: self._stop_now("stop"), verbs.stop, "stop")

    def get_status(self) -> Answer | PendingAnswer:
        """Return the status of the robot and its processes.

        Call it as ``get_status()`` or as ``await get_status()``.

        Returns:
            A success, also if the robot does not answer. Keys, among others: ``connected``, ``connect_error``,
            ``state`` (such as ``armed``, or ``unreachable``), ``cause`` (why the robot is in this state; None while
            it is armed), ``last_stop_cause`` (why it last stopped or held, also while it is armed again),
            ``locked_by`` (the sender of an e-stop), ``lease`` (the holder of the right to command),
            ``observation_age_s``, ``last_refusal``, ``faults`` by joint, ``sensors``, ``fallbacks`` (safe state by
            reason), ``unit``.
        """
        return self._now_or_soon(self._get_status, verbs.get_status, "status")

    def resume(self) -> Answer:
        """Lift the lock of an e-stop, restart processes that have ended, and energise the robot.

        The robot is energised at its measured position. No motion starts.

        Returns:
            Keys: ``armed``, ``epoch`` (a counter that each stop, hold and arming raises, so that older setpoints
            are refused), ``position`` by joint, as measured.
        """
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
        """Run a policy object in this process. ``stop_task()`` ends it.

        Args:
            policy: An object with ``get_actions_sync``, ``get_actions`` or ``step``, or a callable. See
                ``Policy``.
            instruction: Text for the policy.
            duration: Longest time in seconds. It has no effect if ``n_steps`` is given.
            n_steps: Number of actions after which the policy ends.
            control_frequency: Actions per second, above 0 and at most 1000. None: the driver's control
                rate.
            policy_object: Another name of ``policy``.
            wait: True returns when the policy has ended. False returns at once.
            robot_name: The robot that it is meant for, as in ``send_action``.

        Returns:
            The status of the policy, with the keys of ``get_task_status``. With ``wait=True`` it is a success
            if the policy ended by ``duration``, ``n_steps`` or ``stop_task()``.

        Raises:
            Exception: With ``wait=True``, the exception that the policy raised.

        Example:
            arm.run_policy(MockPolicy(), duration=5.0, wait=True)
        """
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
        """Run a policy by name, in a separate process that builds it from ``options``. Return at once.

        If the policy freezes or crashes, the robot holds. ``stop_task()`` ends it.

        Args:
            instruction: Text for the policy.
            policy_port: Port of a policy server (``policy_provider="remote"``).
            policy_host: Host of that server.
            policy_provider: ``mock``, ``sine``, ``remote``, ``lerobot_local``, a registered name, the
                name of another package's policy, ``module:factory``, ``ws://host:port`` or ``zmq://host:port``.
            duration: Longest time in seconds.
            control_frequency: Actions per second, above 0 and at most 1000. None: the driver's control
                rate.
            options: Keyword arguments for the policy. They must be plain data.

        Returns:
            The status of the policy, with the keys of ``get_task_status``.
        """
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

    def run(
        self,
        policy: Any,
        seconds: float = running.DEFAULT_S,
        instruction: str = "",
        control_frequency: float | None = None,
        progress: Show | bool | None = None,
        max_age: float = running.MAX_AGE_S,
        **options: Any,
    ) -> Answer:
        """Let a policy control the robot for some seconds, and return what happened.

        Ctrl-C ends the policy. The robot then holds its position, and ``KeyboardInterrupt`` is raised. An object
        runs in this process. Any other policy runs in a separate process, as with ``start_task``.

        Args:
            policy: A policy object or a callable, as for ``run_policy``; a name, as for ``start_task``; the
                folder of a checkpoint; or a policy server, ``"ws://host:port"`` or ``"zmq://host:port"``.
            seconds: Duration from the first action. A policy may load for up to 300 s before it.
            instruction: Text for the policy.
            control_frequency: Actions per second, above 0 and at most 1000. None: the rate that the policy
                states, or else the driver's control rate.
            progress: A function that gets a dictionary ten times a second: ``running``, ``steps``, ``hz``,
                ``elapsed_s``, ``observation_age_s`` (age of the newest reading) and ``refused``. True: a line on
                standard error. False: nothing. None: a line if standard error is a terminal.
            max_age: Largest age of the reading from which an action was computed, when the action is sent, in
                seconds. An older action is never sent: the run ends, and the robot holds.
            options: Keyword arguments for a policy that runs in a separate process. They must be plain data.

        Returns:
            A success if the policy ran for the whole time and the robot confirmed the hold. Keys: ``robot``,
            ``policy``, ``source`` (object, name, folder or server), those of ``get_task_status``, ``refused``
            (setpoints that the gate refused), ``observation_age_s``, ``action_age_s`` (the largest age that
            ``max_age`` limits), and those of ``stop``.

        Example:
            arm.run("mock", seconds=5)
        """
        try:
            run = running.Run(
                self._driver, policy, seconds, instruction, control_frequency, progress, max_age, options
            )
        except (TypeError, ValueError) as failure:
            return answers.error(f"{running.RUN}: {failure}")
        begun = self._verb(run.begin, running.RUN)
        tree = self._tree
        if begun["status"] != "success" or tree is None:
            return begun
        try:
            while True:
                look = self._call(run.look, tree)
                if run.show is not None:
                    run.show(look._asdict())
                if not look.running:
                    break
                time.sleep(LOOK_S)
        except BaseException:
            # Ctrl-C, or an exception of the user's ``progress``.
            self.stop_task()
            raise
        return self._verb(run.end, running.RUN)

    def get_task_status(self) -> Answer:
        """Return the status of the policy, motion or teleoperation that runs, or of the last one.

        Returns:
            Keys: ``running``, ``steps``, ``elapsed_s``, ``hz`` (actions per second), ``instruction``,
            ``exit_reason`` (null while it runs; stopped, n_steps, duration, policy, gate, publish, stop,
            cleanup or refused), ``exit_detail``, ``refusal``; during a teleoperation ``teleop``. They
            are the same for every driver.
        """
        if self._tree is None and self._forked is None:
            return answers.success(answers.task(TaskStatus()))
        return self._verb(verbs.get_task_status, "task")

    def stop_task(self) -> Answer:
        """End the policy, motion or teleoperation, and return when the robot holds its position.

        A policy that does not answer cannot delay the hold.

        Returns:
            A success if the robot confirmed the hold. Keys: ``robot``, those of ``get_task_status``, and
            those of ``stop``.
        """
        return self._verb(verbs.stop_task, "stop_task")

    # -- teleoperation

    def attach_teleop(
        self,
        leader: Teleoperator | str | Mapping[str, Teleoperator],
        hz: float = 100.0,
        map_fn: Callable[..., Any] | None = None,
        deadman: str | None = None,
        max_speed: float | None = None,
        duration: float | None = None,
        **options: Any,
    ) -> Answer:
        """Let a leader control the robot until ``stop_task()``. Return at once.

        A leader is a device that a person moves. It is read in a separate process. ``get_task_status()`` shows
        the state of the teleoperation under ``teleop``.

        Args:
            leader: A ``Teleoperator``, or its name, such as ``"so101_leader"``. For a robot of parts, the
                ``Teleoperator`` of each part by the part's name.
            hz: Setpoints per second, above 0 and at most 500.
            map_fn: Converts the leader's positions (by joint) to the robot's. It must be a function of
                a module, since another process imports it.
            deadman: The dead-man switch. ``"gripper"``: the gripper of a leader arm, squeezed twice. ``"key"``:
                a key that ``operate()`` reports. None: the gripper for a leader arm, otherwise the key.
            max_speed: Degrees per second. A faster motion of the leader is refused. None: the speed limits of
                the robot's axes.
            duration: Longest time in seconds. None: no limit.
            options: If ``leader`` is a name, the keyword arguments of ``Teleoperator(...)``, such as
                ``port`` and ``id``.

        Returns:
            The keys of ``get_task_status``, and ``caveats`` if the leader has any.
        """
        from strands_actors.teleoperation.teleoperator import Teleoperator
        from strands_actors.teleoperation.verbs import attach  # Only a teleoperation needs this import.

        if isinstance(leader, str):
            try:
                leader = Teleoperator(leader, **options)
            except (TypeError, ValueError) as failure:
                return answers.error(f"teleoperate: {failure}")
        elif options:
            unused = ", ".join(options)
            return answers.error(
                f"teleoperate: {unused} of a leader that is made already. Give it to Teleoperator(...)"
            )
        begin = attach(self._driver, leader, hz, map_fn, deadman, max_speed, duration)
        return begin if isinstance(begin, Answer) else self._verb(begin, "teleoperate")

    def teleoperate(
        self,
        leader: Teleoperator | str | Mapping[str, Teleoperator] | None = None,
        hz: float = 100.0,
        map_fn: Callable[..., Any] | None = None,
        deadman: str | None = None,
        max_speed: float | None = None,
        duration: float | None = None,
        block: bool | None = None,
        **options: Any,
    ) -> Answer:
        """Let a leader (a device that a person moves) control the robot, and wait for the end.

        Ctrl-C ends the teleoperation, and the robot holds its position.

        Args:
            leader: As in ``attach_teleop``. None: the leader that was attached before continues
                with its settings. ``hz``, ``map_fn``, ``deadman``, ``max_speed`` and ``options`` are then
                refused.
            hz: As in ``attach_teleop``.
            map_fn: As in ``attach_teleop``.
            deadman: As in ``attach_teleop``.
            max_speed: As in ``attach_teleop``.
            duration: Longest time in seconds. Without a ``leader`` it needs ``block=True``.
            block: True waits for the end, False returns at once. None: wait if a ``leader`` is given.
            options: As in ``attach_teleop``.

        Returns:
            As ``get_task_status``, or as ``stop_task`` if this call ended it.
        """
        block_value: object = block
        if not (block_value is None or isinstance(block_value, bool)):  # The text "no" would count as true.
            return answers.error(f"teleoperate: block is {shown(block_value)}. Give True or False")
        end_s = math.inf
        if leader is None:
            if options or hz != 100.0 or map_fn or deadman or max_speed is not None or (duration and not block):
                return answers.error(
                    "teleoperate: the leader that is attached keeps its settings. Give them to attach_teleop()"
                )
            if duration is not None:
                end_s = time.monotonic() + duration
            answer = self.get_task_status()
            if answer["status"] == "success" and not answer["content"][0]["json"]["running"]:
                reason = "no leader is attached"
                answer = answers.error(f"teleoperate: {reason}. Give a Teleoperator, or call attach_teleop() first")
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
        """Send the operator's input to the teleoperation. It expires after 0.2 s, so send it repeatedly.

        Args:
            held: True while the operator holds the dead-man switch.
            rates: For a ``keyboard``, the speed of each axis as a share of its full rate, -1 to 1. The tool of an
                arm has the rates ``ee_x``, ``ee_y``, ``ee_z`` (0.1 m/s at 1) and ``ee_wx``, ``ee_wy``, ``ee_wz``
                (30 degrees/s at 1), along and about the axes of the arm's base.

        Returns:
            Key: ``held``. A wrong input is refused and moves nothing. ``held=False`` takes effect even if
            a rate is refused.
        """
        from strands_actors.teleoperation.verbs import operate

        run = operate(self._driver, held, rates)
        return run if isinstance(run, Answer) else self._verb(run, "operate")

    # -- the tool for agents

    async def use_tool(self, tool_input: object, by: str) -> Answer:
        """Run the verb that a tool's input requests. Call it from an asyncio loop.

        Args:
            tool_input: The input of the tool.
            by: The name of the caller, for approval and audit.
        """
        # Only a caller with an asyncio loop gets here. Scripts without such a loop do not import asyncio, which
        # saves 8 ms.
        import asyncio

        call = read(self._driver, tool_input)
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
        """Return the robot's processes and actors, as ``strands-actors tree --json`` prints them.

        Returns:
            Keys: ``robot``, ``state`` (``unreachable`` if the processes do not answer), ``epoch`` (a counter that
            each stop, hold and arming raises), ``locked_by`` (the sender of an e-stop), ``processes``, ``actors``.
            None if this program has not connected.
        """
        tree = self._tree
        if self._forked is not None:
            return answers.tree(TreeReport(self._forked.robot, UNREACHABLE, 0, (), ()))
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
        """Return the newest observation. Raise ``ConnectionError`` if there is no observation."""
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
        """Run a verb and return its result.

        Inside a running asyncio loop it only starts the verb, and returns a ``PendingAnswer``. The loop can
        await it without being blocked.
        """
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


_NAMES = {"action": "move", "torque": "resume", "sensors": "observe", "state": "observe", "pose": "observe"}
"""The method that corresponds to an agent's verb, by what that verb does."""

_NOT_CONNECTED = "not connected. Call connect_eagerly() first"


def _with_verb(problem: str | None) -> str | None:
    return None if problem is None else f"connect: {problem}"
