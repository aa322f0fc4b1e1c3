"""Run one cell of the kill matrix. A cell is one process (or the robot) and one way to break it.

The cell is run with a moving robot, and the log of the frames that the robot receives has the result.
"""

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
from strands_actors.contract.safe_state import SafeState
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
LOOK_S = 0.005
"""Seconds between two looks at the log, or at a file. Times are read from the log, so this changes no result."""
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
    """The result of a trial, from the log of the frames that the robot received.

    Times are in milliseconds. They begin at the fault, except in three cases. If the caller (the script) ended by
    itself, they begin at its end. If the robot was away, they begin when it returned. If a stop was ordered after
    the fault, they begin at the stop.
    """

    victim: str
    fault: str
    safe_state: str
    safe_ms: float
    bound_ms: float
    setpoints_after: int
    # True if a safe frame (a stop command) reached the whole robot, and if it was confirmed in the cases that
    # require a confirmation.
    all_motors: bool
    # For a caller that ends by itself: the time from its last statement until its process has ended (ms).
    gone_ms: float = 0.0
    # Time for which the robot's processes, the simulated robot and this process waited for a processor (ms).
    stood_ms: float = 0.0
    # Another safe state that the robot reached before the fault had an effect, because a process had no processor.
    instead: str = ""
    # For a result that is unsafe or late: the frames, with their times in milliseconds from the fault.
    story: str = ""

    @property
    def safe(self) -> bool:
        """True if the whole robot reached the safe state, and no setpoint came after it."""
        return self.all_motors and self.setpoints_after == 0

    @property
    def late(self) -> bool:
        """True if the safe frame (the stop command) came later than the published bound."""
        return self.safe_ms > self.bound_ms

    @property
    def on_time(self) -> bool:
        """True if the safe frame (stop command) came within the bound, when waits for a processor are subtracted.

        So a test that shares the computer with other tests is judged by the same bound as a measurement.
        """
        return self.safe_ms - self.stood_ms <= self.bound_ms

    @property
    def disturbed(self) -> bool:
        """True if the robot was stopped safely, but a busy computer has spoiled the measurement.

        There are two cases.

        The stop was late, because processes waited for a processor for longer than ``DISTURBED_MS``. Without that
        wait it would have been in time. Or the robot reached another safe state, because a process without a
        processor looked frozen before the fault had an effect. An unsafe trial always counts.
        """
        explained = self.stood_ms > DISTURBED_MS and self.on_time
        return self.safe and (bool(self.instead) or (self.late and explained))


def _motion(cell: Cell, driver: Driver) -> str:
    # If a thread of the caller computes for ever, a policy in the caller still runs. Only a loop in the script is
    # stopped by it.
    if driver.TASKS:
        return "loop" if (cell.victim, cell.fault) == (Victims.CALLER, Faults.SPIN) else "rollout"
    return "loop" if cell.victim in (Victims.CALLER, Victims.TWIN) or driver.ROLLOUTS else "task"


def run_cell(cell: Cell, bench: Bench, settle_s: float = SETTLE_S) -> Outcome:
    """Move the robot, break the victim (a process or the robot), and read the result from the log of the frames.

    Args:
        cell: The victim and the fault.
        bench: The bench (a simulated robot, and the script that moves it).
        settle_s: Time for which the log is watched after the safe frame (the stop command), in seconds.

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
    """Make the robot move, with several attempts, and run a trial (break something, and read the result).

    Args:
        bench: The bench (a simulated robot, and the script that moves it).
        motion: The motion (``testing.caller``).
        trial: Function that breaks something and returns the result.
        drop: True if the caller (the script that moves the robot) cannot be used again after the trial.
        extras: Processes that run only on request and must run in the trial, by role.

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
    # The nursery that watches the victim has raised these exceptions.
    except BaseExceptionGroup as group:
        not_moving, others = group.split(NotMoving)
        if not_moving is None or others is not None:
            raise
        drop = True
        raise NotMoving(str(first_of(not_moving))) from group
    finally:
        if drop:
            bench.drop()


