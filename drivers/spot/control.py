"""The three things that commanding a Spot needs beside a session: the robot's time, the lease of its
body, and our own e-stop endpoint.

Each method does one or a few exchanges. It repeats nothing by itself.
"""

from __future__ import annotations

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

from . import protocol as p
from .messages import Message
from .session import ANSWER_S, Asked, NoAnswer, SpotSession

SAMPLE_S = 0.01
"""Pause between two samples of the robot's time."""
SYNC_S = 5.0
"""Longest time to learn the robot's clock."""
SYNC_AGAIN_S = 60.0
"""Period of learning it again."""
SYNCED_S = 600.0
"""Age at which an estimate that could not be renewed is no longer used. Two clocks that differ by
0.01 % are 0.06 s apart by then [assumed]."""


class LeaseLost(Exception):
    """Our lease of the body has ended. The text names the new owner, if there is one."""

    def __init__(self, owner: str) -> None:
        super().__init__(f"the lease was taken over by {owner}" if owner else "the lease is not ours any more")
        self.owner = owner


class RobotTime:
    """The robot's clock, as the robot reports it. Every command that ends by time needs it."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._skew_ns: int | None = None
        self.clock_identifier = ""
        self._synced_ns = self._asked_ns = 0

    async def sync(self) -> None:
        """Exchange time stamps until the robot has an estimate. Until then the previous estimate stays in
        force. Raise ``WireDown``."""
        self._asked_ns = self._session.host_ns()
        previous: Message = {}
        clock = self.clock_identifier
        with trio.move_on_after(SYNC_S):
            while True:
                sent_ns = self._session.host_ns()
                body: Message = {"clock_identifier": clock} if clock else {}
                answer = await self._session.call("TimeSyncUpdate", {**body, **previous}, ANSWER_S)
                heard_ns = self._session.host_ns()
                clock = answer.get("clock_identifier", "")
                state = answer.get("state", {})
                if state.get("status") == p.OK and clock:
                    self._skew_ns = p.stamp_ns(state.get("best_estimate", {}).get("clock_skew", {}))
                    self.clock_identifier, self._synced_ns = clock, self._session.host_ns()
                    return
                header = answer.get("header", {})
                stamps = {
                    "client_tx": p.stamp(sent_ns),
                    "server_rx": header.get("request_received_timestamp", {}),
                    "server_tx": header.get("response_timestamp", {}),
                    "client_rx": p.stamp(heard_ns),
                }
                previous = {"previous_round_trip": stamps}
                await trio.sleep(SAMPLE_S)
        raise WireDown(f"time sync: the robot's clock is not known after {SYNC_S:g} s. Check the robot")

    async def renew(self) -> None:
        """Synchronise again if that is due. This may take as long as the first time, and may fail for a
        while. Raise ``WireDown`` when the estimate is too old."""
        now_ns = self._session.host_ns()
        age_s = (now_ns - self._synced_ns) / NS
        if now_ns - self._asked_ns < SYNC_AGAIN_S * NS:
            return
        try:
            await self.sync()
        except WireDown:
            if age_s >= SYNCED_S:
                raise

    @property
    def skew_s(self) -> float:
        return (self._skew_ns or 0) / NS

    def in_ns(self, seconds: float) -> int:
        """Return the robot's time so many seconds from now. Raise ``WireDown`` if it is unknown."""
        if self._skew_ns is None:
            raise WireDown("time sync: the robot's clock is not known. Reconnect")
        return self._session.host_ns() + self._skew_ns + round(seconds * NS)


