"""Stop an M3 Pro: send a zero twist until the robot's own odometry shows that the base stands.

The arm keeps its last goal. Its servos do that by themselves and cannot be stopped, and the robot
does not report their positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.reporting_base import ReportingBase, stop_until_it_stands
from strands_actors.kernel.clock import Clock

from .config import LINKS, YahboomConfig

STOP_S = 1.7
"""How long zero is repeated. This is less than ``Timing.safe_s``, and less than the rest of it when a new
link has to be opened first."""


class StopLink(ReportingBase, Protocol):
    """A link to the base that is kept open so that a stop can use it."""

    async def listen(self) -> None:
        """Connect and subscribe to odometry, before a stop is needed."""
        ...

    async def receive_messages(self) -> None:
        """Receive reports until cancelled."""
        ...

    def close(self) -> None:
        """Close the connection at once. A second call does nothing."""
        ...


def reports_of(
    outcome: Outcome, config: YahboomConfig, arm_rad: Sequence[float] = (), arm_detail: str = ""
) -> tuple[MotorReport, ...]:
    """Return a report of the stop for each axis.

    Args:
        outcome: The result of the stop.
        config: The settings of the robot.
        arm_rad: The arm's last goal, which it keeps; empty if it is unknown here.
        arm_detail: Text for the arm's reports.
    """
    base = len(config.axes) - len(config.servos)
    arm_targets: tuple[float | None, ...] = tuple(arm_rad) or (None,) * len(config.servos)
    targets = (
        (0.0, "") if index < base else (arm_targets[index - base], arm_detail) for index in range(len(config.axes))
    )
    return tuple(
        MotorReport(
            axis,
            number,
            outcome.written,
            outcome.acknowledged,
            not outcome.detail,
            outcome.detail or detail,
            target,
        )
        for axis, number, (target, detail) in zip(config.axes, config.ids, targets, strict=True)
    )


class YahboomStopChannel(KeptSession[YahboomConfig, StopLink]):
    """Stop an M3 Pro from the supervising process (root), by the root's own connection to rosbridge, or
    by the root's own node on the graph."""

    SERVED_FIRST: ClassVar[bool] = False

    def new_link(self) -> StopLink:
        return stop_link(self.config, self.clock)

    async def connect(self) -> StopLink:
        link = self.new_link()
        try:
            await link.listen()
        except BaseException:
            link.close()
            raise
        return link

    async def keep_up(self, session: StopLink) -> None:
        await session.receive_messages()

    async def make_safe_by(self, session: StopLink | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        self.session = session or self.new_link()
        return reports_of(await stop_until_it_stands(self.session, STOP_S), self.config)


def stop_link(config: YahboomConfig, clock: Clock) -> StopLink:
    """Return a link for a stop. It is not open yet."""
    link: StopLink = load(LINKS[config.transport])(config, clock)
    return link