def tries(cell: C, bench: Bench, trials: int, run: Callable[[C, Bench], Outcome]) -> Iterator[Outcome]:
    """Run trials of a cell, and yield their results, until enough trials are undisturbed.

    A busy computer disturbs a trial (``Outcome.disturbed``). At most ``MOST`` times as many trials are run as
    requested.

    Args:
        cell: The cell (a process and how it breaks), or a pair of two processes.
        bench: The bench (a simulated robot, and the script that moves it).
        trials: Number of undisturbed trials to reach.
        run: Function that runs one trial: ``run_cell`` or ``run_pair``.

    Raises:
        NotMoving: The robot cannot be made to move. The text names robot and cell.
    """
    undisturbed = 0
    for _ in range(MOST * trials):
        try:
            outcome = run(cell, bench)
        except NotMoving as error:
            raise NotMoving(f"{bench.robot}, {cell}: {error}") from error
        yield outcome
        undisturbed += not outcome.disturbed
        if undisturbed == trials:
            return


# -- break a process, and read the result


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
        began_ns = await inflict(caller, cell, pid)
        await until_safe(bench.log, began_ns, queue)
        waited_ms = queue.waited_ms()
        await trio.sleep(settle_s)
        if cell.fault is Faults.FREEZE and cell.victim is not Victims.CALLER:
            # Let the frozen process continue. It must not write: it was killed, or it has no connection to the
            # robot.
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
            await trio.sleep(settle_s)
        nursery.cancel_scope.cancel()
    ended_by_itself = cell.victim is Victims.CALLER and cell.fault not in LIVING and died_ns
    since_ns = died_ns[0] if ended_by_itself else began_ns
    exit_ms = (died_ns[0] - began_ns) / 1e6 if ended_by_itself else 0.0
    require_motion(bench.log, began_ns)
    expected = expected_of(bench.driver, cell, bench.hosted)
    return with_story(read(bench.log, expected, began_ns, since_ns, exit_ms, waited_ms), bench.log, began_ns)


async def _break_bystander(bench: Bench, caller: Caller, cell: Cell, settle_s: float) -> Outcome:
    pid = caller.pid(cell.victim)
    queue = bench.queue(caller, pid)
    broken_ns = await inflict(caller, cell, pid)
    expected = expected_of(bench.driver, cell, bench.hosted)
    outcome = await stop_after(bench, caller, expected, broken_ns, queue, settle_s)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)
    await trio.sleep(settle_s)
    after = bench.log.setpoints_after_safe(broken_ns)
    return replace(outcome, setpoints_after=max(outcome.setpoints_after, after))


async def stop_after(
    bench: Bench, caller: Caller, expected: Expected, broken_ns: int, queue: Queue, settle_s: float
) -> Outcome:
    """Check that the robot still moves after a fault of bystanders only, then stop it, and return the result.

    Bystanders are processes that do not move the robot. So the result is not safe if their fault has stopped or
    held the robot. ``queue`` is a measurement since the fault.
    """
    await trio.sleep(GOES_ON_S)
    require_motion(bench.log, broken_ns)
    ended_by_fault = bench.log.host("safe", broken_ns)
    if ended_by_fault and queue.waited_ms() > DISTURBED_MS:
        raise NotMoving("this computer is busy: the robot was held before it was stopped")
    queue = bench.queue(caller)
    caller.send_order("stop")
    answer = await trio.to_thread.run_sync(caller.line)
    since_ns: int = answer["at_ns"]
    await until_safe(bench.log, since_ns, queue)
    waited_ms = queue.waited_ms()
    await trio.sleep(settle_s)
    outcome = read(bench.log, expected, since_ns, since_ns, 0.0, waited_ms)
    confirmed = answer["confirmed"] and not ended_by_fault
    return with_story(outcome if confirmed else replace(outcome, all_motors=False), bench.log, broken_ns)


async def inflict(caller: Caller, cell: Cell, pid: int) -> int:
    """Break the victim (a process or the robot), and return the time of the fault (ns)."""
    if cell.fault in SIGNALS:
        began_ns = monotonic_ns()
        try:
            os.kill(pid, SIGNALS[cell.fault])
        except ProcessLookupError:
            raise NotMoving(f"the {cell.victim} process had ended before it was to break") from None
        return began_ns
    if cell.victim is Victims.CALLER:
        caller.send_order(cell.fault)
        began: int = (await trio.to_thread.run_sync(caller.line))["at_ns"]
        return began
    if cell.victim is Victims.POLICY:
        caller.trigger.write_text(cell.fault)
        try:
            return await until(caller.policy_broke_ns)
        except trio.TooSlowError:
            raise NotMoving("the policy had ended before it was to break") from None
    return await ask_to_break(caller, cell.victim, cell.fault)


