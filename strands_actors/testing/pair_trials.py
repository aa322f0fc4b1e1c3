"""Run one trial of a pair: two processes of a moving robot break, one shortly after the other.

The log of the frames that the robot receives has the result.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
from pathlib import Path
from time import monotonic_ns

import trio

from strands_actors.contract.driver import Driver

from .bench import Bench, Caller, NotMoving, extras_for
from .cells import (
    SETTLE_S,
    Expected,
    Outcome,
    persevere,
    read,
    require_motion,
    stop_after,
    until_safe,
    with_story,
)
from .faults import SIGNALS, Cell, Faults, Victims, spoils
from .pairs import APART_S, Pair, expected_safe_states, pair_bound_s


def run_pair(pair: Pair, bench: Bench, settle_s: float = SETTLE_S) -> Outcome:
    """Run one trial in which a pair of processes breaks, as ``cells.run_cell`` does for one process.

    The order of the two faults and the time between them are random.
    """
    apart_s = random.uniform(0.0, APART_S)

    def trial(caller: Caller) -> Outcome:
        return trio.run(_break_pair, bench, caller, pair, apart_s, settle_s)

    drop = not pair.members or any(spoils(member, fault) for member, fault in pair.faults)
    return persevere(bench, _motion(pair, bench.driver), trial, drop, extras_for(pair.members))


def _motion(pair: Pair, driver: Driver) -> str:
    """Choose a motion in which a process of the pair sends the setpoints, if one of the two can do that."""
    if driver.TASKS:
        return "rollout"
    if driver.ROLLOUTS:
        return "loop"
    return "loop" if Victims.CALLER in pair.members and Victims.POLICY not in pair.members else "task"


async def _break_pair(bench: Bench, caller: Caller, pair: Pair, apart_s: float, settle_s: float) -> Outcome:
    queue = bench.queue(caller)
    began_ns, broken_ns = await break_both(pair, caller, apart_s)
    bound_ms = pair_bound_s(bench.driver, pair) * 1e3
    expected = Expected(pair.victim, pair.fault, expected_safe_states(bench.driver, pair), bound_ms)
    if pair.stops:
        outcome = await stop_after(bench, caller, expected, broken_ns, queue, settle_s)
        let_go(pair, caller)
        return outcome
    await until_safe(bench.log, began_ns, queue)
    waited_ms = queue.waited_ms()
    await trio.sleep(settle_s + pair_bound_s(bench.driver, pair))
    let_go(pair, caller)
    await trio.sleep(settle_s)
    require_motion(bench.log, began_ns)
    return with_story(read(bench.log, expected, began_ns, broken_ns, 0.0, waited_ms), bench.log, began_ns)


async def break_both(pair: Pair, caller: Caller, apart_s: float) -> tuple[int, int]:
    """Break the processes of a pair, one after the other. Return the times of the first and of the later fault."""
    orders = _orders(pair, caller)
    began_ns = broken_ns = monotonic_ns()
    for number, (pid, order) in enumerate(orders):
        if number and pair.members:
            await trio.sleep(apart_s)
        broken_ns = monotonic_ns()
        try:
            os.kill(pid, order)
        except ProcessLookupError:
            if not number:
                raise NotMoving(f"a process of {pair.victim} had ended before it was to break") from None
            # If only the second process to break is missing, the first fault has ended it, and the trial counts.
    return began_ns, broken_ns


def let_go(pair: Cell | Pair, caller: Caller) -> None:
    """Let the frozen processes of a pair, or of a cell, continue.

    They must not write: they were killed, or they have no connection to the robot.
    """
    for member, fault in pair.faults:
        if fault is Faults.FREEZE and member != Victims.CALLER:
            with contextlib.suppress(ProcessLookupError):
                os.kill(caller.pid(member), signal.SIGCONT)


def _orders(pair: Pair, caller: Caller) -> list[tuple[int, signal.Signals]]:
    """Return the process ids and the signals for them, in random order."""
    if not pair.members:
        own = [pid for role, pid in caller.pids().items() if role != Victims.TWIN]
        return [(pid, signal.SIGTERM) for pid in own if "python" in Path(f"/proc/{pid}/comm").read_text()]
    orders = [(caller.pid(member), SIGNALS[fault]) for member, fault in pair.faults]
    random.shuffle(orders)
    return orders
