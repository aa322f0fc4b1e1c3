"""The actor of a teleoperation: read a leader (the arm or device that a person moves), and send setpoints to the
robot.

The actor runs in place of a policy, in a separate process, with the caller's right to command. ``machine.py``
decides which setpoints are sent.

Each setpoint expires 100 ms after the leader was measured. If this process dies or freezes, or the leader is lost,
no setpoint is sent and the robot holds.
"""

from __future__ import annotations

import contextlib
import math
import os
import termios
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import trio

from strands_actors.caller.handle.stop_lines import stop_by_name
from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Reason
from strands_actors.contract.loading import load
from strands_actors.contract.pose_keys import POSE_KEYS
from strands_actors.contract.wire import Observation, WireDown
from strands_actors.kernel.actor import Actor, describe
from strands_actors.kernel.clock import NS
from strands_actors.kernel.mailbox import SUPERSEDED
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.failsafe import WRITABLE
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import (
    Acquire,
    GetObservation,
    GetStatus,
    Lease,
    Release,
    Setpoint,
    Status,
    Stop,
)
from strands_actors.supervisors.loading import load_driver
from strands_actors.supervisors.root.messages import (
    EpisodeKey,
    EpisodeState,
    GetTask,
    Operate,
    Rollout,
    StopTask,
    TaskStatus,
)
from strands_actors.supervisors.root.tasks import Tasks

from .machine import SILENT_NS, Frame, Kind, Machine, Squeezes, State, Step
from .page_address import write_address
from .sources import Arm, LeaderObject, Leaders, Operator, Reading, Source, made_of

if TYPE_CHECKING:
    from strands_actors.caller.poses.tool_targets import ToolTargets

ASK_S = 0.1
LIFETIME_NS = 100_000_000
"""Lifetime of a setpoint, from the time at which the leader was measured."""
LEADER_LOST = (WireDown, OSError, termios.error)
"""Exceptions of an unplugged leader. lerobot's objects raise ConnectionError, or an exception that pyserial
does not catch."""
LOOK_S = 0.02
REPORT_S = 0.1
ROBOT_S = 0.5
"""Period at which an idle teleoperation checks that the robot can be moved."""
SHOWN_S = 0.5
"""How long the page shows the result of its stop before this process ends."""
AGAIN_S = 1.0
"""Pause before a lost leader is opened again."""
RECORDER_S = 3.0
"""A recorder without a message for so long counts as gone."""

PAGE = "strands_actors.surfaces.web.operating:OperatorPage"
KEY, GRIPPER = "key", "gripper"
CONNECTED, CONNECTING = "connected", "connecting"
"""The reported state of a leader. Otherwise it is the reason why the leader is missing."""
MOVED = 0.2
"""Degrees, or percent of a gripper, that count as a move: two of the 4096 counts of a servo. One count is
noise."""
OVER = (Code.DISARMED, Code.FAULTED, Code.LOCKED_OUT, Code.STOPPED, Code.ENDING, Code.NO_DRILL)
"""Refusals that end the teleoperation, since only the robot's operator can resume."""
FRAME_REFUSED = (Code.TOO_FAST, Code.PAST_TRAVEL)
"""Refusals of one target. The next target may be accepted."""


