"""Bring an arm of CAN motors to rest without torque. The wire process and the stop channel use this code.

The first frames leave at once, and they depend on no reading: ``kp`` is 0, so no position is needed.

    damp          kd of the table, until the joints stand or ``DAMP_S`` have passed. The arm sinks slowly
    zero_torque   all gains 0, for ``ZERO_S``
    limp, off     nothing
    then, for all of them, each motor is disabled, until its feedback shows that it has no torque
"""

from __future__ import annotations

from contextlib import aclosing, suppress

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.kernel.clock import NS

from .link import Addressed, Link
from .protocol import Command, State

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
AFTER_S = 0.001
"""Feedback that arrives later than this after the first frame answers that frame or a later one [assumed]."""


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
    began_ns = link.clock.now_ns()
    frames = [(index, codec.disable()) for index, codec in enumerate(link.codecs)]
    failures: dict[int, str] = {}
    async with aclosing(link.clock.ticks(PERIOD_S)) as ticks:
        async for now_ns in ticks:
            with suppress(WireDown):
                link.poll()
            waiting = [index for index in range(len(frames)) if _energised(link, index, began_ns)]
            if (not waiting and now_ns > began_ns) or now_ns - began_ns > CONFIRM_S * NS:
                break
            failures |= link.send_stop([frames[index] for index in waiting] or frames)
    reports = []
    for index, motor in enumerate(link.motors):
        detail = _energised(link, index, began_ns)
        failure = failures.get(index, "") or written.get(index, "")
        reports.append(
            MotorReport(
                motor.key,
                motor.id,
                not failure or not written.get(index, ""),
                link.stamp_ns[index] > began_ns,
                not detail,
                failure or detail if detail else "",
            )
        )
    return tuple(reports)


def _energised(link: Link, index: int, since_ns: int) -> str:
    """Return why a motor may have torque; empty if its feedback since a time shows that it has none."""
    if link.stamp_ns[index] < since_ns + AFTER_S * NS:
        return "silent"
    return "still energised" if link.feedback[index].state is State.ENABLED else ""
