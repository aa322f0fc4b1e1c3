"""Jog a robot from a page, while its dead-man is held.

A seat holds the lease of the robot (the right to command it) only while the operator presses. It takes the
messages of the page like the frames of a leader, so the rules of a teleoperation hold: a page that is silent for
100 ms, that is closed, or that has let go, ends the motion, and the robot holds its position.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import trio

from strands_actors.contract.axis import Axis, AxisMode, finite
from strands_actors.contract.pose_keys import POSE_KEYS
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.remote import RemoteRobot, control
from strands_actors.teleoperation.lateness import Lateness
from strands_actors.teleoperation.machine import Frame, Kind, Machine, State, Step, Tool

PERIOD_S = 1 / 30
TTL_S = 0.2
"""Lifetime of a setpoint."""

_NO_FRAME = Frame(0, False, {})


class Hands:
    """Which robots are moved by a page now. For a robot all pages of a console are one program, so the robot cannot
    refuse the second one."""

    def __init__(self) -> None:
        self._robots: set[str] = set()

    @contextlib.contextmanager
    def on(self, robot: str) -> Iterator[None]:
        """Move a robot while the block runs.

        Raises:
            PermissionError: Another page moves it.
        """
        if robot in self._robots:
            raise PermissionError(f"another page moves {robot}. Wait until it has let go")
        self._robots.add(robot)
        try:
            yield
        finally:
            self._robots.remove(robot)


class Seat:
    """One page in front of one robot.

    Args:
        hands: The robots that are moved by pages of this console.
        client: The client of the mesh.
        robot: Name of the robot.
        axes: Its axes.
        tell: Called with the state of the seat when it changes: ``state`` and ``reason``.
        now_ns: This computer's clock.
    """

    def __init__(
        self,
        hands: Hands,
        client: MeshClient,
        robot: str,
        axes: tuple[Axis, ...],
        tell: Callable[[State, str], None],
        now_ns: Callable[[], int],
    ) -> None:
        self.robot = robot
        self._hands = hands
        self._client = client
        self._axes = axes
        self._tell = tell
        self._now_ns = now_ns
        self._machine = Machine(axes, Kind.JOG)
        self._reason = ""
        self._lateness = Lateness()
        self._frame = _NO_FRAME
        self._pressed = trio.Event()

    def use_tool(self, tool: Tool) -> None:
        """Let the page move the tool of the robot's arm, too."""
        self._machine.tool = tool

    def operate(self, held: bool, at_ms: float, rates: Mapping[str, float]) -> None:
        """Take one message of the page.

        Args:
            held: True while the operator presses.
            at_ms: Time of the message on the page's clock, in milliseconds.
            rates: Speed by axis, as a share (-1 to 1) of the axis' speed for jogging.
        """
        now_ns = self._now_ns()
        shares = {key: rate for key, rate in rates.items() if finite(rate) is not None}
        self._frame = Frame(now_ns - self._lateness.of(at_ms, now_ns), held, shares)
        if self._machine.state is State.IDLE and self._machine.step(self._frame, now_ns).engage:
            self._pressed.set()

    async def run(self) -> None:
        """Command the robot whenever the operator presses, until cancelled."""
        while True:
            await self._pressed.wait()
            try:
                with self._hands.on(self.robot):
                    async with control(self._client, self.robot) as remote:
                        await self._follow(remote)
            except PermissionError as refusal:
                self._machine.not_engaged(str(refusal))
            self._tell(State.IDLE, self._machine.reason)
            self._pressed = trio.Event()

    async def _follow(self, remote: RemoteRobot) -> None:
        machine = self._machine
        observed = await remote.observe()
        if isinstance(observed, Refused):
            machine.not_engaged(observed.text)
            return
        start = self._start(observed["joints"])
        machine.engage(self._filled(start), start, self._now_ns())
        self._reason = ""
        if machine.state is not State.IDLE:
            self._tell(machine.state, "")
        while machine.state is not State.IDLE:
            step = await self._step(self._filled(start))
            if machine.reason != self._reason:
                self._reason = machine.reason
                self._tell(machine.state, machine.reason)
            if step.target is not None:
                answer = await remote.send_action(step.target, TTL_S, PERIOD_S)
                if isinstance(answer, Refused):
                    machine.refuse()
                    machine.idle(answer.text)
                    return
            await trio.sleep(PERIOD_S)

    async def _step(self, frame: Frame) -> Step:
        """Return the next step of the motion. The joints of a tool's motion are computed in a thread."""
        if any(frame.values.get(key) for key in POSE_KEYS):
            return await trio.to_thread.run_sync(self._machine.step, frame, self._now_ns())
        return self._machine.step(frame, self._now_ns())

    def _start(self, joints: Mapping[str, Any]) -> dict[str, float]:
        """Return the position of each axis that can be jogged. Axes that this robot lacks are left out."""
        start = {}
        for axis in self._axes:
            measured = axis.rest if axis.mode is AxisMode.VELOCITY else finite(joints.get(axis.key))
            if measured is not None:
                start[axis.key] = measured
        return start

    def _filled(self, start: Mapping[str, float]) -> Frame:
        """Return the newest message, with a speed for each axis. Axes that the page does not name stand still."""
        rates = self._frame.values
        values = {key: rates.get(key, 0.0) for key in start}
        return self._frame._replace(values={**values, **{key: rates[key] for key in POSE_KEYS if key in rates}})


def axis_of(key: str, described: Mapping[str, Any]) -> Axis:
    """Return an axis from its description in the robot's answer to ``features``.

    Raises:
        TypeError: A field is missing or has the wrong type.
        ValueError: A field has a wrong value.
    """

    def number(name: str, otherwise: float) -> float:
        value = described.get(name)
        return otherwise if value is None else float(value)

    return Axis(
        key=key,
        unit=str(described.get("unit", "")),
        low=number("low", -math.inf),
        high=number("high", math.inf),
        speed=number("speed", math.inf),
        rest=number("rest", 0.0),
        mode=AxisMode(str(described.get("mode", AxisMode.POSITION))),
    )
