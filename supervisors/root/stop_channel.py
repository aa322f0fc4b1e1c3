"""Making a robot safe without its wire process: one attempt, and how often there is another.

The guardian does so after a fence, a wire process whose root is gone when its own chain could not.
What an attempt does not confirm is tried again: a cable comes back, a servo that was talked over
hears the next frame.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Sequence

import msgspec
import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.names import look_up
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.page import Owed

AGAIN_S = (0.1, 0.5, 1.0, 2.0)
"""Pauses between attempts; the last one goes on."""
INSIST_S = 2.0
"""How long the guardian tries before it starts the next wire all the same, which then goes on with
it. A serial port is open in one process only, and it is the wire that can tell a person which motor
is missing."""
LINGER_S = 60.0
"""How long a process without a caller or root stays for a robot that is not confirmed safe."""
UNSETTLED = "an arming or service that was cut off may still take effect"


async def serve(path: StopChannel, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
    """As ``path.serve``, after the hosts that it will connect to have been looked up. Raise
    ``WireDown``."""
    for host in path.hosts:
        try:
            await look_up(host, 0)
        except (OSError, UnicodeError) as error:
            raise WireDown(f"{host}: no such host ({error}). Check port=") from None
    await path.serve(task_status)


async def attempt(path: StopChannel, driver: Driver, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Make safe by ``path``, with what this process holds in reserve. Never raises: whatever fails is
    a report of motors that were not reached."""
    within_s = StopDeadlines.of(driver.timing.safe_s).attempt_s
    try:
        with RESERVE.freed(), trio.fail_after(within_s):
            return await path.make_safe(safe_state)
    except trio.TooSlowError:
        why = f"no end within {within_s:g} s"
    except Exception as error:  # of a driver; the next attempt may do better
        why = describe(error)
    return not_reached(driver, why)


async def attempt_anew(
    driver: Driver, clock: Clock, safe_state: SafeState, descriptors: Sequence[int] = ()
) -> tuple[MotorReport, ...]:
    """As ``attempt``, by a path that is made for it. ``descriptors``: what a wire handed over, if
    one did."""
    motors = not_reached(driver, "the way to the hardware was lost")
    try:
        with RESERVE.freed():
            path = driver.stop_channel(descriptors, clock)
            try:
                async with trio.open_nursery() as nursery:
                    if path.SERVED_FIRST:
                        ready = trio.Event()
                        nursery.start_soon(_serve_until_lost, path, ready)
                        with trio.move_on_after(driver.timing.handover_s):
                            await ready.wait()
                    motors = await attempt(path, driver, safe_state)
                    nursery.cancel_scope.cancel()
            finally:
                path.close()
    except Exception as error:
        if not any(motor.written for motor in motors):
            motors = not_reached(driver, describe(error))
    return motors


async def _serve_until_lost(path: StopChannel, ready: trio.Event) -> None:
    """Serve it; ``ready`` is set once it could be used at once, or it has failed. Then the attempt
    does what it can without."""
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(path.serve)
            ready.set()
    except* WireDown:
        ready.set()


async def settled(
    owed: Owed, clock: Clock, make_safe: Callable[[], Awaitable[tuple[MotorReport, ...]]]
) -> tuple[MotorReport, ...]:
    """Make safe, and again until nothing that was asked for before can take effect any more.

    An arming that was cut off may energise a robot after the frame that made it safe. So the safe
    state is written at once, and written and read back again after ``Owed.unsettled_s`` has passed.
    Only that last report says that the robot is safe.

    Args:
        owed: The page on which the wire noted what it asked for.
        make_safe: One attempt.

    Returns:
        The report of the last attempt. One that is not safe ends it early: the caller tries again
        anyway. Without a fence of the wire that asks, no motor is reported as safe.
    """
    while True:
        unsettled_s = owed.unsettled_s(clock.now_ns())
        motors = await make_safe()
        if not unsettled_s or not all_safe(motors):
            return motors
        if owed.is_asking:
            return not_settled(motors)
        await trio.sleep(min(unsettled_s, AGAIN_S[0]))


def not_settled(motors: Sequence[MotorReport]) -> tuple[MotorReport, ...]:
    """Return the reports as not confirmed: what was asked for before may still take effect."""
    return tuple(msgspec.structs.replace(motor, safe=False, detail=UNSETTLED) for motor in motors)


def pauses_s() -> Iterator[float]:
    """Return how long to wait before each further attempt."""
    yield from AGAIN_S
    while True:
        yield AGAIN_S[-1]


def all_safe(motors: Sequence[MotorReport]) -> bool:
    return all(motor.safe for motor in motors)


def not_reached(driver: Driver, why: str) -> tuple[MotorReport, ...]:
    return tuple(
        MotorReport(axis, number, False, False, False, why)
        for axis, number in zip(driver.axes, driver.ids, strict=True)
    )
