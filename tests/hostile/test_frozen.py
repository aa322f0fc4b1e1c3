"""Test a robot that freezes with a setpoint under way and continues after the stop (SAF-002).

The tests run on every wire, in virtual time. A robot reads each connection in order, but chooses the connection
that it reads first. So it may carry out a stop before a setpoint that was sent earlier on another connection.
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
"""All robots but UR: its SDK owns the connections, and the kill matrix freezes its twin."""
SEVERAL = ("earthrover", "reachy_mini", "microduck")
"""Robots that receive commands on several connections."""
WAITS_S = 0.5
"""Within this time a moving robot gets another setpoint."""
STEP_S = 0.0037
SEEN_S = 1.0


async def freeze(trial: Trial) -> None:
    """Freeze the robot, and wait until the host has written bytes that the robot does not read."""
    trial.peer.freeze()
    with trio.move_on_after(WAITS_S):
        while not trial.peer.waiting:  # noqa: ASYNC110  # the tree's doing
            await trio.sleep(STEP_S)


class Frozen(NamedTuple):
    robot: str
    frozen_s: float  # after a second the root may act, on its own connection
    stopped: bool  # False: the wire itself finds that the link is lost
    newest_first: bool

    def __str__(self) -> str:
        order = "newest first" if self.newest_first else "oldest first"
        return f"{self.robot}-{self.frozen_s}-{'stopped' if self.stopped else 'lost'}-{order}"

    @property
    def is_quick(self) -> bool:
        """True for cases of the ordinary run: every case of robots with several connections, one case of all
        others."""
        return self.robot in SEVERAL or self[1:] == (0.25, True, False)


ROWS = [Frozen(*row) for row in itertools.product(FROZEN, (0.05, 0.25, 0.8), (True, False), (True, False))]


@pytest.mark.parametrize(
    "row", [row if row.is_quick else pytest.param(row, marks=pytest.mark.long) for row in ROWS], ids=str
)
def test_saf_002_a_setpoint_that_waits_in_a_frozen_robot_does_not_follow_its_stop(row: Frozen) -> None:
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