async def ask_to_break(caller: Caller, process: str, how: str) -> int:
    """Send a message to the root or wire process that makes it fail. Return the time at which it was sent (ns)."""
    robot = caller.tree["robot"]
    node = Node(f"kill.{os.getpid()}", MonotonicClock())
    mesh = await ZenohMesh.open(connect=[unix_endpoint(str(caller.run_dir / f"{robot}.{process}.sock"))])
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            mesh.attach(node)
            await nursery.start(mesh.run)
            address = f"{PREFIX}/{addresses.of(robot).introspection(process)}"

            def send_break() -> int | None:
                # Take the time before the message is sent. The fault may have an effect before this process runs
                # again.
                began_ns = monotonic_ns()
                return began_ns if node.send_frame(address, TELL, 0, node.address, Break(how)) else None

            began_ns = await until(send_break)
            nursery.cancel_scope.cancel()
    finally:
        await trio.to_thread.run_sync(mesh.close)
    return began_ns


# -- break the robot or its cable, and read the result


async def _break_robot(bench: Bench, caller: Caller, cell: Cell, settle_s: float) -> Outcome:
    broken_ns = monotonic_ns()
    if cell.returns:
        queue, since_ns = await trio.to_thread.run_sync(go_away, bench, caller, cell.fault)
        confirmed = True
    else:
        await trio.to_thread.run_sync(fall_ill, bench, cell.fault)
        queue = bench.queue(caller)
        caller.send_order("stop")
        answer = await trio.to_thread.run_sync(caller.line)
        since_ns, confirmed = answer["at_ns"], answer["confirmed"] or cell.fault not in CONFIRMED
    await until_safe(bench.log, since_ns, queue)
    waited_ms = queue.waited_ms()
    await trio.sleep(settle_s)
    bench.twin.fault("ok")
    require_motion(bench.log, broken_ns)
    outcome = read_robot(
        bench.log, cell, expected_of(bench.driver, cell, bench.hosted), broken_ns, since_ns, waited_ms
    )
    return with_story(outcome if confirmed else replace(outcome, all_motors=False), bench.log, since_ns)


def go_away(bench: Bench, caller: Caller, fault: Faults) -> tuple[Queue, int]:
    """Freeze the robot, or pull its cable, for a while.

    Return a measurement of how long processes wait for a processor, which begins when the robot returns, and the
    time of the return.
    """
    remove, bring_back = (
        (bench.twin.pause, bench.twin.go_on) if fault is Faults.FREEZE else (bench.twin.unplug, bench.twin.plug)
    )
    remove()
    time.sleep(AWAY_S)
    queue, since_ns = bench.queue(caller), monotonic_ns()
    bring_back()
    return queue, since_ns


def fall_ill(bench: Bench, fault: Faults) -> None:
    """Give the robot a fault, and wait until it has an effect. A late reply ends by itself."""
    bench.twin.fault("delayed" if fault is Faults.LATE_REPLY else fault)
    time.sleep(SICK_S)
    if fault is Faults.LATE_REPLY:
        bench.twin.fault("ok")
        time.sleep(SICK_S)


# -- the log


def require_motion(log: WireLog, broken_ns: int) -> None:
    """Raise ``NotMoving`` if the robot did not move when the fault began.

    On a busy computer the robot may have gone to a hold before.
    """
    last = ""
    for entry in log.entries():
        if entry.t_ns >= broken_ns:
            break
        if entry.kind in ("setpoint", "safe", "watchdog"):
            last = entry.kind
    if last != "setpoint":
        raise NotMoving(f"the last on the wire before it was broken is {last or 'nothing'}, no setpoint")


def read_robot(
    log: WireLog, cell: Cell, expected: Expected, broken_ns: int, since_ns: int, waited_ms: float
) -> Outcome:
    """Read the result of a fault of the robot itself, as ``read`` does for a process.

    The robot may have received the safe state before ``since_ns``: because of the fault, or while it was away. Then
    the stop only confirms the state, and does not write it again.

    Args:
        log: The log of the robot's frames.
        cell: The victim and the fault.
        expected: The expected safe states and the bound.
        broken_ns: Time of the fault.
        since_ns: Time at which the robot returned, or at which the stop was ordered.
        waited_ms: Time for which processes waited for a processor.
    """
    outcome = read(log, expected, since_ns, since_ns, 0.0, waited_ms)
    before_ns = safe_before(log, expected, broken_ns, since_ns)
    if before_ns is not None and (cell.stops or not outcome.all_motors):
        return read(log, expected, before_ns, since_ns, 0.0, waited_ms)
    return outcome


