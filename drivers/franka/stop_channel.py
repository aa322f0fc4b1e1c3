"""The root's way to the arm when the wire process is gone.

Its connection has ended with it, and a controller ends a motion with the connection by which it was begun. What is
left to do is to see that it did, by a connection made when it is needed. Its StopMove is for who else might be
moving the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown

from . import protocol as p
from .client import LOOK_S, Fci, connect

if TYPE_CHECKING:
    from .driver import Franka

STANDING_RAD_S = 0.02
CONFIRM_S = 0.6
"""From top speed a joint stands after 0.3 s at its acceleration."""


class FrankaStopChannel(StopChannel):
    def __init__(self, driver: Franka) -> None:
        self._driver = driver

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        return await stop_anew(self._driver)

    def close(self) -> None:
        pass


async def stop_anew(driver: Franka) -> tuple[MotorReport, ...]:
    """Connect, stop, see the arm stand, close. Never raises."""
    client: Fci | None = None
    written = acknowledged = False
    state: p.State | None = None
    try:
        client, first = await connect(driver.host, driver.arm.fci, driver.robot)
        stop = client.send("stop")
        written = True
        with trio.move_on_after(CONFIRM_S):
            while not (acknowledged and state is not None and not moving(state)):
                acknowledged = acknowledged or any(reply.id == stop for reply in client.replies())
                newest = client.newest_state()
                # the time stamp of a controller that is alive goes on
                state = newest if newest is not None and newest.message_id > first.message_id else state
                await trio.sleep(LOOK_S)
        trouble = "" if state is not None else "the controller's time stamp stands still"
    except (WireDown, ValueError) as error:
        trouble = str(error)
    finally:
        if client is not None:
            client.close()
    return reports(driver, written, acknowledged, state, trouble)


def moving(state: p.State) -> list[int]:
    """Return the joints that move, or may: all of them while the controller runs a motion."""
    if state.robot_mode == p.RobotMode.MOVE:
        return list(range(len(state.dq)))
    return [at for at, rad_s in enumerate(state.dq) if abs(rad_s) >= STANDING_RAD_S]


def reports(
    driver: Franka, written: bool, acknowledged: bool, state: p.State | None, trouble: str = ""
) -> tuple[MotorReport, ...]:
    """Return what became of each joint. ``state``: the last one since the stop was written, if there is one."""
    moves: Sequence[int] = range(len(driver.axes)) if state is None else moving(state)
    found = []
    for at, joint in enumerate(driver.axes):
        safe = state is not None and at not in moves
        detail = "" if safe else trouble or "it moves"
        if safe and state is not None and state.robot_mode not in (p.RobotMode.IDLE, p.RobotMode.MOVE):
            detail = ", ".join((p.mode_name(state.robot_mode), *state.reasons))
        found.append(MotorReport(joint, driver.ids[at], written, acknowledged, safe, detail))
    return tuple(found)
