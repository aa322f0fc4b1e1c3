"""Repeat the steps of a stop until the robot is safe, or the time for it is over.

A driver defines one step: send the stop command if it is due, read the robot's state, and return why the robot is
not safe yet. The loop that repeats the step is the same for every robot, and never raises.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import ProcessSpent, WireDown

from ..codecs.malformed import MalformedFrame
from .outcome import Outcome


class StopSteps(Protocol):
    """The methods with which a driver stops one robot. ``repeat_until_safe`` calls them."""

    @property
    def written(self) -> bool:
        """True if a stop command was sent."""
        ...

    @property
    def acknowledged(self) -> bool:
        """True if the robot has answered a stop command."""
        ...

    async def step(self) -> str:
        """Send the stop command if it is due, then read the robot's state. Send the first command before any wait.

        Returns:
            Why the robot is not known to be safe; empty if it is.

        Raises:
            WireDown: The robot cannot be reached.
            ProcessSpent: This process cannot reach the robot any more.
            MalformedFrame: The robot's answer cannot be decoded.
        """
        ...


def always() -> bool:
    """Default of the argument ``goes_on`` of ``repeat_until_safe``. Always return True (a failed step is followed
    by another)."""
    return True


async def repeat_until_safe(
    stop: StopSteps, within_s: float, pause_s: float, goes_on: Callable[[], bool] = always
) -> Outcome:
    """Repeat the steps of a stop. Never raises.

    Args:
        stop: The stop.
        within_s: Time for all steps, seconds.
        pause_s: Pause between two steps, seconds.
        goes_on: Called after a failed step. Return False if no further step can succeed. The caller then tries
            another connection.
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
