"""Carry out planned motions of one robot for the graph, one at a time, as a stream of setpoints under the lease.

At its end the robot holds and the lease is given back, so that the next motion needs no resume. A stop, or the loss
of the lease, ends a motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import trio

from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.remote import RemoteRobot

from .joints import Layout
from .trajectory import Error, Problem, Row, Trajectory
from .writer import Writer

FRESH_S = 1.0
"""A position that was measured longer ago is unknown."""
RELEASE_S = 2.0


def never() -> bool:
    return False


class Mover:
    """Moves one robot along planned paths.

    Args:
        mesh: The mesh.
        robot: The name of the robot.
        layout: Its joints.
        writer: The writer of the robot's command topics, which is suspended during a motion.
        report: Called with each refusal of the robot.
    """

    def __init__(
        self, mesh: MeshClient, robot: str, layout: Layout, writer: Writer, report: Callable[[Refused], None]
    ) -> None:
        self.holder = ""
        """The origin of the present motion; empty without one."""
        self._mesh = mesh
        self._robot = robot
        self._layout = layout
        self._writer = writer
        self._report = report
        self._measured: dict[str, float] = {}
        self._measured_at = -FRESH_S
        self._came = trio.Event()

    def on_positions(self, message: Mapping[str, Any], age_s: float) -> None:
        """Take the newest joint state of the robot, and its age in seconds."""
        self._measured = dict(zip(message["name"], message["position"], strict=True))
        self._measured_at = trio.current_time() - age_s
        came, self._came = self._came, trio.Event()
        came.set()

    async def read(self) -> Mapping[str, float]:
        """Return the measured positions, as ``measured``. If they are too old, wait for the next ones."""
        with trio.move_on_after(FRESH_S):
            while not self.measured:
                await self._came.wait()
        return self.measured

    @property
    def measured(self) -> Mapping[str, float]:
        """Return the measured position of each joint, in radians or metres; empty if it is too old."""
        return self._measured if trio.current_time() - self._measured_at < FRESH_S else {}

    async def move(
        self,
        holder: str,
        trajectory: Trajectory,
        is_over: Callable[[], bool] = never,
        on_step: Callable[[Row], None] = lambda _: None,
    ) -> Problem | None:
        """Move along a trajectory, and give the lease back.

        Args:
            holder: The origin of the motion, to show to others that are refused meanwhile.
            trajectory: The trajectory.
            is_over: Checked before each setpoint. True ends the motion.
            on_step: Called with the desired positions after each setpoint.

        Returns:
            None if the end was reached or ``is_over``, else the reason.
        """
        if busy := self.holder or self._writer.holder:
            return Problem(Error.INVALID_GOAL, f"{busy} commands the robot already. Wait for its end, or cancel it")
        # From here on no other motion and no stream begins, although the robot has not answered yet.
        self.holder = holder
        self._writer.suspend(holder)
        remote = RemoteRobot(self._mesh, self._robot)
        try:
            refused = await remote.acquire()
            if refused is None:
                return await self._follow(trajectory, remote, is_over, on_step)
            self._report(refused)
            return Problem(Error.INVALID_GOAL, refused.text)
        finally:
            with trio.move_on_after(RELEASE_S, shield=True):
                await remote.release()
            self.holder = ""
            self._writer.suspend("")

    async def _follow(
        self,
        trajectory: Trajectory,
        remote: RemoteRobot,
        is_over: Callable[[], bool],
        on_step: Callable[[Row], None],
    ) -> Problem | None:
        """Send setpoints until the end is reached. Return why it was not reached."""
        began, layout = trio.current_time(), self._layout
        compared_at = began
        while not is_over():
            elapsed_s = trio.current_time() - began
            positions = trajectory.positions(elapsed_s)
            pairs = zip(trajectory.joints, positions, strict=True)
            targets = {joint.key: joint.value(position) for joint, position in pairs}
            answer = await remote.send_action(targets, layout.lifetime_s, layout.period_s)
            if isinstance(answer, Refused):
                self._report(answer)
                return Problem(Error.INVALID_GOAL, answer.text)
            on_step(positions)
            over_s = elapsed_s - trajectory.duration_s
            if compared_at < self._measured_at <= began + trajectory.duration_s:
                compared_at = self._measured_at
                if off := trajectory.off_path(self._measured, compared_at - began):
                    return Problem(Error.PATH_TOLERANCE_VIOLATED, off)
            if over_s >= 0.0 and self._measured_at >= began + trajectory.duration_s:
                farthest = trajectory.farthest(self._measured)
                if not farthest:
                    return None
                if over_s >= trajectory.settle_s:
                    return Problem(Error.GOAL_TOLERANCE_VIOLATED, farthest)
            elif over_s >= trajectory.settle_s + FRESH_S:
                return Problem(Error.GOAL_TOLERANCE_VIOLATED, "the robot does not report its positions")
            await trio.sleep_until(began + elapsed_s + layout.period_s)
        return None
