"""Stop a Spot without its lease, by our e-stop endpoint. The wire and the stop channel use this.

The robot sits down and then cuts its motors, or cuts them at once.
"""

from __future__ import annotations

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.outcome import Outcome

from . import protocol as p
from .control import NOTHING_SINCE, EstopEndpoint, FreshState
from .session import SpotSession

LOOK_S = 0.02
"""Period of reading the robot's state."""

SERVICES = ("estop", "robot-state")
"""The services that a stop needs."""


def level_of(safe_state: SafeState) -> p.StopLevel:
    """Return the e-stop level for a safe state. No level lets the robot stand: that takes a lease."""
    return p.StopLevel.CUT if safe_state == SafeState.OFF else p.StopLevel.SETTLE_THEN_CUT


async def stop_by_estop(
    session: SpotSession, endpoint: EstopEndpoint, safe_state: SafeState, within_s: float
) -> Outcome:
    """Assert the e-stop, and read the robot's state until its motors are off. Never raises.

    If our endpoint is known and connected, the first frame leaves before the first wait.

    Args:
        session: A session with the robot.
        endpoint: Our e-stop endpoint; it is looked up if it is not known.
        safe_state: ``off`` cuts the motors at once. All others let the robot sit first.
        within_s: Longest duration, seconds.
    """
    stop = _Stop(session, endpoint, level_of(safe_state))
    detail = "silent"
    with trio.move_on_after(within_s):
        while True:
            try:
                detail = await stop.step()
                if not detail:
                    return Outcome(stop.written, stop.acknowledged, "")
            except WireDown as down:
                detail = f"not confirmed: {down}"
            await trio.sleep(LOOK_S)
    return Outcome(stop.written, stop.acknowledged, detail)


class _Stop:
    def __init__(self, session: SpotSession, endpoint: EstopEndpoint, level: p.StopLevel) -> None:
        self._session = session
        self._endpoint = endpoint
        self._level = level
        self.written = False
        self.acknowledged = False
        self.is_anothers = False
        self._fresh = FreshState(session)

    async def step(self) -> str:
        """Assert the e-stop until the robot has accepted it, then read the state.

        Returns:
            Why the robot is not safe yet; empty if it is.

        Raises:
            WireDown: A call failed.
        """
        if not self.acknowledged:
            detail = await self._assert()
            if detail:
                return detail
        detail = reason_not_off(await self._fresh.read())
        if not detail or not self.is_anothers:
            return detail
        owner = p.body_owner(await self._session.call("ListLeases", {}))
        if owner not in ("", self._session.client):
            return ""  # That client drives the robot, which accepts no more of our commands.
        return f"{detail}, and its e-stop is another's"

    async def _assert(self) -> str:
        if not self._endpoint.is_known and not await self._endpoint.find():
            # Another client configured the e-stop anew, while motors were off. Our lease may have
            # moved the robot since then.
            self.is_anothers = self.acknowledged = True
            return ""
        asked = self._endpoint.say(self._level)
        self.written = True
        status = await self._endpoint.heard(asked)
        if status == p.CheckIn.INCORRECT_CHALLENGE_RESPONSE:
            status = await self._endpoint.heard(self._endpoint.say(self._level))
        if status == p.CheckIn.OK:
            self.acknowledged = True
            return ""
        if status == p.CheckIn.ENDPOINT_UNKNOWN:
            self._endpoint.forget()
        return f"not confirmed: a check-in is answered with status {status}"


def reason_not_off(reading: p.Reading | None) -> str:
    """Return why the motors are not known to be off; empty if they are off.

    Args:
        reading: A reading; None if nothing was reported since the command.
    """
    if reading is None:
        return NOTHING_SINCE
    if reading.motors is p.Motors.OFF:
        return ""
    return f"not confirmed: its motors are {p.name_of(p.Motors, reading.motors)}"