class BodyLease:
    """The lease of the body. Each use is newer than the previous one, so that the robot refuses a command
    that arrives late, after a stop."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._lease: Message | None = None
        self._uses = 0
        self.was_taken = False
        """True if we had the lease and it was taken from us, by a client or by the robot."""
        self._owner = ""

    @property
    def is_held(self) -> bool:
        return self._lease is not None

    def use(self) -> Message:
        """Return the lease for the next command. Raise ``LeaseLost`` without one."""
        if self._lease is None:
            raise LeaseLost(self._owner)
        self._uses += 1
        return p.newer_lease(self._lease, self._uses)

    async def acquire(self) -> None:
        """Take the lease if it is free or an earlier process of ours has it.

        Raises:
            WireDown: Another client has it. The text names the owner.
        """
        answer = await self._session.call("AcquireLease", {"resource": p.LEASE_RESOURCE})
        owner = answer.get("lease_owner", {}).get("client_name", "")
        if answer.get("status") == p.LEASE_CLAIMED and owner == self._session.client:
            answer = await self._session.call("TakeLease", {"resource": p.LEASE_RESOURCE})
        if answer.get("status") != p.OK or "lease" not in answer:
            who = f"held by {owner}" if owner else f"not given (status {answer.get('status', 0)})"
            raise WireDown(f"lease: the body is {who}. Let its owner return it, then resume()")
        self._lease, self._uses, self.was_taken, self._owner = answer["lease"], 0, False, ""

    async def retain(self) -> None:
        """Show that the lease is in use. Raise ``LeaseLost`` or ``WireDown``."""
        if self._lease is not None:
            answer = await self._session.call("RetainLease", {"lease": p.newer_lease(self._lease, self._uses)})
            self.check(answer)

    def check(self, told: Message) -> bool:
        """Check an answer for the result of its lease.

        Returns:
            True if the robot accepted the lease. False if it has seen a newer use of ours.

        Raises:
            LeaseLost: The lease is no longer ours.
        """
        use = told.get("lease_use_result", {})
        status, owner = use.get("status", 0), use.get("owner", {}).get("client_name", "")
        if status in (p.LeaseUse.OK, p.LeaseUse.UNMANAGED):
            return True
        if status == p.LeaseUse.OLDER and owner == self._session.client:
            return False
        self._lease, self.was_taken, self._owner = None, True, owner
        raise LeaseLost(owner)

    async def give_back(self) -> str:
        """Return the lease to the robot. The result says why that failed; empty if it did not, or if there
        is no lease. Raise ``WireDown``."""
        if self._lease is None:
            return ""
        lease, self._lease = self._lease, None
        answer = await self._session.call("ReturnLease", {"lease": lease})
        status = answer.get("status", 0)
        return "" if status == p.OK else f"the lease was not returned (status {status}): it is another's"


class EstopEndpoint:
    """Our endpoint of the robot's e-stop. The robot settles and cuts its motors when a check-in is late or
    asks for that."""

    def __init__(self, session: SpotSession, timeout_s: float) -> None:
        self._session = session
        self._timeout_s = timeout_s
        self._endpoint: Message = {}
        self._challenge = 0
        self.level = p.StopLevel.SETTLE_THEN_CUT
        """The level of our last check-in. Unless it is NONE, ``feed`` sends no check-ins."""

    @property
    def is_known(self) -> bool:
        return bool(self._endpoint)

    def forget(self) -> None:
        """Drop the endpoint, because the robot no longer knows it."""
        self._endpoint, self._challenge = {}, 0

    async def find(self) -> bool:
        """Look for an endpoint of our name in the robot's configuration. Return True if there is one.
        Raise ``WireDown``."""
        answer = await self._session.call("GetEstopConfig", {})
        try:
            self._endpoint = p.endpoint_of(answer, self._session.client)
        except MalformedFrame as malformed:
            raise WireDown(f"e-stop: {malformed}") from None
        return self.is_known

    async def set_up(self) -> None:
        """Make our endpoint the robot's only one, and register it.

        Raises:
            WireDown: A call failed, or the robot refuses because its motors are on.
        """
        active = (await self._session.call("GetEstopConfig", {})).get("active_config", {})
        requested = {
            "role": p.ESTOP_ROLE,
            "name": self._session.client,
            "timeout": p.duration(self._timeout_s),
        }
        answer = await self._session.call(
            "SetEstopConfig",
            {"config": {"endpoints": [requested]}, "target_config_id": active.get("unique_id", "")},
        )
        if answer.get("status") != p.OK:
            why = "its motors are on" if answer.get("status") == _MOTORS_ON else f"status {answer.get('status', 0)}"
            raise WireDown(f"e-stop: no endpoint of ours ({why}). Let who drives it sit it down and power it off")
        config = answer.get("active_config", {})
        new = next(iter(config.get("endpoints", ())), requested)
        answer = await self._session.call(
            "RegisterEstopEndpoint",
            {
                "target_endpoint": {"role": p.ESTOP_ROLE},
                "target_config_id": config.get("unique_id", ""),
                "new_endpoint": new,
            },
        )
        if answer.get("status") != p.OK:
            raise WireDown(f"e-stop: our endpoint is not registered (status {answer.get('status', 0)}). Try again")
        self._endpoint, self._challenge = answer.get("new_endpoint", new), 0

    def say(self, level: p.StopLevel, permit: Permit | None = None) -> Asked:
        """Send a check-in now, with the newest challenge. Raise ``WireDown``."""
        if level is not p.StopLevel.NONE:
            self.level = level  # A stop sets the level even if the check-in does not leave.
        body = {
            "endpoint": self._endpoint,
            "challenge": self._challenge,
            "response": p.challenge_response(self._challenge),
            "stop_level": int(level),
        }
        asked = self._session.ask("EstopCheckIn", body, permit)
        self.level = level  # A denied permit does not get here, so it lets nothing be powered.
        return asked

    async def heard(self, asked: Asked, within_s: float = ANSWER_S) -> p.CheckIn | int:
        """Return the robot's status for a check-in, and keep its next challenge. Raise ``WireDown``."""
        answer = await self._session.answer(asked, within_s)
        self._challenge = answer.get("challenge", 0)
        status: int = answer.get("status", 0)
        return status

    async def check_in(self, level: p.StopLevel, permit: Permit | None = None) -> bool:
        """Check in, and once more if the challenge was not the newest one.

        Returns:
            True if the robot knows the endpoint.

        Raises:
            WireDown: The robot refuses the check-in, or does not answer.
        """
        status = await self.heard(self.say(level, permit))
        if status == p.CheckIn.INCORRECT_CHALLENGE_RESPONSE:
            status = await self.heard(self.say(level, permit))
        if status == p.CheckIn.ENDPOINT_UNKNOWN:
            self.forget()
            return False
        if status != p.CheckIn.OK:
            raise WireDown(f"e-stop: a check-in is answered with status {status}. Check the robot")
        return True

    async def read_back(self) -> str:
        """Return why our endpoint does not keep the robot safe: a software e-stop is asserted, or the
        robot's timeout differs from ours. Empty if all is well. Raise ``WireDown``."""
        status = (await self._session.call("GetEstopSystemStatus", {})).get("status", {})
        ours = [one.get("endpoint", {}) for one in status.get("endpoints", ())]
        waits_s = [
            p.stamp_ns(one.get("timeout", {})) / NS for one in ours if one.get("name") == self._session.client
        ]
        if not waits_s:
            return "our endpoint is not in force"
        if abs(waits_s[0] - self._timeout_s) > _ROUNDING_S:
            return f"our endpoint waits {waits_s[0]:g} s, not {self._timeout_s:g}"
        return "" if status.get("stop_level") == p.StopLevel.NONE else "its e-stop is asserted"