class Teleoperation(Actor):
    """Read a leader, and send setpoints to the robot.

    Args:
        rollout: Robot, lease, control period and duration.
        report: Function that is called with each status.
        source: The leader as plain data (``Teleoperator.source``).
        axes: The robot's axes, as plain data.
        kind: The meaning of the leader's numbers (``Kind``).
        deadman: What a person holds while the robot may move: ``KEY`` or ``GRIPPER``.
        max_speed: Highest speed in degrees per second.
        has_tool: True if the robot has an arm with a tool that an operator can jog.
        map_fn: ``module:function`` that converts the leader's values to the robot's; empty for no
            conversion.
    """

    def __init__(
        self,
        rollout: Rollout,
        report: Callable[[TaskStatus], None],
        source: Mapping[str, Any],
        axes: list[dict[str, Any]],
        kind: str,
        deadman: str,
        max_speed: float = math.inf,
        map_fn: str = "",
        has_tool: bool = False,
    ) -> None:
        self._rollout = rollout
        self._tool_keys = POSE_KEYS if has_tool else ()
        self._tool: ToolTargets | None = None
        self._report = report
        self._source_settings = source
        self._axes = tuple(msgspec.convert(axis, Axis) for axis in axes)
        self._machine = Machine(self._axes, Kind(kind), max_speed)
        self._deadman = deadman
        self._map: Callable[[Mapping[str, float]], Mapping[str, float]] | None = load(map_fn) if map_fn else None
        self._squeezes: Squeezes | None = None
        self._lease: Lease | None = None
        self._turn = trio.Lock()
        self._fresh: Frame | None = None  # the newest frame, until it is processed
        self._idle_writer = trio.lowlevel.ParkingLot()
        self._newest = Frame(0, False, {})
        self._read_last: Mapping[str, float] = {}
        self._steps = 0
        self._leader = CONNECTING
        self._position: dict[str, float] = {}
        self._ended: TaskStatus | None = None
        self._episode = EpisodeState()
        self._episode_ns = 0
        self._stopping = False  # True from the page's stop request until its result was shown long enough

    async def started(self) -> None:
        context = self.context
        robot_addresses = addresses.of(self._rollout.robot)
        self._gate = context.ref(robot_addresses.gate, Gate)
        self._tasks = context.ref(robot_addresses.tasks, Tasks)
        self._operator = Operator((*(axis.key for axis in self._axes), *self._tool_keys), context.clock)
        self._began_ns = context.clock.now_ns()
        context.start_soon(self._lead)
        if self._tool_keys:
            context.start_soon(self._ready_tool)
        context.start_soon(self._write)
        context.start_soon(self._look)
        context.start_soon(self._ask_robot)
        self._publish_status()

    async def receive(self, message: Operate | EpisodeState | StopTask | GetTask) -> TaskStatus | None:
        match message:
            case Operate():
                self._operator.take(message)
            case EpisodeState():
                self._episode, self._episode_ns = message, self.context.clock.now_ns()
            case StopTask():
                await self._end("stopped", "")
                return self._status()
            case GetTask():
                return self._status()
        return None

    async def _ready_tool(self) -> None:
        """Build the model of the arm. Meanwhile, for some tenths of a second, the operator can jog the joints."""
        self._tool = await trio.to_thread.run_sync(_tool_of, self._rollout.driver, abandon_on_cancel=True)
        self._machine.tool = self._tool

    # -- reading

    def _source(self) -> Source:
        return self._source_of(self._source_settings)

    def _source_of(self, settings: Mapping[str, Any]) -> Source:
        clock = self.context.clock
        match settings["type"]:
            case "leaders":
                return Leaders({prefix: self._source_of(own) for prefix, own in settings["parts"].items()})
            case "arm":
                return Arm(settings["description"], clock)
            case "object":
                return LeaderObject(made_of(settings), clock)
            case "operator":
                return self._operator
            case "page":
                self.context.start_soon(self._serve, settings)
                return self._operator
        raise ValueError(f"teleoperation: there is no source of the type {settings['type']!r}")

    async def _lead(self) -> None:
        """Read the leader until the teleoperation ends.

        If the leader is lost, it is opened again. The robot then moves only after a new press of the dead-man. If
        the leader is an object whose first connection fails, the teleoperation ends with the object's message. That
        message may contain the remedy (calibrate it).
        """
        opened = False
        try:
            source = self._source()
            while self._ended is None:
                try:
                    await source.open()
                    opened, self._leader = True, CONNECTED
                    await self._read(source)
                except LEADER_LOST as lost:
                    if not opened and not isinstance(lost, WireDown):
                        raise
                    # the object's code may raise anything after its device is lost
                    with contextlib.suppress(Exception):
                        source.close()
                    self._leader = reason = str(lost) if isinstance(lost, WireDown) else describe(lost)
                    await self._leave(f"the leader is lost: {reason}")
                    await trio.sleep(AGAIN_S)
        except Exception as error:  # the code of the leader's object or of map_fn may raise anything
            await self._end("policy", describe(error))

    async def _serve(self, settings: Mapping[str, Any]) -> None:
        # Only a page needs a web server. A thread imports it, which takes some tenths of a second.
        page_class = await trio.to_thread.run_sync(load, PAGE)
        axes = [axis.key for axis in self._axes]
        title, tool = self._rollout.instruction, list(self._tool_keys)
        page = page_class(
            self.context.clock, self._operator.take, self._press, self._stop, self._shown, axes, tool, title
        )
        try:
            await page.serve(
                settings["host"], settings["port"], partial(write_address, Path(settings["address_file"]))
            )
        except OSError as failure:
            await self._end("policy", f"no page at {settings['host']}:{settings['port']}: {failure}")

    def _press(self, t_ns: int, word: str) -> None:
        """Pass a key press on to the recorder, if a recorder runs."""
        self._tasks.tell(EpisodeKey(t_ns, word))

    async def _stop(self) -> str:
        """Stop the robot for the page's stop button, and return the result as a line of text.

        A stop message is sent to the robot's gate (the actor that checks commands) at once. Then the robot is
        stopped a second time, by its name, for a confirmed result. If the gate does not answer, the root
        process stops the robot. The teleoperation ends, as after any stop.
        """
        self._stopping = True
        by = f"the page of {self._rollout.robot}"
        self._gate.tell(Stop(Reason.STOP, by))
        result = await stop_by_name(self._rollout.robot, by)
        self.context.start_soon(self._end_after_stop, result)
        return result

    async def _end_after_stop(self, result: str) -> None:
        await trio.sleep(SHOWN_S)
        self._stopping = False
        await self._end("stop", f"stopped by its page: {result}")

    def _shown(self) -> dict[str, Any]:
        """Return the data that the operator's page shows: the state, the robot's last target, and the recorder's
        state.
        """
        position = self._position
        if self._tool is not None and position:
            position = {**position, **self._tool.pose(position)}
        shown = {"state": str(self._machine.state), "why": self._machine.reason, "position": position}
        if self._episode_ns and self.context.clock.now_ns() - self._episode_ns < RECORDER_S * NS:
            shown["episode"] = msgspec.structs.asdict(self._episode)
        return shown

    async def _read(self, source: Source) -> None:
        """Pass on one reading of the leader per control period, and also any reading in between that shows a
        motion of the leader.
        """
        period_s = self._rollout.period_s
        next_s = due_s = trio.current_time()
        while self._ended is None:
            reading = await source.read()
            is_due = trio.current_time() >= due_s
            if reading.t_ns and (is_due or self._has_moved(reading)):
                self._read_last = reading.values
                self._fresh = self._frame(reading)
                self._idle_writer.unpark()
            now_s = trio.current_time()
            if is_due:
                due_s = max(due_s + period_s, now_s)
            next_s = max(next_s + period_s / source.READINGS, now_s)
            await trio.sleep_until(next_s)

    def _has_moved(self, reading: Reading) -> bool:
        before = self._read_last
        return any(abs(value - before.get(key, value)) > MOVED for key, value in reading.values.items())

    def _frame(self, reading: Reading) -> Frame:
        values = reading.values if self._map is None else dict(self._map(reading.values))
        if self._deadman == GRIPPER:
            return Frame(reading.t_ns, self._squeezed(reading), values)
        operator = self._operator
        held = operator.held if reading.held is None else reading.held
        return Frame(reading.t_ns, held, values, operator.let_go)

    def _squeezed(self, reading: Reading) -> bool:
        """Return True if the dead-man is held by squeezes of the leader's gripper. The values are those of the
        leader, before ``map_fn``.
        """
        if self._squeezes is None:
            low, high = self._source_settings["gripper"][1:]
            self._squeezes = Squeezes(low, high)
        return self._squeezes.take(reading.values[self._source_settings["gripper"][0]], reading.t_ns)

    # -- writing

    async def _write(self) -> None:
        """Process the newest frame (reading) of the leader, again and again.

        Another task reads the leader at the same time, because an answer of the robot takes as long as one reading
        of the leader.
        """
        while self._ended is None:
            frame, self._fresh = self._fresh, None
            if frame is None:
                await self._idle_writer.park()
            else:
                await self._take(frame)

    async def _take(self, frame: Frame) -> None:
        async with self._turn:
            if self._ended is not None:
                return
            self._newest = frame
            step = self._machine.step(frame, self.context.clock.now_ns())
            if step.engage:
                step = await self._engage(frame)
            await self._do(step, frame)

    async def _do(self, step: Step, frame: Frame) -> None:
        if step.let_go:
            await self._let_go()
        elif step.target is not None:
            await self._send(step.target, frame)

    async def _engage(self, frame: Frame) -> Step:
        request = Acquire(
            f"teleoperation of {self._rollout.robot}",
            self._rollout.over,
            os.getpid(),
            instruction=self._rollout.instruction,
        )
        lease = await self._ask(request)
        if lease is None:
            return self._asks_again(Step())
        if not isinstance(lease, Lease):
            await self._refused(lease)
            return Step()
        self._lease = lease
        observed = await self._ask(GetObservation())
        if observed is None:
            return self._asks_again(Step(let_go=True))
        if not isinstance(observed, Observation):
            return self._not_engaged(_text(observed))
        self._position = dict(zip(self._rollout.axes, observed.position, strict=True))
        now_ns = self.context.clock.now_ns()
        step = self._machine.engage(frame, self._position, now_ns)
        return step if self._machine.state is not State.IDLE else self._not_engaged(self._machine.reason)

    def _asks_again(self, step: Step) -> Step:
        """Note that the robot did not answer a request for the lease or for its position in time, as on a busy
        computer. If the dead-man is still held, the next frame of the leader leads to a new request.
        """
        self._machine.reason = _text(None)
        return step

    def _not_engaged(self, reason: str) -> Step:
        self._machine.not_engaged(reason)
        return Step(let_go=True)

    async def _send(self, target: Mapping[str, float], frame: Frame) -> None:
        lease = self._lease
        assert lease is not None
        deadline_ns = frame.t_ns + LIFETIME_NS
        answer = await self._ask(Setpoint(lease.id, lease.epoch, deadline_ns, dict(target), self._rollout.period_s))
        if isinstance(answer, Refused) and answer.code == SUPERSEDED.code:
            return
        if isinstance(answer, Refused) and answer.code in FRAME_REFUSED:
            self._machine.refuse()
            self._machine.reason = answer.text
        elif answer is None or isinstance(answer, Refused):
            self._machine.idle(_text(answer))
            await self._let_go()
            await self._refused(answer)
        else:
            self._steps += 1
            self._position |= target

    async def _refused(self, answer: Message | None) -> None:
        self._machine.not_engaged(_text(answer))
        if isinstance(answer, Refused) and answer.code in OVER and not self._stopping:
            await self._finish("stop", answer.text, answer.code)

    async def _leave(self, reason: str) -> None:
        async with self._turn:
            self._fresh = None
            await self._do(self._machine.idle(reason), self._newest)
            self._machine.not_engaged(reason)

    async def _let_go(self) -> None:
        """Give up the right to command (the lease).

        The robot holds its position before its gate (the actor that checks commands) answers. If the gate does
        not answer, the last setpoint expires and the robot holds, too.
        """
        lease, self._lease = self._lease, None
        if lease is not None:
            await self._ask(Release(lease.id))

    async def _ask(self, message: Message) -> Message | None:
        """Send a request to the robot's gate (the actor that checks commands), and return its answer. None if
        there was no answer in time."""
        try:
            return await self._gate.ask(message, ASK_S)
        except (AskTimeout, Unreachable):
            return None

    # -- time

    async def _look(self) -> None:
        """Check regularly whether the leader's newest frame is too old, the duration of the teleoperation has
        passed, or a status report is due.

        A leader that hangs sends no more frames. So the last frame is processed again when it is too old, which
        ends the motion.
        """
        report_s = 0.0
        while self._ended is None:
            await trio.sleep(LOOK_S)
            newest, now_ns = self._newest, self.context.clock.now_ns()
            if (
                self._machine.state is not State.IDLE
                and now_ns - newest.t_ns > SILENT_NS
                and not self._turn.locked()
            ):
                await self._take(newest)
            if now_ns - self._began_ns >= self._rollout.duration_s * NS:
                await self._end("duration", f"{self._rollout.duration_s:g} s are over")
            elif trio.current_time() >= report_s:
                report_s = trio.current_time() + REPORT_S
                self._publish_status()

    async def _ask_robot(self) -> None:
        """While the dead-man is not held, ask for the robot's state, and end the teleoperation after the robot was
        stopped.

        While the dead-man is held, a refused setpoint ends the teleoperation instead.
        """
        while self._ended is None:
            await trio.sleep(ROBOT_S)
            if self._machine.state is State.IDLE and not self._stopping:
                status = await self._ask(GetStatus())
                if isinstance(status, Status) and status.mode not in WRITABLE:
                    await self._end("stop", f"the robot is {status.mode}: {status.cause}".removesuffix(": "))

    # -- its end

    async def _end(self, reason: str, detail: str) -> None:
        async with self._turn:
            await self._finish(reason, detail)

    async def _finish(self, reason: str, detail: str, refusal: str = "") -> None:
        """End the teleoperation. The caller must hold the lock ``_turn``."""
        if self._ended is not None:
            return
        self._machine.idle(f"it has ended: {reason}")
        ended = msgspec.structs.replace(
            self._status(), running=False, exit_reason=reason, exit_detail=detail, refusal=refusal
        )
        await self._let_go()
        self._ended = ended
        self._report(ended)

    def _publish_status(self) -> None:
        if self._ended is None:
            self._report(self._status())

    def _status(self) -> TaskStatus:
        if self._ended is not None:
            return self._ended
        elapsed_s = (self.context.clock.now_ns() - self._began_ns) / NS
        hz = self._steps / elapsed_s if elapsed_s > 0 else 0.0
        return TaskStatus(
            True, self._steps, elapsed_s, instruction=self._rollout.instruction, hz=hz, teleop=self._teleop_status()
        )

    def _teleop_status(self) -> dict[str, Any]:
        return _teleop_json(self._machine, self._newest, self._leader, self.context.clock.now_ns())


