"""Repeat the steps of a stop until the robot is safe, or the time for it is over.

A driver writes one step: send the order if it is due, read the robot, and say why it is not safe yet. The loop
around it is the same for every robot, and never raises.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import ProcessSpent, WireDown

from ..codecs.malformed import MalformedFrame
from .outcome import Outcome


class StopSteps(Protocol):
    """One stop of one robot."""

    @property
    def written(self) -> bool:
        """True if a frame of the stop has left."""
        ...

    @property
    def acknowledged(self) -> bool:
        """True if the robot has answered an order of the stop."""
        ...

    async def step(self) -> str:
        """Send the order if it is due, then read the robot. The first frame leaves before the first wait.

        Returns:
            Why the robot is not known to be safe; empty if it is.

        Raises:
            WireDown: The robot cannot be reached.
            ProcessSpent: This process cannot reach it any more.
            MalformedFrame: Its answer cannot be read.
        """
        ...


def always() -> bool:
    """Return True: a failed step is followed by another one."""
    return True


async def repeat_until_safe(
    stop: StopSteps, within_s: float, pause_s: float, goes_on: Callable[[], bool] = always
) -> Outcome:
    """Repeat the steps of a stop. Never raises.

    Args:
        stop: The stop.
        within_s: Time for all steps, seconds.
        pause_s: Pause between two steps, seconds.
        goes_on: Return False after a failed step if no other can succeed. The caller then has another connection
            to try.
    """
    detail = "not confirmed: the robot is silent"
    with trio.move_on_after(within_s):
        while True:
            try:
                detail = await stop.step()
                if not detail:
                    break
            except (WireDown, ProcessSpent, MalformedFrame) as failure:
                detail = f"not confirmed: {failure}"
                if not goes_on():
                    break
            await trio.sleep(pause_s)
    return Outcome(stop.written, stop.acknowledged, detail)
