"""A robot that freezes while a setpoint is on its way, and goes on after the stop, on every wire, in
virtual time (SAF-002).

What waits in one connection is read in its order. Which connection is read first is the robot's
choice. So a stop that leaves on another connection than the setpoint may be carried out before it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import pytest
import trio

from strands_actors.contract.driver import Reason

from .peer import HostilePeer
from .rigs import RIGS
from .test_virtual import Trial, heal, moving, run, stopped

FROZEN = [robot for robot in RIGS if robot != "ur5e"]
"""A UR's SDK has its connections: the kill matrix freezes its twin."""
SEVERAL = ("earthrover", "reachy_mini", "microduck")
"""Robots that are told things on several connections."""
WAITS_S = 0.5
"""By then a robot that moves has been sent another setpoint."""
STEP_S = 0.0037
SEEN_S = 1.0


async def freeze(trial: Trial) -> None:
    """Freeze it, and wait until something has been written that it does not read."""
    trial.peer.freeze()
    with trio.move_on_after(WAITS_S):
        while not trial.peer.waiting:  # noqa: ASYNC110  # the tree's doing
            await trio.sleep(STEP_S)


class Frozen(NamedTuple):
    robot: str
    frozen_s: float  # after a second the root may act, on its own connection
    stopped: bool  # else the wire finds by itself that the link is lost
    newest_first: bool

    def __str__(self) -> str:
        order = "newest first" if self.newest_first else "oldest first"
        return f"{self.robot}-{self.frozen_s}-{'stopped' if self.stopped else 'lost'}-{order}"

    @property
    def is_quick(self) -> bool:
        """Whether it belongs to the ordinary run: robots with several connections in each case, all
        others once."""
        return self.robot in SEVERAL or self[1:] == (0.25, True, False)


ROWS = [Frozen(*row) for row in itertools.product(FROZEN, (0.05, 0.25, 0.8), (True, False), (True, False))]


@pytest.mark.parametrize(
    "row", [row if row.is_quick else pytest.param(row, marks=pytest.mark.long) for row in ROWS], ids=str
)
def test_saf_002_what_waits_in_a_frozen_robot_is_not_behind_its_stop(row: Frozen) -> None:
    async def test(peer: HostilePeer) -> None:
        async with moving(peer, RIGS[row.robot]) as trial:
            await freeze(trial)
            before = len(trial.bench.log())
            async with trio.open_nursery() as nursery:
                if row.stopped:
                    nursery.start_soon(stopped, trial, Reason.STOP)
                await trio.sleep(row.frozen_s)
                await peer.thaw(row.newest_first)
            await trio.sleep(SEEN_S)
            kinds = [kind for _, kind in trial.bench.log()[before:]]
            if "safe" in kinds:
                assert "setpoint" not in kinds[kinds.index("safe") :], "a setpoint after the safe frame"
            await heal(trial)

    run(test)
