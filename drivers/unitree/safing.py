"""Bring a robot to a safe state: send a command every 2 ms until the robot's own state shows no torque.

The wire process and the supervising process (root) both use this code.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import aclosing

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.clock import NS

from .gates import CONTROL_S
from .link import Link
from .robots import Model

DAMP_S = 0.5
AT_LEAST_S = 0.05
"""Commands without torque are sent for at least this time: 25 datagrams, which will not all be lost."""
AT_MOST_S = 0.5
"""Commands without torque are sent for at most this time. A robot that receives them reports no torque earlier."""
AFTER_S = 0.006
"""A state that arrives later than this after the first command was measured after that command."""


def no_holder() -> str:
    """Return an empty name. It is used where it is unknown whether another controller holds the robot."""
    return ""


async def bring_down(
    link: Link, safe_state: SafeState, held_by: Callable[[], str] = no_holder
) -> tuple[MotorReport, ...]:
    """Bring the robot to a safe state. Never raises. The first command is sent without waiting.

    Args:
        link: The connection to the robot.
        safe_state: ``DAMP`` brakes the joints first. Any other value means zero torque at once.
        held_by: Returns the name of another controller that holds the robot, or an empty text. A robot that is held
            by another controller ignores our commands, so torque in its joints is not caused by us.
    """
    damps = safe_state == SafeState.DAMP
    written = link.send_stop(link.safe_frame(damps))
    began_ns = zero_ns = link.clock.now_ns()
    if damps:
        zero_ns += round(DAMP_S * NS)
    async with aclosing(link.clock.ticks(CONTROL_S)) as ticks:
        async for now_ns in ticks:
            link.poll()
            written |= link.send_stop(link.safe_frame(now_ns < zero_ns))
            passed_s = (now_ns - zero_ns) / NS
            if passed_s > AT_MOST_S or (passed_s > AT_LEAST_S and (all(_obeys(link, zero_ns)) or held_by())):
                break
    if link.state_ns < began_ns:
        detail = "no new LowState has arrived" if link.matched else "the robot does not receive our commands"
        return reports(link.model, written, detail)
    obeys, holder = _obeys(link, zero_ns), held_by()
    if holder and not all(obeys):
        detail = f"held by the robot's own controller, {holder}"
        return tuple(MotorReport(joint.key, joint.slot, written, True, True, detail) for joint in link.model.joints)
    return tuple(
        MotorReport(joint.key, joint.slot, written, True, safe, "" if safe else "the motor still shows torque")
        for joint, safe in zip(link.model.joints, obeys, strict=True)
    )


def _obeys(link: Link, zero_ns: int) -> list[bool]:
    """Return True for each joint that has no torque, as shown by a state that was measured after ``zero_ns``.

    ``zero_ns`` is the time of the first command without torque.
    """
    state = link.state
    if state is None or link.state_ns < zero_ns + AFTER_S * NS:
        return [False] * len(link.model.joints)
    return [abs(nm) <= still_nm(joint.torque) for nm, joint in zip(state.tau, link.model.joints, strict=True)]


def still_nm(torque: float) -> float:
    """Return the measured torque (Nm) up to which a motor counts as free of torque. ``torque`` is the motor's
    largest torque. The limit is not zero, because the robot only estimates torques [assumed]."""
    return max(1.0, 0.05 * torque)


def reports(model: Model, written: bool, detail: str) -> tuple[MotorReport, ...]:
    """Return reports in which no motor is confirmed to be safe, with ``detail`` as the reason."""
    return tuple(MotorReport(joint.key, joint.slot, written, False, False, detail) for joint in model.joints)
