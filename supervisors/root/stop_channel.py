"""Stop a robot without its wire process: one attempt, and the pauses between attempts.

The guardian uses this after it has killed the wire process, and the standby when root and wire have ended. A wire
process without a root uses it when its own gate and transport do not reply. An attempt that is not confirmed is
repeated, since a cable may be plugged in again, and a servo may receive the next frame.
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
from strands_actors.supervisors.page import SafetyPage

AGAIN_S = (0.1, 0.5, 1.0, 2.0)
"""Pauses between attempts; the last one is repeated."""
REPEAT_S = 2.0
"""How long the guardian tries before it starts the next wire, which then continues. Only one process
can open a serial port, and the wire can name the motor that is missing."""
LINGER_S = 60.0
"""How long the last process of a tree keeps trying to stop a robot that is not confirmed safe."""
UNSETTLED = "an arming or service that was cut off may still take effect"


async def serve(path: StopChannel, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
    """Resolve the host names that a stop channel connects to, then run it. Raise ``WireDown`` if that fails."""
    for host in path.hosts:
        try:
            await look_up(host, 0)
        except (OSError, UnicodeError) as error:
            raise WireDown(f"{host}: there is no such host ({error}). Check port=") from None
    await path.serve(task_status)


async def attempt(path: StopChannel, driver: Driver, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Stop the robot by a stop channel. Never raises.

    Args:
        path: The stop channel, the way to the hardware without the wire process.
        driver: The driver of the robot.
        safe_state: The safe state to write.

    Returns:
        A report for each motor. If the channel fails, no motor counts as reached.
    """
    within_s = StopDeadlines.of(driver.timing.safe_s).attempt_s
    try:
        with RESERVE.freed(), trio.fail_after(within_s):
            return await path.make_safe(safe_state)
    except trio.TooSlowError:
        reason = f"no end within {within_s:g} s"
    except Exception as error:  # a driver may fail in any way, and there will be another attempt
        reason = describe(error)
    return not_reached(driver, reason)


async def attempt_anew(
    driver: Driver, clock: Clock, safe_state: SafeState, descriptors: Sequence[int] = ()
) -> tuple[MotorReport, ...]:
    """Stop the robot as ``attempt`` does, but with a new stop channel. ``descriptors`` are those that a wire
    process has handed over."""
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
    """Run a stop channel until it fails. ``ready`` is set when the channel can stop the robot, or has failed."""
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(path.serve)
            ready.set()
    except* WireDown:
        ready.set()


async def settled(
    safety_page: SafetyPage, clock: Clock, make_safe: Callable[[], Awaitable[tuple[MotorReport, ...]]]
) -> tuple[MotorReport, ...]:
    """Stop the robot again and again, until no earlier request can take effect any more.

    An arming that was cut off may energise the robot after a stop. So the safe state is written at once.
    When ``SafetyPage.unsettled_s`` has passed, it is written and read back again. Only the last report counts.

    Args:
        safety_page: The page on which the wire process notes its requests.
        make_safe: One attempt.

    Returns:
        The reports of the last attempt. If a motor is not safe, no further attempt is made, since the caller
        repeats this anyway. If a request of a wire process is still running, no motor is reported as safe.
    """
    while True:
        unsettled_s = safety_page.unsettled_s(clock.now_ns())
        motors = await make_safe()
        if not unsettled_s or not none_unsafe(motors):
            return motors
        if safety_page.is_asking:
            return not_settled(motors)
        await trio.sleep(min(unsettled_s, AGAIN_S[0]))


def not_settled(motors: Sequence[MotorReport]) -> tuple[MotorReport, ...]:
    """Return the reports with every motor as unconfirmed, because an earlier request may still take effect."""
    return tuple(msgspec.structs.replace(motor, safe=False, detail=UNSETTLED) for motor in motors)


def pauses_s() -> Iterator[float]:
    """Yield the pause before each further attempt, in seconds."""
    yield from AGAIN_S
    while True:
        yield AGAIN_S[-1]


def none_unsafe(motors: Sequence[MotorReport]) -> bool:
    """Return True if no motor is reported as unsafe. The report of a stop that was not attempted has no motors, so
    it does not count as a failure. ``contract.wire.all_safe`` decides whether a stop is confirmed."""
    return all(motor.safe for motor in motors)


def not_reached(driver: Driver, reason: str) -> tuple[MotorReport, ...]:
    return tuple(
        MotorReport(axis, number, False, False, False, reason)
        for axis, number in zip(driver.axes, driver.ids, strict=True)
    )
