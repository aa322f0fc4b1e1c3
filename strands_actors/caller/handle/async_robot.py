"""``open_robot(...)``: use one robot in a trio program, with the methods and results of ``Robot``."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, overload

import trio

from strands_actors.contract.wire import Observation, WireDown
from strands_actors.kernel.messages import Refused
from strands_actors.policies.registry import DEFAULT_PROVIDER
from strands_actors.surfaces.agents.approval import APPROVE_S, Approval, Approve, approval_of
from strands_actors.surfaces.agents.calls import read, tool_spec
from strands_actors.surfaces.agents.use import perform, use

from ..processes.plan import Plan
from ..processes.twin_process import TwinProcess
from ..resolve.planning import completed, plan
from ..session.portal import open_caller
from ..session.tree import RobotTree
from . import envelopes as answers
from . import moving, posing, running, verbs
from .envelopes import Answer
from .progress import LOOK_S, Show
from .verbs import answered
from .vocabulary import call_of, find_verb

if TYPE_CHECKING:
    from strands_actors.surfaces.cameras.frames import Frame


class Observations(AsyncIterator[dict[str, float]]):
    """Yield the positions by joint, in the driver's units, once per period.

    It skips periods without a reading, and periods that the loop has missed. It holds no open resource, so a
    program may leave the ``async for`` loop at any time.
    """

    def __init__(self, tree: RobotTree, hz: float) -> None:
        if not 0 < hz <= 1000:
            raise ValueError(f"observations: hz is {hz!r}. Give a rate in hertz, above 0 and at most 1000")
        self._tree = tree
        self._period_s = 1.0 / hz
        self._last_s = trio.current_time()

    async def __anext__(self) -> dict[str, float]:
        while True:
            self._last_s = max(self._last_s + self._period_s, trio.current_time())
            await trio.sleep_until(self._last_s)
            answer = await self._tree.observe()
            if isinstance(answer, Observation):
                return self._tree.driver.observed(answer)


class AsyncRobot:
    """A connected robot in a trio program. ``open_robot(...)`` makes it.

    It has the methods of ``RealRobot``, as coroutines for the trio loop in which the robot was opened. All
    return an envelope (a dict of ``status`` and ``content``) except ``get_observation``, ``observations`` and
    ``read_camera``.
    """

    def __init__(self, tree: RobotTree, approval: Approval) -> None:
        self._tree = tree
        self._plan = tree.plan
        self._approval = approval
        self._observing = verbs.Observing()
        self.driver = tree.driver

    @property
    def id(self) -> str:
        """The robot's id, as it was given by ``id=``."""
        return self._plan.tool_name

    @property
    def tool_name(self) -> str:
        """The robot's id, under its name in strands-robots. It is also the name of the tool for agents."""
        return self._plan.tool_name

    @property
    def name(self) -> str:
        """The robot's name among the robots that run.

        It is ``id``, with a number if another robot has that id.
        """
        return self._tree.robot

    @property
    def twin_process(self) -> TwinProcess | None:
        """The process that simulates the robot; None for hardware."""
        return self._plan.twin_process

    @property
    def transport(self) -> str | None:
        """The transport that replaces a port, such as ``twin`` or ``sim``; None if the robot is at a port."""
        return self._plan.transport

    @property
    def tool_spec(self) -> dict[str, Any]:
        """The tool's description for agents: name, verbs and schema of the input."""
        return tool_spec(self.tool_name, self.driver)

    async def send_action(self, action: Mapping[str, Any], robot_name: str | None = None) -> Answer:
        """Send one setpoint to the robot. Arguments and keys are those of ``RealRobot.send_action``."""
        if refused := verbs.refuse_name(robot_name, self._plan, self.name):
            return refused
        return await answered("move", verbs.send_action, self._tree, action)

    async def move_to(
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
        """Move joints smoothly to their targets, or the tool to a pose. A cancelled call ends the motion.

        Args:
            targets: Target by joint, in the driver's units. Other joints stay where they are.
            seconds: Duration of a motion to ``targets``, above 0 and at most 600 s. None: 2 s.
            wait: True returns at the end of the motion, False at once.
            xyz: Position of the tool in m.
            rpy: Orientation of the tool as roll, pitch and yaw in degrees.
            quat: The orientation as w, x, y, z, in place of ``rpy``.
            frame: ``base`` (the default) or ``tool``.
            speed: Top speed of the tool in m/s. None: 0.1.
            linear: True (the default) moves the tool along a straight line. False interpolates the joints.
            keep_out: Boxes that the arm may not enter.

        Returns:
            As ``RealRobot.move_to``.
        """
        pose = posing.given(xyz=xyz, rpy=rpy, quat=quat, frame=frame, speed=speed, linear=linear, keep_out=keep_out)
        return await answered("move_to", posing.move_to, self._tree, targets, seconds, wait, pose)

    async def get_pose(self) -> Answer:
        """Return the measured pose of the arm's tool. The keys are those of ``RealRobot.get_pose``."""
        return await answered("get_pose", posing.get_pose, self._tree)

    async def move_along(self, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool = True) -> Answer:
        """Move to the first row, then along all rows. A cancelled call ends the motion.

        Args:
            rows: Targets by joint, in the driver's units. Every row names the same joints.
            hz: Rows per second, above 0 and at most 1000.
            wait: As in ``move_to``.

        Returns:
            As ``RealRobot.move_along``.
        """
        return await answered("move_along", moving.move_along, self._tree, rows, hz, wait)

    @overload
    async def get_observation(self, images: Literal[False] = False) -> dict[str, float]: ...
    @overload
    async def get_observation(self, images: bool) -> dict[str, Any]: ...
    async def get_observation(self, images: bool = False) -> dict[str, Any]:
        """Return the newest measured position of each joint, in the driver's units; {} without a reading.

        Args:
            images: True adds the newest picture of each camera, as in ``RealRobot.get_observation``.
        """
        observation: dict[str, Any] = self._observing.positions(
            await answered("observe", verbs.get_observation, self._tree)
        )
        return observation | self._tree.cameras.looks() if images else observation

    async def read_camera(self, name: str, max_age_ms: float | None = None) -> Frame:
        """Return the newest picture of a camera, without waiting. It raises as ``RealRobot.read_camera``.

        Args:
            name: Name of the camera, as in ``open_robot(..., cameras=...)``.
            max_age_ms: Greatest age of the picture. None: three periods of the camera, and at least
                200 ms.
        """
        await trio.lowlevel.checkpoint()
        return self._tree.cameras.read(name, max_age_ms)

    def observations(self, hz: float = 30.0) -> Observations:
        """Return observations at a steady rate, for ``async for``.

        Args:
            hz: Observations per second, above 0 and at most 1000.

        Raises:
            ValueError: The rate is outside this range.

        Example:
            async for positions in robot.observations(hz=10.0):
                print(positions)
        """
        return Observations(self._tree, hz)

    async def service(
        self, name: str, *values: Any, action: Mapping[str, Any] | None = None, **arguments: Any
    ) -> Answer:
        """Run a service of the robot's driver.

        Each service is a method, too: ``await robot.step(steps=100)``. Arguments and keys are those of
        ``RealRobot.service``.
        """
        named = verbs.name_values(self._plan, name, values, arguments)
        if isinstance(named, Refused):
            return answers.refused(named)
        return await answered(name, verbs.service, self._tree, name, named, action)

    async def command(self, name: str, *values: Any, wait: bool = True, **inputs: Any) -> Answer:
        """Run a verb that the driver declares for agents.

        Each verb is a method, too: ``await robot.home()``, ``await robot.move(0.2, duration_s=3.0)``.
        Arguments and keys are those of ``RealRobot.command``.
        """
        call = call_of(self.driver, name, values, inputs)
        if isinstance(call, Refused):
            return answers.refused(call)
        return await answered(name, perform, self._tree, call, wait)

    # robot.pyi lists the services of each robot. If a type checker saw this method, it would accept misspelled
    # names.
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Callable[..., Awaitable[Answer]]:
            """Return a service or a verb (command) that the driver declares, as a method."""
            plan = self.__dict__.get("_plan")
            if find_verb(self.__dict__.get("driver"), name) and not verbs.is_service(plan, name):
                return functools.partial(self.command, name)
            verbs.require_service(self, plan, name)
            return functools.partial(self.service, name)

    async def state(self) -> Answer:
        """Return the newest readings of the robot. The keys are those of ``RealRobot.state``."""
        return await answered("state", verbs.get_state, self._tree)

    async def stop(self) -> Answer:
        """Stop the robot, and report the result of each motor.

        A stop de-energises every motor, or brings it to the state that the driver declares for a stop. The
        result is a success only if every motor confirmed its state. The keys are those of ``RealRobot.stop``.
        """
        return await answered("stop", verbs.stop, self._tree)

    async def resume(self) -> Answer:
        """Lift the lock of an e-stop, and energise at the measured position. It starts no motion.

        The keys are those of ``RealRobot.resume``.
        """
        return await answered("resume", verbs.resume, self._tree)

    async def get_status(self) -> Answer:
        """Return the status of the robot and its processes.

        The keys are those of ``RealRobot.get_status``.
        """
        return await answered("status", verbs.get_status, self._tree)

    async def run_policy(
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
        """Run a policy object in a worker thread of this process. Return at once, unless ``wait`` is true.

        Arguments, keys and exceptions are those of ``RealRobot.run_policy``.
        """
        if refused := verbs.refuse_name(robot_name, self._plan, self.name, "run_policy"):
            return refused
        run = verbs.run_policy(policy, policy_object, instruction, duration, n_steps, control_frequency, wait)
        return run if isinstance(run, Answer) else await answered("run_policy", run, self._tree)

    async def start_task(
        self,
        instruction: str = "",
        policy_port: int | None = None,
        policy_host: str = "localhost",
        policy_provider: str = DEFAULT_PROVIDER,
        duration: float = 30.0,
        control_frequency: float | None = None,
        **options: Any,
    ) -> Answer:
        """Run a policy by name in a separate process, and return at once.

        Arguments and keys are those of ``RealRobot.start_task``.
        """
        start = verbs.start_task(
            self.driver,
            policy_provider,
            policy_host,
            policy_port,
            options,
            instruction,
            duration,
            control_frequency,
        )
        return start if isinstance(start, Answer) else await answered("start_task", start, self._tree)

    async def run(
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

        A cancelled call ends the policy, and the robot holds its position. Arguments and keys are those of
        ``RealRobot.run``.
        """
        try:
            run = running.Run(
                self.driver, policy, seconds, instruction, control_frequency, progress, max_age, options
            )
        except (TypeError, ValueError) as failure:
            return answers.error(f"{running.RUN}: {failure}")
        begun = await answered(running.RUN, run.begin, self._tree)
        if begun["status"] != "success":
            return begun
        try:
            while True:
                look = await run.look(self._tree)
                if run.show is not None:
                    run.show(look._asdict())
                if not look.running:
                    break
                await trio.sleep(LOOK_S)
        except BaseException:
            # The call was cancelled, or the user's ``progress`` has raised an exception.
            with trio.CancelScope(shield=True):
                await self.stop_task()
            raise
        return await answered(running.RUN, run.end, self._tree)

    async def get_task_status(self) -> Answer:
        """Return the status of the policy or motion that runs, or of the last one.

        The keys are those of ``RealRobot.get_task_status``.
        """
        return await answered("task", verbs.get_task_status, self._tree)

    async def stop_task(self) -> Answer:
        """End the policy or motion, and return when the robot holds its position.

        A policy that does not answer cannot delay the hold. The keys are those of ``RealRobot.stop_task``.
        """
        return await answered("stop_task", verbs.stop_task, self._tree)

    async def use_tool(self, tool_input: object, by: str, motion: str = "") -> Answer:
        """Run the verb that a tool's input requests.

        Args:
            tool_input: The input of the tool.
            by: The name of the caller, for approval and audit.
            motion: Empty if motion is allowed. Otherwise the remedy in the refusal of a motion.
        """
        call = read(self.driver, tool_input, self.tool_name)
        if isinstance(call, Refused):
            return answers.refused(call)
        return await answered(call.verb.name, use, self._tree, call, self._approval, by, motion)


@contextlib.asynccontextmanager
async def open_robot(
    name: str,
    mode: str = "sim",
    *,
    attach: bool = False,
    arm: bool = True,
    approve: Approve | None = None,
    guarded: tuple[str, ...] = (),
    approve_within_s: float = APPROVE_S,
    **keywords: Any,
) -> AsyncIterator[AsyncRobot]:
    """Open one robot in a trio program.

    Inside the block the robot is connected and armed. After the block it is safe, and its processes
    have ended. The arguments are those of ``Robot``.

    Args:
        name: Name of the robot.
        mode: ``"sim"``, ``"real"`` or ``"auto"``.
        attach: True: ``name`` is a robot that a host of this user keeps (``strands-actors up``). Its processes run
            on after the block.
        arm: False: opening the robot energises nothing.
        approve: Function that asks an operator for approval, and returns True to approve.
        guarded: Verbs and action keys that need approval, in addition to those of the driver.
        approve_within_s: Longest time in seconds that ``approve`` may take.
        keywords: The other keywords of ``Robot``.

    Raises:
        ConnectionError: The robot cannot be connected.
        ValueError, TypeError: As ``Robot``, for wrong arguments.

    Example:
        async with open_robot("so101", mode="real", port="/dev/ttyACM0") as arm:
            await arm.move_to({"shoulder_pan": 10.0}, seconds=2.0)
    """
    if attach:
        from .attaching import attachment  # Only a handle of a host's robot needs this import.

        given = keywords if mode == "sim" else {"mode": mode, **keywords}
        robot_plan, approval, arm = await attachment(name, given, arm, approve, guarded, approve_within_s)
    else:
        robot_plan = plan(name, mode, **keywords)
        approval = approval_of(robot_plan.driver_class, guarded, approve, approve_within_s)
    async with open_tree(robot_plan, arm) as tree:
        yield AsyncRobot(tree, approval)


@contextlib.asynccontextmanager
async def open_tree(robot_plan: Plan, arm: bool = True) -> AsyncIterator[RobotTree]:
    """Open a robot as ``open_robot`` does, and yield its ``RobotTree`` (the interface to its processes).

    The methods of ``RobotTree`` return typed messages, not the dicts of ``AsyncRobot``.
    """
    async with open_caller() as (node, nursery, entrance):
        try:
            whole = await completed(robot_plan)
        except WireDown as down:
            raise ConnectionError(f"connect: {down}") from None
        tree = RobotTree(node, nursery, entrance, whole)
        try:
            problem = await tree.connect(arm)
            if problem is not None:
                raise ConnectionError(f"connect: {problem}")
            yield tree
        finally:
            with trio.CancelScope(shield=True):
                answers.warn_unless_safe(tree.robot, answers.stop_result("cleanup", await tree.cleanup()))