def first_status(axes: tuple[Axis, ...], kind: Kind) -> dict[str, Any]:
    """Return the state that ``get_task_status`` shows until the process of the teleoperation reports one."""
    return _teleop_json(Machine(axes, kind), Frame(0, False, {}), CONNECTING, 0)


def _teleop_json(machine: Machine, newest: Frame, leader: str, now_ns: int) -> dict[str, Any]:
    age_ms = (now_ns - newest.t_ns) / 1e6 if newest.t_ns else None
    return {
        "state": str(machine.state),
        "why": machine.reason,
        "leader": leader,
        "leader_age_ms": None if age_ms is None else round(age_ms, 1),
        "held": newest.held,
        "values": {key: round(value, 2) for key, value in newest.values.items()},
        "refused": machine.refused,
        "differs": {key: round(value, 1) for key, value in machine.differs.items()},
        "at_end": list(machine.limited_axes),
    }


def _tool_of(description: dict[str, Any]) -> ToolTargets:
    # MuJoCo and numpy are imported only here, since most leaders do not need them.
    from strands_actors.caller.poses.tool_targets import ToolTargets

    return ToolTargets(load_driver(description))


def _text(answer: Message | None) -> str:
    if isinstance(answer, Refused):
        return answer.text
    return "the robot's gate does not answer" if answer is None else "the robot's gate sent a wrong answer"
