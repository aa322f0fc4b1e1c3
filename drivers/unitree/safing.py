"""Bring a robot down: send frames every 2 ms until its own state shows no torque. The wire and the root
both stop it in this way."""

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
"""Shortest time of sending frames without torque. One datagram may be lost, but not twenty-five."""
AT_MOST_S = 0.5
"""Longest time. A robot that receives the frames has shown by then that it obeys."""
AFTER_S = 0.006
"""Delay after the first frame. A state that arrives later was measured after that frame."""


def no_holder() -> str:
    """Return no holder. For a caller that cannot know what else controls the robot."""
    return ""


async def bring_down(
    link: Link, safe_state: SafeState, held_by: Callable[[], str] = no_holder
) -> tuple[MotorReport, ...]:
    """Bring the robot to a safe state. Never raises. The first frame leaves before the first wait.

    Args:
        link: The link to the robot.
        safe_state: ``DAMP``, or zero torque for all others.
        held_by: Returns what controls the robot instead of us; empty for nothing. Such a robot ignores our
            commands, so its torque does not come from them.
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
        detail = "no new LowState came" if link.heard else "the robot does not hear us"
        return reports(link.model, written, detail)
    obeys, holder = _obeys(link, zero_ns), held_by()
    if holder and not all(obeys):
        detail = f"held by the robot's own controller, {holder}"
        return tuple(MotorReport(joint.key, joint.slot, written, True, True, detail) for joint in link.model.joints)
    return tuple(
        MotorReport(joint.key, joint.slot, written, True, safe, "" if safe else "it still shows torque")
        for joint, safe in zip(link.model.joints, obeys, strict=True)
    )


def _obeys(link: Link, zero_ns: int) -> list[bool]:
    """Return for each joint whether a state that was measured after the first frame without torque shows
    no torque."""
    state = link.state
    if state is None or link.state_ns < zero_ns + AFTER_S * NS:
        return [False] * len(link.model.joints)
    return [abs(nm) <= still_nm(joint.torque) for nm, joint in zip(state.tau, link.model.joints, strict=True)]


def still_nm(torque: float) -> float:
    """Return the torque that an estimate may still show for a motor without torque [assumed]."""
    return max(1.0, 0.05 * torque)


def reports(model: Model, written: bool, said: str) -> tuple[MotorReport, ...]:
    """Return reports in which no motor has confirmed."""
    return tuple(MotorReport(joint.key, joint.slot, written, False, False, said) for joint in model.joints)
