"""Stop a Spot without the lease, by our e-stop endpoint (our registration at the robot's e-stop, which lets us
assert it). The process that drives the robot and the supervising process (root) use this code.

The robot sits down and then cuts its motors, or cuts them at once.
"""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch
from strands_actors.drivers.common.kit.stop_steps import repeat_until_safe

from . import protocol as p
from .control import EstopEndpoint, read_state
from .session import SpotSession

LOOK_S = 0.02
"""Period of reading the robot's state."""

SERVICES = ("estop", "robot-state")
"""The services that a stop needs."""


def level_of(safe_state: SafeState) -> p.StopLevel:
    """Return the e-stop level that leads to a safe state. No e-stop level lets the robot stand:
    standing needs a lease."""
    return p.StopLevel.CUT if safe_state == SafeState.OFF else p.StopLevel.SETTLE_THEN_CUT


async def stop_by_estop(
    session: SpotSession, endpoint: EstopEndpoint, safe_state: SafeState, within_s: float
) -> Outcome:
    """Assert the e-stop, and read the robot's state until its motors are off. Never raises.

    If our endpoint is known and connected, the first message is sent before anything is waited for.

    Args:
        session: A session with the robot.
        endpoint: Our e-stop endpoint; it is looked up if it is not known.
        safe_state: ``off`` cuts the motors at once. All others let the robot sit first.
        within_s: Longest duration, seconds.
    """
    return await repeat_until_safe(_EstopSteps(session, endpoint, level_of(safe_state)), within_s, LOOK_S)


class _EstopSteps:
    """One stop by our e-stop endpoint (``StopSteps``)."""

    def __init__(self, session: SpotSession, endpoint: EstopEndpoint, level: p.StopLevel) -> None:
        self._session = session
        self._endpoint = endpoint
        self._level = level
        self.written = False
        self.acknowledged = False
        self.is_foreign = False
        self._watch = RestWatch()

    async def step(self) -> str:
        """Assert the e-stop until the robot has accepted it, then read the state."""
        if not self.acknowledged:
            detail = await self._assert()
            if detail:
                return detail
        detail = await confirm_off(self._session, self._watch)
        if not detail or not self.is_foreign:
            return detail
        owner = p.body_owner(await self._session.call("ListLeases", {}))
        if owner not in ("", self._session.client):
            # The client that now has the lease drives the robot. The robot accepts no command of ours.
            return ""
        return f"{detail}, and another client has configured the e-stop"

    async def _assert(self) -> str:
        if not self._endpoint.is_known and not await self._endpoint.find():
            # Another client has configured the e-stop while the motors were off. Our lease may have moved the
            # robot since then.
            self.is_foreign = self.acknowledged = True
            return ""
        request = self._endpoint.send_check_in(self._level)
        self.written = True
        status = await self._endpoint.read_check_in(request)
        if status == p.CheckIn.INCORRECT_CHALLENGE_RESPONSE:
            status = await self._endpoint.read_check_in(self._endpoint.send_check_in(self._level))
        if status == p.CheckIn.OK:
            self.acknowledged = True
            return ""
        if status == p.CheckIn.ENDPOINT_UNKNOWN:
            self._endpoint.forget()
        return f"not confirmed: the robot answered a check-in with status {status}"


async def confirm_off(session: SpotSession, watch: RestWatch) -> str:
    """Read the robot's state. Return why the motors are not known to be off; empty if they are off. Raise
    ``WireDown``."""
    reading = await read_state(session)
    if reading.motors is p.Motors.OFF:
        return confirm(watch, reading, "")
    return confirm(watch, reading, f"not confirmed: the motors are {p.name_of(p.Motors, reading.motors)}")


def confirm(watch: RestWatch, reading: p.Reading, reason: str) -> str:
    """Process a reading that was requested after a command to stop.

    Args:
        watch: The readings since the command.
        reading: The present reading.
        reason: Why the reading does not show the safe state; empty if it does.

    Returns:
        Why the safe state is not confirmed; empty if it is.
    """
    watch.report(reading.stamp_ns, [0] if reason else [])
    if watch.rest is Rest.RESTS:
        return ""
    if watch.rest is Rest.MOVES and reason:
        return reason
    return f"not confirmed: {Rest.NOTHING_SINCE.value}"