async def read_state(session: SpotSession, within_s: float = ANSWER_S) -> p.Reading:
    """Return the robot's present state. Raise ``WireDown``."""
    try:
        return p.reading(await session.call("GetRobotState", {}, within_s))
    except MalformedFrame as malformed:
        raise WireDown(f"robot state: {malformed}") from None


async def power_status(session: SpotSession, number: int) -> p.Power | int:
    """Return the progress of a power command. Raise ``WireDown``.

    A missing answer counts as progress: ``SpotWire.read`` judges how long the robot may be silent.
    """
    try:
        answer = await session.call("PowerCommandFeedback", {"power_command_id": number})
    except NoAnswer:
        return p.Power.IN_PROGRESS
    status: int = answer.get("status", 0)
    return status


async def is_standing(session: SpotSession, number: int) -> bool:
    """Return True if a command to stand has been carried out. A missing answer counts as False. Raise
    ``WireDown``."""
    try:
        answer = await session.call("RobotCommandFeedback", {"robot_command_id": number})
    except NoAnswer:
        return False
    feedback = answer.get("feedback", {}).get("synchronized_feedback", {}).get("mobility_command_feedback", {})
    status: int = feedback.get("stand_feedback", {}).get("status", 0)
    return status == p.OK


class FreshState:
    """Readings after a command. The first one does not count, since it may have been on its way before."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._since_ns: int | None = None

    async def read(self) -> p.Reading | None:
        """Return a reading; None if it is not newer than the first one. Raise ``WireDown``."""
        reading = await read_state(self._session)
        if self._since_ns is None:
            self._since_ns = reading.stamp_ns
        return reading if reading.stamp_ns > self._since_ns else None


async def see_it_report(session: SpotSession, within_s: float) -> None:
    """Wait until a reading is newer than the first one. Raise ``WireDown``."""
    fresh = FreshState(session)
    with trio.move_on_after(within_s):
        while True:
            if await fresh.read() is not None:
                return
            await trio.sleep(SAMPLE_S)
    raise WireDown(f"robot state: what it reports stands still for {within_s:g} s. Check the robot")


NOTHING_SINCE = "not confirmed: it has reported nothing since"
_MOTORS_ON = 4
_ROUNDING_S = 0.001
