"""How an M3 Pro is stopped: zero, again and again, until its own odometry says that it stands.

The arm is left where it was last told to be: its servos keep that by themselves, cannot be told to
stop, and the robot does not report where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.kept_connection import keep_connected
from strands_actors.kernel.clock import Clock

from .config import ROS2, YahboomConfig
from .links import RosLink
from .messages import REST, stands

STOP_S = 1.7
"""How long zero is repeated: less than ``Timing.safe_s``, and than what is left of it when a
link is reached."""

TIMES = 3
"""Zeros at least: the bridge may drop one when its own queue is full."""

ANSWER_S = 0.2
"""How long one zero waits to be taken, or to be seen in the odometry, before the next is sent."""

AGAIN_S = 0.02
"""Pause between two zeros."""


class Outcome(NamedTuple):
    """Of a stop. ``detail``: why the base is not known to stand; empty when it is."""

    written: bool
    acknowledged: bool
    detail: str

    def reports(
        self, config: YahboomConfig, arm_rad: Sequence[float] = (), arm_detail: str = ""
    ) -> tuple[MotorReport, ...]:
        """Return one report an axis. ``arm_rad``: the arm's last goal, which it keeps; empty:
        not known here."""
        base = len(config.axes) - len(config.servos)
        held: tuple[float | None, ...] = tuple(arm_rad) or (None,) * len(config.servos)
        return tuple(
            MotorReport(
                axis,
                number,
                self.written,
                self.acknowledged,
                not self.detail,
                self.detail or ("" if at < base else arm_detail),
                0.0 if at < base else held[at - base],
            )
            for at, (axis, number) in enumerate(zip(config.axes, config.ids, strict=True))
        )


async def stop_base(link: RosLink, within_s: float) -> Outcome:
    """Publish zero, again and again, at least ``TIMES``, until odometry that was measured after it
    shows that the base stands. Never raises. Where a connection is open, the first zero leaves
    before the first wait.

    The first odometry behind the answer that zero was taken may have been on its way; only a later
    one counts.
    """
    sent = 0
    acknowledged = False
    detail = "silent"
    with trio.move_on_after(within_s):
        while True:
            try:
                await link.connect()
                link.publish_twist(REST, stop=True)
                sent += 1
                await link.taken(ANSWER_S)
                acknowledged = True
                detail = "not confirmed: no odometry since"
                first = await link.next_odometry(ANSWER_S)
                then = await link.next_odometry(ANSWER_S)
                if then.stamp_ns <= first.stamp_ns:
                    detail = "not confirmed: its odometry is old"
                elif not stands(then.speed):
                    shown = ", ".join(f"{value:.3g}" for value in then.speed)
                    detail = f"not confirmed: its odometry shows {shown}"
                elif sent >= TIMES:
                    return Outcome(True, True, "")
            except WireDown as down:
                detail = f"not confirmed: {down}"
            await trio.sleep(AGAIN_S)
    return Outcome(sent > 0, acknowledged, detail)


class YahboomStopChannel(StopChannel):
    """The root's own connection to rosbridge, kept open; with ``transport="ros2"`` its own
    writer of DDS, since rclpy must not be in the root."""

    def __init__(
        self, config: YahboomConfig, descriptors: Sequence[int], clock: Clock, link: RosLink | None = None
    ) -> None:
        self._config = config
        self._link = link or stop_link(config, clock)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await keep_connected(self._link, task_status)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return (await stop_base(self._link, STOP_S)).reports(self._config)

    def close(self) -> None:
        self._link.close()


def stop_link(config: YahboomConfig, clock: Clock) -> RosLink:
    """Return a way to the robot that the root may load."""
    if config.transport == ROS2:
        from .dds import DdsLink

        return DdsLink(config, clock)
    from .rosbridge import RosbridgeLink

    return RosbridgeLink(config, clock)
