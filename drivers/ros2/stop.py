"""Stop a robot that is a node of a ROS 2 graph.

Twists of zeros and a cancel of all goals are sent until its own reports show that it stands still. To hold, an arm
first finishes its last goal, which is at most ``gates.LEAD_S`` away: a motion would otherwise end short of its end,
because an arm is always a little behind its setpoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch
from strands_actors.drivers.common.kit.stop_steps import repeat_until_safe

from .config import Ros2Config
from .link import STILL, RosLink
from .table import BASE

STOP_S = 1.7
"""How long a stop is repeated. This is less than ``Timing.safe_s``."""
AGAIN_S = 0.05
TIMES = 3
"""Least number of zeros and cancels, since a queue of the node may drop one."""
FINISH_S = 0.6
"""How long an arm may take to finish its last goal when it has to hold. After that the goal is cancelled, too."""
STEADY_S = 0.15
"""How long the robot must report that it stands. A command that was on its way would move it within this time."""


class RosStop:
    """The steps of one stop. Implements ``StopSteps``.

    Args:
        link: The connection.
        holds: True if an arm may finish its last goal.
    """

    def __init__(self, link: RosLink, holds: bool) -> None:
        self.written = False
        self._link = link
        self._sent = 0
        self._finish_at = trio.current_time() + (FINISH_S if holds and link.table.joints else 0.0)
        self._canceled = holds or not link.table.joints
        self._axes: tuple[Sequence[str], Sequence[str]] = (link.table.base_keys, link.joints)
        self._watches = tuple(RestWatch(len(axes), STEADY_S) for axes in self._axes)

    @property
    def acknowledged(self) -> bool:
        """True if the node has confirmed a cancel, and has reported something since."""
        return self._canceled and all(watch.rest is not Rest.NOTHING_SINCE for watch in self._used_watches())

    async def step(self) -> str:
        self.send()
        await trio.lowlevel.checkpoint()
        self._look()
        if not self._canceled:
            return "not confirmed: the node has not answered the cancel of its goals"
        for watch, axes in zip(self._watches, self._axes, strict=True):
            if axes and watch.rest is not Rest.RESTS:
                moving = ", ".join(axes[index] for index in sorted(watch.unsteady))
                return f"not confirmed: {watch.rest.value} ({moving})"
        if self._sent < TIMES or self._link.goals_waiting:
            return "not confirmed: an earlier goal has not been answered"
        return ""

    def send(self) -> None:
        """Send zeros and a cancel now."""
        if self._link.table.base:
            self._link.zero()
        if self._link.table.joints and trio.current_time() >= self._finish_at:
            self._link.cancel(self._on_canceled)
        self._sent += 1
        self.written = True

    def _on_canceled(self, _: dict[str, Any]) -> None:
        self._canceled = True

    def _used_watches(self) -> list[RestWatch]:
        return [watch for watch, axes in zip(self._watches, self._axes, strict=True) if axes]

    def _look(self) -> None:
        """Give the newest reports to the watches."""
        reports, (base, joints) = self._link.reports, self._axes
        base_watch, joint_watch = self._watches
        if base and reports.odometry:
            moving = [index for index, key in enumerate(base) if abs(reports.base_speeds[key]) > STILL[key]]
            base_watch.report(reports.odometry_s, moving)
        if joints and reports.positions:
            rows = self._link.table.joints
            moving = [
                index for index, key in enumerate(joints) if not abs(reports.speeds[key]) <= STILL[rows[key].unit]
            ]
            joint_watch.report(reports.joints_s, moving)


async def stop_by(link: RosLink, safe_state: SafeState) -> Outcome:
    """Stop the robot, and wait until it stands still. Never raises. The first frames leave before any wait."""
    stop = RosStop(link, safe_state == SafeState.HOLD)
    if not link.port.is_open:
        return Outcome(False, False, "not confirmed: not connected to the router of the graph")
    async with link.port.receiving():
        return await repeat_until_safe(stop, STOP_S, AGAIN_S)


def reports_of(outcome: Outcome, link: RosLink, config: Ros2Config) -> tuple[MotorReport, ...]:
    """Return a report on each axis. A joint holds where it stands, as far as its reports tell."""
    targets = [0.0 if key in BASE else link.reports.positions.get(key) for key in config.axes]
    return outcome.reports(config.axes, config.ids, targets)


class Ros2StopChannel(KeptSession[Ros2Config, RosLink]):
    """Stop the robot by a node of the supervising process (root)."""

    SERVED_FIRST: ClassVar[bool] = False

    async def connect(self) -> RosLink:
        link = RosLink(self.config, self.clock, "stop")
        try:
            await link.open()
        except BaseException:
            link.close()
            raise
        return link

    async def keep_up(self, session: RosLink) -> None:
        await session.port.receive()

    async def make_safe_by(self, session: RosLink | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if session is None:
            link = RosLink(self.config, self.clock, "stop")
            return reports_of(Outcome(False, False, "not confirmed: not connected to the graph"), link, self.config)
        return reports_of(await stop_by(session, safe_state), session, self.config)
