"""Run one trial of a column ``robot:lowering``: a process, or the robot, breaks while an arm is lowered.

The caller (a script) raises the arm and orders a stop. Some time after the first frame of the lowering, the victims
break. There are three cases:

* The wire or the root process breaks. Another process must switch the torque off within the bound of that fault.
* The robot or its cable fails. The torque is off when the robot is back, or at the end of the lowering's time.
* Any other process breaks. The arm goes on down, and is limp at the end of the time for it.

The log of the frames that the robot receives has the result. No frame may move or energise the arm afterwards.
"""

from __future__ import annotations

import contextlib
import math
import random
from collections.abc import Iterable, Iterator
from dataclasses import replace
from time import monotonic_ns

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.safe_state import SafeState

from .bench import Bench, Caller, NotMoving, extras_for
from .cells import PATIENCE_S, SETTLE_S, Outcome, fall_ill, go_away, inflict, persevere, until_frame, with_story
from .faults import RETURN_S, Cell, Victims, bound_s, spoils
from .pair_trials import break_both, let_go
from .pairs import APART_S, Pair, pair_bound_s
from .queueing import Queue
from .wirelog import Entry, WireLog

LONGEST_S = 1.2
"""Longest time from the first frame of the lowering to the fault. The arm still sinks then."""
MOVING = ("setpoint", "enable", "lowering")
"""Kinds of frames that may move or energise the arm."""


def lowering_cells(cells: Iterable[Cell | Pair]) -> Iterator[Cell | Pair]:
    """Yield the cells, or pairs, of a column ``robot:lowering``."""
    for cell in cells:
        ended = Victims.POLICY in cell.members
        why_not = cell.why_not or ("the policy has ended before the arm is lowered" if ended else "")
        yield replace(cell, why_not=why_not, proves=() if why_not else ("SAF-002", "SAF-026"))


def run_lowering(cell: Cell | Pair, bench: Bench, settle_s: float = SETTLE_S) -> Outcome:
    """Run one trial, as ``cells.run_cell`` does for a moving robot. The moment of the fault is random.

    Raises:
        NotMoving: The arm cannot be raised, or is not lowered.
    """
    after_s = random.uniform(0.0, LONGEST_S)

    def trial(caller: Caller) -> Outcome:
        return trio.run(_break, bench, caller, cell, after_s, settle_s)

    drop = not cell.members or any(spoils(member, fault) for member, fault in cell.faults)
    return persevere(bench, "raise", trial, drop, extras_for(cell.members))


def longest_s(driver: Driver, cell: Cell | Pair) -> float:
    """Return the published time from the fault until the torque is off, in seconds."""
    if isinstance(cell, Cell) and cell.returns:
        return RETURN_S
    if not {Victims.WIRE, Victims.ROOT} & set(cell.members):
        return driver.timing.safe_s
    return pair_bound_s(driver, cell) if isinstance(cell, Pair) else bound_s(driver, cell.victim, cell.fault)


async def _break(bench: Bench, caller: Caller, cell: Cell | Pair, after_s: float, settle_s: float) -> Outcome:
    log, bound = bench.log, longest_s(bench.driver, cell)
    caller.send_order("lower")
    began_ns: int = (await trio.to_thread.run_sync(caller.line))["at_ns"]
    try:
        await until_frame(log, lambda entry: entry.kind == "lowering" and entry.t_ns >= began_ns)
    except trio.TooSlowError:
        raise NotMoving("the arm is not lowered") from None
    await trio.sleep(after_s)
    _require_lowering(log, began_ns)
    broken_ns, since_ns, queue = await _do(bench, caller, cell)
    await _until_limp(log, broken_ns, queue, bound + PATIENCE_S)
    # The torque may have been switched off just before the fault, after the first look.
    _require_lowering(log, began_ns, broken_ns)
    waited_ms = queue.waited_ms()
    await trio.sleep(settle_s)
    if cell.victim is Victims.TWIN:
        bench.twin.fault("ok")
    else:
        let_go(cell, caller)
    await trio.sleep(settle_s)
    outcome = _read(log, cell, began_ns, broken_ns, since_ns, bound)
    return with_story(replace(outcome, stood_ms=waited_ms), log, broken_ns)


async def _do(bench: Bench, caller: Caller, cell: Cell | Pair) -> tuple[int, int, Queue]:
    """Break the victims.

    Return the time of the first fault, the time from which the delay is measured, and a measurement since then of
    how long processes wait for a processor.
    """
    queue, broken_ns = bench.queue(caller), monotonic_ns()
    if isinstance(cell, Pair):
        return *await break_both(cell, caller, random.uniform(0.0, APART_S)), queue
    if cell.returns:
        queue, since_ns = await trio.to_thread.run_sync(go_away, bench, caller, cell.fault)
        return broken_ns, since_ns, queue
    if cell.victim is Victims.TWIN:
        await trio.to_thread.run_sync(fall_ill, bench, cell.fault)
    else:
        broken_ns = await inflict(caller, cell, caller.pid(cell.victim))
    return broken_ns, broken_ns, queue


# -- the log


def _require_lowering(log: WireLog, began_ns: int, broken_ns: float = math.inf) -> None:
    """Raise ``NotMoving`` if the torque was switched off before the fault: the trial then shows nothing."""
    limp = _limp(log, began_ns)
    if limp is not None and limp.t_ns < broken_ns:
        raise NotMoving("the arm was down before the fault")


async def _until_limp(log: WireLog, since_ns: int, queue: Queue, within_s: float) -> None:
    with contextlib.suppress(trio.TooSlowError):
        await until_frame(log, lambda entry: entry.t_ns >= since_ns and _is_limp(entry), queue, within_s)


def _limp(log: WireLog, since_ns: int) -> Entry | None:
    """Return the first frame that switches the torque of the whole arm off."""
    return next((entry for entry in log.host("safe", since_ns) if _is_limp(entry)), None)


def _is_limp(entry: Entry) -> bool:
    return entry.kind == "safe" and entry.safe_state == SafeState.LIMP


def _read(log: WireLog, cell: Cell | Pair, began_ns: int, broken_ns: int, since_ns: int, bound: float) -> Outcome:
    limp = _limp(log, broken_ns)
    if limp is None:
        return Outcome(cell.victim, cell.fault, SafeState.LIMP, math.inf, bound * 1e3, -1, False)
    safe_ms = max(0.0, (limp.t_ns - since_ns) / 1e6)
    return Outcome(
        cell.victim, cell.fault, SafeState.LIMP, safe_ms, bound * 1e3, _moved(log, began_ns, broken_ns), True
    )


def _moved(log: WireLog, began_ns: int, broken_ns: int) -> int:
    """Count the frames that may move the arm after its torque was switched off, and setpoints after its hold.

    The order in the log decides.
    """
    held = limp = False
    count = 0
    for entry in log.entries(began_ns):
        if entry.sender != "host":
            continue
        is_hold = entry.kind == "safe" and entry.safe_state == SafeState.HOLD
        count += limp and (entry.kind in MOVING or is_hold)
        count += held and not limp and entry.kind == "setpoint"
        held = held or is_hold
        limp = limp or (_is_limp(entry) and entry.t_ns >= broken_ns)
    return count