def safe_before(log: WireLog, expected: Expected, broken_ns: int, stopped_ns: int) -> int | None:
    """Return the time of the first expected safe frame (stop command) after a fault and before ``stopped_ns``.

    Return None if there was no such frame, or if a setpoint came after it.
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
    """The expected safe states after a fault of a process or robot, and the longest time until one is received."""

    victim: str
    fault: str
    safe_states: tuple[str, ...]  # each of these is accepted
    bound_ms: float


def expected_of(driver: Driver, cell: Cell, hosted: bool = False) -> Expected:
    """Return the safe states that the log may show after a fault, and the longest time until the first of them."""
    safe_states = expected_safe_states(driver, cell.victim, cell.fault, hosted)
    return Expected(cell.victim, cell.fault, safe_states, bound_s(driver, cell.victim, cell.fault) * 1e3)


def read(
    log: WireLog,
    expected: Expected,
    began_ns: int,
    since_ns: int,
    exit_ms: float = 0.0,
    waited_ms: float = 0.0,
) -> Outcome:
    """Read the result of a trial from the log of the frames.

    Args:
        log: The log of the robot's frames.
        expected: The expected safe states and the bound.
        began_ns: Time of the fault. Earlier frames are ignored.
        since_ns: Time from which the delay of the safe frame (the stop command) is measured.
        exit_ms: Time until the caller had ended, if it ended by itself.
        waited_ms: Time for which processes waited for a processor.
    """
    victim, fault, safe_states, bound_ms = expected
    frames = log.host("safe", began_ns)
    safe = next((entry for entry in frames if any(is_safe_state(entry, state) for state in safe_states)), None)
    instead = ""
    if safe is None and waited_ms > DISTURBED_MS:
        # The log has "" for a frame to only some motors. Such a frame does not count, because the other motors
        # continue.
        safe = next((entry for entry in frames if entry.safe_state), None)
        instead = (safe and safe.safe_state) or ""
    if safe is None:
        return Outcome(victim, fault, safe_states[0], math.inf, bound_ms, -1, False, exit_ms, waited_ms)
    shown = next((state for state in safe_states if is_safe_state(safe, state)), safe_states[0])
    safe_ms = max(0.0, (safe.t_ns - since_ns) / 1e6)
    after = log.setpoints_after_safe(began_ns)
    return Outcome(victim, fault, shown, safe_ms, bound_ms, after, True, exit_ms, waited_ms, instead)


def with_story(outcome: Outcome, log: WireLog, since_ns: int) -> Outcome:
    """Add a description of the frames to a result that is unsafe or late.

    The next trial overwrites the log of the frames.
    """
    return outcome if outcome.safe and not outcome.late else replace(outcome, story=log.story(since_ns))


async def until_safe(log: WireLog, since_ns: int, queue: Queue) -> None:
    """Wait until a safe frame (a stop command) is sent to the robot, for at most ``PATIENCE_S``.

    Args:
        log: The log of the robot's frames.
        since_ns: Frames before this time are ignored.
        queue: Measures how long the processes wait for a processor. Its ``look`` is called while this function
            waits, because a process that has ended can no longer be measured.
    """
    with contextlib.suppress(trio.TooSlowError):
        await until_frame(log, lambda entry: entry.kind == "safe" and entry.t_ns >= since_ns, queue)


async def until_frame(
    log: WireLog, is_it: Callable[[Entry], bool], queue: Queue | None = None, within_s: float = PATIENCE_S
) -> None:
    """Wait until a frame for which ``is_it`` returns True is sent to the robot.

    Each frame is read once: to read the whole log each time would take a processor that the robot's processes need.

    Raises:
        TooSlowError: No such frame came within ``within_s``.
    """
    tail = log.tail()

    def look() -> bool:
        if queue is not None:
            queue.look()
        return any(entry.sender == "host" and is_it(entry) for entry in tail.new())

    await until(look, within_s)


async def until(look: Callable[[], T | None], within_s: float = PATIENCE_S) -> T:
    """Call the function ``look`` repeatedly until it returns a result.

    Raise ``TooSlowError`` after ``within_s``.
    """
    with trio.fail_after(within_s):
        while not (result := look()):  # noqa: ASYNC110  # another process causes it, so there is no event
            await trio.sleep(LOOK_S)
    return result


def is_safe_state(entry: Entry, safe_state: str) -> bool:
    """Return True if a frame brings the whole robot to ``safe_state``.

    If the frame's entry in the log does not name a state, every safe frame (stop command) counts.
    """
    return entry.safe_state is None or entry.safe_state == SafeState(safe_state).first
