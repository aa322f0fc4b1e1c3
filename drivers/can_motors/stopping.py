"""Bring an arm of CAN motors to rest without torque. The wire process and the stop channel use this code.

The first frames leave at once, and they depend on no reading: ``kp`` is 0, so no position is needed.

    damp          kd of the table, until the joints stand or ``DAMP_S`` have passed. The arm sinks slowly
    zero_torque   all gains 0, for ``ZERO_S``
    limp, off     nothing
    then, for all of them, each motor is disabled, until its answers show that it has no torque
"""

from __future__ import annotations

from contextlib import aclosing, suppress

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.kernel.clock import NS

from .link import Addressed, Link
from .protocol import TICKS_PER_S, Command, State

PERIOD_S = 0.005
DAMP_S = 2.0
"""Longest time of damping. The arm of a table then lies or hangs."""
DAMP_LEAST_S = 0.3
STANDING_RAD_S = 0.05
STANDING_S = 0.1
"""For so long all joints must be slower than ``STANDING_RAD_S``."""
ZERO_S = 0.1
CONFIRM_S = 0.5
"""Longest time until all motors have confirmed that they are disabled."""
TIMEOUT_S = 0.2
"""Time without a command after which a motor switches its torque off. The processes of the robot notice a fault
much earlier, and damp the arm. This is the last line: an arm without torque falls."""
MARKS = 1000
"""A stop makes the timeout longer by so many units of 50 us at most, to mark its answers."""


def first_frames(link: Link, safe_state: SafeState) -> list[Addressed]:
    """Return the frames that begin a stop, one for each motor."""
    match safe_state:
        case SafeState.LIMP | SafeState.OFF:
            return [(index, codec.disable()) for index, codec in enumerate(link.codecs)]
        case SafeState.ZERO_TORQUE:
            return link.command([Command()] * len(link.codecs))
        case _:
            return link.command(Command(kd=motor.damp_kd) for motor in link.motors)


async def bring_down(link: Link, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Bring the arm to a safe state in which it has no torque. Never raises.

    Any state that is not in the table above counts as ``damp``.
    """
    brakes = first_frames(link, safe_state)
    failures = link.send_stop(brakes, resync=True)
    if all(failures.values()):
        # No bus takes frames. The caller opens them anew, and must not wait.
        return tuple(
            MotorReport(motor.key, motor.id, False, False, False, failures[index])
            for index, motor in enumerate(link.motors)
        )
    if safe_state not in (SafeState.LIMP, SafeState.OFF):
        await _brake(link, brakes, ZERO_S if safe_state is SafeState.ZERO_TORQUE else DAMP_S)
    return await _disable(link, failures)


async def _brake(link: Link, frames: list[Addressed], longest_s: float) -> None:
    began_ns = moved_ns = link.clock.now_ns()
    async with aclosing(link.clock.ticks(PERIOD_S)) as ticks:
        async for now_ns in ticks:
            with suppress(WireDown):
                link.poll()
            standing = not link.silent(began_ns) and all(
                abs(feedback.velocity) <= STANDING_RAD_S or feedback.state is not State.ENABLED
                for feedback in link.feedback
            )
            moved_ns = moved_ns if standing else now_ns
            passed_s = (now_ns - began_ns) / NS
            if passed_s >= longest_s or (passed_s >= DAMP_LEAST_S and now_ns - moved_ns >= STANDING_S * NS):
                return
            link.send_stop(frames)


async def _disable(link: Link, written: dict[int, str]) -> tuple[MotorReport, ...]:
    """Disable every motor, and confirm it by an answer that no earlier answer can be taken for.

    The frames on the bus have no numbers. So after each disable the motor's timeout is set to a value that depends
    on the time, and is read back: a motor answers in order.
    """
    began_ns = link.clock.now_ns()
    mark = round(TIMEOUT_S * TICKS_PER_S) + began_ns // 1_000_000 % MARKS
    numbers = [codec.TIMEOUT for codec in link.codecs]
    for index, number in enumerate(numbers):
        link.parameters.pop((index, number), None)

    def energised(index: int) -> str:
        parameter = link.parameters.get((index, numbers[index]))
        if parameter is None or parameter.whole != mark:
            return "silent"
        return "still energised" if link.feedback[index].state is State.ENABLED else ""

    failures: dict[int, str] = {}
    async with aclosing(link.clock.ticks(PERIOD_S)) as ticks:
        async for now_ns in ticks:
            with suppress(WireDown):
                link.poll()
            waiting = [index for index in range(len(numbers)) if energised(index)]
            if not waiting or now_ns - began_ns > CONFIRM_S * NS:
                break
            failures |= link.send_stop(
                (index, frame)
                for index in waiting
                for codec, number in ((link.codecs[index], numbers[index]),)
                for frame in (codec.disable(), codec.write(number, mark), codec.read(number))
            )
    reports = []
    for index, motor in enumerate(link.motors):
        detail = energised(index)
        failure = failures.get(index, "") or written[index]
        is_written = not failures.get(index, "") or not written[index]
        answered = link.stamp_ns[index] > began_ns
        reports.append(
            MotorReport(motor.key, motor.id, is_written, answered, not detail, detail and (failure or detail))
        )
    return tuple(reports)
