"""Test that the first safe frame leaves before the first wait, on every wire, in virtual time (SAF-003).

A bound in real time has room for a slow computer, and hides a wire that waits a little before it stops. In
virtual time only the waits of the code itself take time. A robot that cannot be stopped at once has its delay
and the reason in its rig (``Rig.latest_s``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import Wire

from .bench import Rig, Situation
from .peer import HostilePeer
from .rigs import RIGS
from .test_virtual import Trial, moving, run, stopped

BETWEEN_S = 0.0137
"""Time from the first setpoint to the fault. It falls between two periods of a wire."""
FAULT_S = 0.02
"""Time from the fault of a link to the stop. By then the wire waits for an answer, or has lost the link."""
LOOK_S = 0.12
"""How long the test reads the wire's log: longer than any wire may take."""
ROUNDING_S = 1e-6


async def break_link(situation: Situation, trial: Trial) -> None:
    """Bring the link into the state in which the robot is stopped."""
    match situation:
        case Situation.SILENT:
            trial.peer.begin("half a frame")
        case Situation.RESET:
            trial.peer.reset()
        case _:
            return
    await trio.sleep(FAULT_S)


async def stop(situation: Situation, trial: Trial) -> None:
    """Cause the stop."""
    match situation:
        case Situation.WIRE_ENDS:
            await trial.tree.wire.fence()
        case Situation.ROOT_ENDS:
            trial.tree.wire.close_link()
        case _:
            await stopped(trial, Reason.STOP)


async def look(situation: Situation, trial: Trial) -> float:
    """Stop a moving robot.

    Returns:
        Seconds from the stop to the first safe frame.
    """
    await trio.sleep(BETWEEN_S)
    await break_link(situation, trial)
    request = trial.ask()
    with trio.move_on_after(LOOK_S):
        await stop(situation, trial)
        await trio.sleep_forever()
    log = trial.bench.log()[request.entries :]
    kinds = [kind for _, kind in log]
    assert "safe" in kinds, "no safe frame"
    first = kinds.index("safe")
    assert "setpoint" not in kinds[first:], "a setpoint after the safe frame"
    return log[first][0] - request.t_s


def took_s(rig: Rig, situation: Situation) -> float:
    """Return the seconds from the stop of one robot to its first safe frame."""
    found: list[float] = []

    async def test(peer: HostilePeer) -> None:
        async with moving(peer, rig) as trial:
            found.append(await look(situation, trial))

    run(test)
    return found[0]


@pytest.mark.parametrize(
    "situation",
    [
        *(each for each in Situation if each is not Situation.ROOT_ENDS),
        pytest.param(Situation.ROOT_ENDS, marks=pytest.mark.long),  # the same wire, with another requester
    ],
)
@pytest.mark.parametrize("robot", RIGS)
def test_saf_003_the_first_safe_frame_leaves_before_the_first_wait(robot: str, situation: Situation) -> None:
    latest_s = RIGS[robot].latest_s.get(situation, 0.0)
    assert took_s(RIGS[robot], situation) <= latest_s + ROUNDING_S


def test_a_wire_that_waits_a_millisecond_before_it_stops_is_noticed() -> None:
    def late(make: Callable[[HostilePeer], Any]) -> Callable[[HostilePeer], Any]:
        def make_late(peer: HostilePeer) -> Any:
            bench = make(peer)
            open_wire = bench.driver.open_wire

            def open_late(clock: Any) -> Wire:
                wire: Wire = open_wire(clock)
                make_safe = wire.make_safe

                async def make_safe_late(safe_state: Any) -> Any:
                    await trio.sleep(0.001)
                    return await make_safe(safe_state)

                wire.make_safe = make_safe_late  # type: ignore[method-assign]
                return wire

            bench.driver.open_wire = open_late
            return bench

        return make_late

    rig = RIGS["xarm7"]
    assert took_s(rig._replace(make=late(rig.make)), Situation.MOVES) == pytest.approx(0.001)
