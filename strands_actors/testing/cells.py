"""Run one cell of the kill matrix: break one process of a moving robot in one way, and read the wire."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import monotonic_ns
from typing import NamedTuple, TypeVar

import trio
import trio.lowlevel

from strands_actors.contract.driver import Driver
from strands_actors.kernel.actor import first_of
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh, unix_endpoint
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import TELL
from strands_actors.kernel.node import PREFIX, Node
from strands_actors.kernel.processes.process import wait_for_end_of
from strands_actors.supervisors import addresses
from strands_actors.supervisors.introspection import Break

from .bench import Bench, Caller, NotMoving, extras_for
from .faults import (
    CONFIRMED,
    LIVING,
    SIGNALS,
    Cell,
    Faults,
    Victims,
    bound_s,
    expected_safe_states,
    is_bystander,
    spoils,
)
from .queueing import DISTURBED_MS, Queue
from .wirelog import Entry, WireLog

T = TypeVar("T")
C = TypeVar("C")

SETTLE_S = 0.4
"""Seconds that the wire is watched after the safe frame."""
MOST = 2
"""The most trials, as a multiple of the requested number, when some are disturbed."""
STARTS = 3
"""Attempts to start a trial. A machine that pauses may stop the robot before the fault."""
PATIENCE_S = 5.0
"""Seconds to wait for the safe frame. On any wire it is a failure long before."""
AWAY_S = 1.0
"""Seconds that a robot is frozen or its cable is out: longer than any wire takes to notice."""
GOES_ON_S = 0.5
"""Seconds that a robot must go on after a fault of a bystander before it is stopped. The effect of a missing
process shows earlier."""
SICK_S = 0.15
"""Seconds that a robot has its fault before it is stopped. Many replies are affected, and the link has not been
given up yet."""


@dataclass(frozen=True)
class Outcome:
    """The result of a trial, from the wire.

    Times are milliseconds from the fault, from the end of the process that it led to, from the end of the
    fault, or from the stop.
    """

    victim: str
    fault: str
    safe_state: str
    safe_ms: float
    bound_ms: float
    setpoints_after: int
    # A safe frame reached the whole robot, and was confirmed where it must be.
    all_motors: bool
    # Of a caller that ends by itself: the time from its last statement to its end.
    gone_ms: float = 0.0
    # The time for which the processes of the tree, the twin and the bench waited for a processor.
    stood_ms: float = 0.0
    # The safe state that the robot reached before the fault could show, because a process lacked a processor.
    instead: str = ""
    # For a result that is not safe or late: the events on the wire, in milliseconds from the fault.
    story: str = ""

    @property
    def safe(self) -> bool:
        """True if the whole robot reached the safe state, and no setpoint came after it."""
        return self.all_motors and self.setpoints_after == 0

    @property
    def late(self) -> bool:
        """True if the safe frame came after the published bound."""
        return self.safe_ms > self.bound_ms

    @property
    def on_time(self) -> bool:
        """True if the safe frame came within the bound plus the wait of the processes for a processor.

        So a test that runs next to others is held by the same bound as a measurement.
        """
        return self.safe_ms - self.stood_ms <= self.bound_ms

    @property
    def disturbed(self) -> bool:
        """True if the result is safe, but shows the machine and not the robot.

        One case is late: its processes waited for a processor for longer than ``DISTURBED_MS``, and without
        that it would have kept its bound. The other case is another safe state: a process that got no processor
        looked frozen before the fault showed. A trial that is not safe is never excused.
        """
        explained = self.stood_ms > DISTURBED_MS and self.on_time
        return self.safe and (bool(self.instead) or (self.late and explained))


def _motion(cell: Cell, driver: Driver) -> str:
    # A rollout continues next to a thread that computes.
    if driver.TASKS:
        return "loop" if (cell.victim, cell.fault) == (Victims.CALLER, Faults.SPIN) else "rollout"
    return "loop" if cell.victim in (Victims.CALLER, Victims.TWIN) or driver.ROLLOUTS else "task"


def run_cell(cell: Cell, bench: Bench, settle_s: float = SETTLE_S) -> Outcome:
    """Move the robot, break the victim, and read the log.

    Args:
        cell: The victim and the fault.
        bench: The robot.
        settle_s: Seconds that the wire is watched after the safe frame.

    Raises:
        NotMoving: The robot cannot be made to move.
    """
    bystander = is_bystander(cell.victim)
    breaks = _break_robot if cell.victim is Victims.TWIN else _break_bystander if bystander else _break_process
    motion = _motion(cell, bench.driver)

    def trial(caller: Caller) -> Outcome:
        return trio.run(breaks, bench, caller, cell, settle_s)

    return persevere(bench, motion, trial, spoils(cell.victim, cell.fault), extras_for(cell.members))


def persevere(
    bench: Bench,
    motion: str,
    trial: Callable[[Caller], Outcome],
    drop: bool,
    extras: frozenset[str] = frozenset(),
) -> Outcome:
    """Make a trial with a caller and a moving robot, with several attempts to make it move.

    Args:
        bench: The robot.
        motion: The motion (``testing.caller``).
        trial: Breaks the robot and returns the result.
        drop: True if the caller cannot be used again.
        extras: Further processes of its tree.

    Raises:
        NotMoving: The robot cannot be made to move.
    """
    for attempt in range(STARTS):
        try:
            return _once(bench, motion, trial, drop, extras)
        except NotMoving:
            if attempt == STARTS - 1:
                raise
    raise AssertionError


def _once(
    bench: Bench, motion: str, trial: Callable[[Caller], Outcome], drop: bool, extras: frozenset[str]
) -> Outcome:
    caller = bench.moving(motion, extras)
    try:
        return trial(caller)
    except NotMoving:
        drop = True
        raise
    except BaseExceptionGroup as group:  # raised by the nursery that watches the victim
        not_moving, other = group.split(NotMoving)
        if not_moving is None or other is not None:
            raise
        drop = True
        raise NotMoving(str(first_of(not_moving))) from group
    finally:
        if drop:
            bench.drop()


def tries(cell: C, bench: Bench, trials: int, run: Callable[[C, Bench], Outcome]) -> Iterator[Outcome]:
    """Yield trials until enough of them are undisturbed, or ``MOST`` times as many were made.

    Args:
        cell: The cell or pair.
        bench: The robot.
        trials: Number of undisturbed trials.
        run: Makes one trial: ``run_cell`` or ``run_pair``.

    Raises:
        NotMoving: The robot cannot be made to move. The text names robot and cell.
    """
    undisturbed = 0
    for _ in range(MOST * trials):
        try:
            outcome = run(cell, bench)
        except NotMoving as why:
            raise NotMoving(f"{bench.robot}, {cell}: {why}") from why
        yield outcome
        undisturbed += not outcome.disturbed
        if undisturbed == trials:
            return


# -- a process of the tree


async def _break_process(bench: Bench, caller: Caller, cell: Cell, settle_s: float) -> Outcome:
    pid = caller.pid(cell.victim)
    died_ns: list[int] = []

    async def watch() -> None:
        await wait_for_end_of(pid)
        died_ns.append(monotonic_ns())

    async with trio.open_nursery() as nursery:
        nursery.start_soon(watch)
        await trio.lowlevel.checkpoint()
        queue = bench.queue(caller, pid)
        began_ns = await _inflict(caller, cell, pid)
        await until_safe(bench.log, began_ns, queue)
        stood_ms = queue.stood_ms()
        await trio.sleep(settle_s)
        if cell.fault is Faults.FREEZE and cell.victim is not Victims.CALLER:
            # A frozen process that continues must not write. It was fenced, or has no access to the wire.
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
            await trio.sleep(settle_s)
        nursery.cancel_scope.cancel()
    ended_by_itself = cell.victim is Victims.CALLER and cell.fault not in LIVING and died_ns
    since_ns = died_ns[0] if ended_by_itself else began_ns
    gone_ms = (died_ns[0] - began_ns) / 1e6 if ended_by_itself else 0.0
    require_motion(bench.log, began_ns)
    expected = expected_of(bench.driver, cell)
    return told(read(bench.log, expected, began_ns, since_ns, gone_ms, stood_ms), bench.log, began_ns)


async def _break_bystander(bench: Bench, caller: Caller, cell: Cell, settle_s: float) -> Outcome:
    pid = caller.pid(cell.victim)
    queue = bench.queue(caller, pid)
    broken_ns = await _inflict(caller, cell, pid)
    expected = expected_of(bench.driver, cell)
    outcome = await stop_after(bench, caller, expected, broken_ns, queue, settle_s)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)
    await trio.sleep(settle_s)
    after = bench.log.setpoints_after_safe(broken_ns)
    return replace(outcome, setpoints_after=max(outcome.setpoints_after, after))


async def stop_after(
    bench: Bench, caller: Caller, expected: Expected, broken_ns: int, queue: Queue, settle_s: float
) -> Outcome:
    """Check that the robot goes on after a fault of bystanders alone, then stop it.

    A robot that was stopped or held by the fault does not count as safe, since these processes do not move it.
    ``queue`` measures since the fault.
    """
    await trio.sleep(GOES_ON_S)
    require_motion(bench.log, broken_ns)
    ended_by_fault = bench.log.host("safe", broken_ns)
    if ended_by_fault and queue.stood_ms() > DISTURBED_MS:
        raise NotMoving("this computer is busy: the robot was held before it was stopped")
    queue = bench.queue(caller)
    caller.tell("stop")
    answer = await trio.to_thread.run_sync(caller.line)
    since_ns: int = answer["at_ns"]
    await until_safe(bench.log, since_ns, queue)
    stood_ms = queue.stood_ms()
    await trio.sleep(settle_s)
    outcome = read(bench.log, expected, since_ns, since_ns, 0.0, stood_ms)
    confirmed = answer["confirmed"] and not ended_by_fault
    return told(outcome if confirmed else replace(outcome, all_motors=False), bench.log, broken_ns)


async def _inflict(caller: Caller, cell: Cell, pid: int) -> int:
    """Break the victim, and return the time at which it broke."""
    if cell.fault in SIGNALS:
        began_ns = monotonic_ns()
        try:
            os.kill(pid, SIGNALS[cell.fault])
        except ProcessLookupError:
            raise NotMoving(f"the {cell.victim} process had ended before it was to break") from None
        return began_ns
    if cell.victim is Victims.CALLER:
        caller.tell(cell.fault)
        began: int = (await trio.to_thread.run_sync(caller.line))["at_ns"]
        return began
    if cell.victim is Victims.POLICY:
        caller.trigger.write_text(cell.fault)
        try:
            return await _until(caller.policy_broke_ns)
        except trio.TooSlowError:
            raise NotMoving("the policy had ended before it was to break") from None
    return await ask_to_break(caller, cell.victim, cell.fault)


async def ask_to_break(caller: Caller, process: str, how: str) -> int:
    """Order the root or the wire to break itself, and return the time of the order."""
    robot = caller.tree["robot"]
    node = Node(f"kill.{os.getpid()}", MonotonicClock())
    mesh = await ZenohMesh.open(connect=[unix_endpoint(str(caller.run_dir / f"{robot}.{process}.sock"))])
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            mesh.attach(node)
            await nursery.start(mesh.run)
            address = f"{PREFIX}/{addresses.of(robot).introspection(process)}"

            def tell() -> int | None:
                # The time is taken before the order. Its effect may be on the wire before this process runs
                # again.
                began_ns = monotonic_ns()
                return began_ns if node.send_frame(address, TELL, 0, node.address, Break(how)) else None

            began_ns = await _until(tell)
            nursery.cancel_scope.cancel()
    finally:
        await trio.to_thread.run_sync(mesh.close)
    return began_ns


# -- the robot's end of the wire


async def _break_robot(bench: Bench, caller: Caller, cell: Cell, settle_s: float) -> Outcome:
    broken_ns = monotonic_ns()
    if cell.returns:
        queue, since_ns = await trio.to_thread.run_sync(_go_away, bench, caller, cell.fault)
        confirmed = True
    else:
        await trio.to_thread.run_sync(_fall_ill, bench, cell.fault)
        queue = bench.queue(caller)
        caller.tell("stop")
        answer = await trio.to_thread.run_sync(caller.line)
        since_ns, confirmed = answer["at_ns"], answer["confirmed"] or cell.fault not in CONFIRMED
    await until_safe(bench.log, since_ns, queue)
    stood_ms = queue.stood_ms()
    await trio.sleep(settle_s)
    bench.twin.fault("ok")
    require_motion(bench.log, broken_ns)
    outcome = read_robot(bench.log, cell, expected_of(bench.driver, cell), broken_ns, since_ns, stood_ms)
    return told(outcome if confirmed else replace(outcome, all_motors=False), bench.log, since_ns)


def _go_away(bench: Bench, caller: Caller, fault: Faults) -> tuple[Queue, int]:
    """Freeze the robot, or pull its cable, for a while.

    Return the measurement of waiting processes since its return, and the time of the return.
    """
    leave, come_back = (
        (bench.twin.pause, bench.twin.go_on) if fault is Faults.FREEZE else (bench.twin.unplug, bench.twin.plug)
    )
    leave()
    time.sleep(AWAY_S)
    queue, since_ns = bench.queue(caller), monotonic_ns()
    come_back()
    return queue, since_ns


def _fall_ill(bench: Bench, fault: Faults) -> None:
    bench.twin.fault("delayed" if fault is Faults.LATE_REPLY else fault)
    time.sleep(SICK_S)
    if fault is Faults.LATE_REPLY:
        bench.twin.fault("ok")
        time.sleep(SICK_S)


# -- the log


def require_motion(log: WireLog, broken_ns: int) -> None:
    """Raise ``NotMoving`` if the robot was at rest when it was broken. It may have been held on a busy machine."""
    last = ""
    for entry in log.entries():
        if entry.t_ns >= broken_ns:
            break
        if entry.kind in ("setpoint", "safe", "watchdog"):
            last = entry.kind
    if last != "setpoint":
        raise NotMoving(f"the last on the wire before it was broken is {last or 'nothing'}, no setpoint")


def read_robot(
    log: WireLog, cell: Cell, expected: Expected, broken_ns: int, since_ns: int, stood_ms: float
) -> Outcome:
    """Read the result of a fault of the robot itself, as ``read`` does.

    The robot may have got the safe state before ``since_ns``: because of the fault, or while it was away, so
    that it read the frame on its return. The stop then confirms the state and does not write it again.

    Args:
        log: The log of the wire.
        cell: The victim and the fault.
        expected: What the wire must show.
        broken_ns: When the robot was broken.
        since_ns: When it returned, or when the stop was ordered.
        stood_ms: The time for which processes waited for a processor.
    """
    outcome = read(log, expected, since_ns, since_ns, 0.0, stood_ms)
    before_ns = safe_before(log, expected, broken_ns, since_ns)
    if before_ns is not None and (cell.stops or not outcome.all_motors):
        return read(log, expected, before_ns, since_ns, 0.0, stood_ms)
    return outcome


def safe_before(log: WireLog, expected: Expected, broken_ns: int, stopped_ns: int) -> int | None:
    """Return the time of the first expected safe frame after a fault and before ``stopped_ns``.

    None if there was no such frame, or if a setpoint came after it.
    """
    since_ns: int | None = None
    for entry in log.entries(broken_ns):
        if entry.t_ns >= stopped_ns:
            break
        if entry.sender != "host":
            continue
        if entry.kind == "setpoint":
            since_ns = None
        elif (
            entry.kind == "safe" and since_ns is None and any(is_safe_state(entry, s) for s in expected.safe_states)
        ):
            since_ns = entry.t_ns
    return since_ns


class Expected(NamedTuple):
    """The expected result of a cell on the wire."""

    victim: str
    fault: str
    safe_states: tuple[str, ...]  # any of these
    bound_ms: float


def expected_of(driver: Driver, cell: Cell) -> Expected:
    """Return the safe states that the wire may show after the fault of a cell, and the bound."""
    safe_states = expected_safe_states(driver, cell.victim, cell.fault)
    return Expected(cell.victim, cell.fault, safe_states, bound_s(driver, cell.victim, cell.fault) * 1e3)


def read(
    log: WireLog,
    expected: Expected,
    began_ns: int,
    since_ns: int,
    gone_ms: float = 0.0,
    stood_ms: float = 0.0,
) -> Outcome:
    """Read the result of a trial.

    Args:
        log: The log of the wire.
        expected: What the wire must show.
        began_ns: Frames count from this time on.
        since_ns: The time of the safe frame is measured from here.
        gone_ms: Of a caller that ended by itself.
        stood_ms: The time for which processes waited for a processor.
    """
    victim, fault, safe_states, bound_ms = expected
    frames = log.host("safe", began_ns)
    safe = next((entry for entry in frames if any(is_safe_state(entry, state) for state in safe_states)), None)
    instead = ""
    if safe is None and stood_ms > DISTURBED_MS:
        # The log has "" for a frame to only some motors. The rest of the robot goes on then, so it does not
        # count.
        safe = next((entry for entry in frames if entry.safe_state), None)
        instead = (safe and safe.safe_state) or ""
    if safe is None:
        return Outcome(victim, fault, safe_states[0], math.inf, bound_ms, -1, False, gone_ms, stood_ms)
    shown = next((state for state in safe_states if is_safe_state(safe, state)), safe_states[0])
    safe_ms = max(0.0, (safe.t_ns - since_ns) / 1e6)
    after = log.setpoints_after_safe(began_ns)
    return Outcome(victim, fault, shown, safe_ms, bound_ms, after, True, gone_ms, stood_ms, instead)


def told(outcome: Outcome, log: WireLog, since_ns: int) -> Outcome:
    """Add the story of the wire to a result that is unsafe or late. The next trial overwrites the log."""
    return outcome if outcome.safe and not outcome.late else replace(outcome, story=log.story(since_ns))


async def until_safe(log: WireLog, since_ns: int, queue: Queue) -> None:
    """Wait until the host writes a safe frame, at most ``PATIENCE_S``.

    Args:
        log: The log of the wire.
        since_ns: Frames count from this time on.
        queue: Its ``look`` is called at each poll, since a process may end before the measurement does.
    """
    tail = log.tail()

    def look() -> bool:
        queue.look()
        return any(
            entry.kind == "safe" and entry.sender == "host" and entry.t_ns >= since_ns for entry in tail.new()
        )

    with contextlib.suppress(trio.TooSlowError):
        await _until(look)


async def _until(look: Callable[[], T | None]) -> T:
    """Poll until ``look`` returns a result. Raise ``TooSlowError`` after ``PATIENCE_S``."""
    with trio.fail_after(PATIENCE_S):
        while not (seen := look()):  # noqa: ASYNC110  # another process causes it, so there is no event
            await trio.sleep(0.002)
    return seen


def is_safe_state(entry: Entry, safe_state: str) -> bool:
    """Return True if a frame brings the whole robot to ``safe_state``.

    On a wire without this information every safe frame does.
    """
    return entry.safe_state is None or entry.safe_state == safe_state
