"""What commanding a Spot needs besides a login: the robot's time, the lease of its body (the right
to command it), and our own e-stop endpoint.

Each method makes a few requests, and repeats none by itself.
"""

from __future__ import annotations

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

from . import protocol as p
from .messages import Message
from .session import ANSWER_S, NoAnswer, SentRequest, SpotSession

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
    """We have lost the lease of the body, the right to command it. The message names the new owner,
    if there is one."""

    def __init__(self, owner: str) -> None:
        super().__init__(f"the lease was taken over by {owner}" if owner else "we no longer have the lease")
        self.owner = owner


class RobotTime:
    """The robot's clock, estimated from the robot's answers. Every command with an end time needs
    it."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._skew_ns: int | None = None
        self.clock_identifier = ""
        self._synced_ns = self._attempted_ns = 0

    async def sync(self) -> None:
        """Exchange time stamps until the robot has estimated the difference of the clocks. Until
        then the previous estimate stays in force. Raise ``WireDown``."""
        self._attempted_ns = self._session.host_ns()
        previous: Message = {}
        clock = self.clock_identifier
        with trio.move_on_after(SYNC_S):
            while True:
                sent_ns = self._session.host_ns()
                body: Message = {"clock_identifier": clock} if clock else {}
                answer = await self._session.call("TimeSyncUpdate", {**body, **previous}, ANSWER_S)
                received_ns = self._session.host_ns()
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
                    "client_rx": p.stamp(received_ns),
                }
                previous = {"previous_round_trip": stamps}
                await trio.sleep(SAMPLE_S)
        raise WireDown(f"time sync: the robot's clock is not known after {SYNC_S:g} s. Check the robot")

    async def renew(self) -> None:
        """Synchronise the clocks again if that is due, which may take as long as the first ``sync``.
        A failure is ignored until the old estimate is too old. Then raise ``WireDown``."""
        now_ns = self._session.host_ns()
        age_s = (now_ns - self._synced_ns) / NS
        if now_ns - self._attempted_ns < SYNC_AGAIN_S * NS:
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
        """Return the robot's time ``seconds`` from now, in ns. Raise ``WireDown`` if the robot's
        clock is unknown."""
        if self._skew_ns is None:
            raise WireDown("time sync: the robot's clock is not known. Reconnect")
        return self._session.host_ns() + self._skew_ns + round(seconds * NS)


class BodyLease:
    """The lease of the robot's body: the right to command it. Each use of the lease has a higher
    number than the previous one. The robot therefore refuses a command that arrives late, after a
    stop."""

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
        """Return the lease for the next command, with its next use number. Raise ``LeaseLost`` if
        there is no lease."""
        if self._lease is None:
            raise LeaseLost(self._owner)
        self._uses += 1
        return p.newer_lease(self._lease, self._uses)

    async def acquire(self) -> None:
        """Take the lease (the right to command the body) if it is free, or if this machine already holds it from
        an earlier process.

        Raises:
            WireDown: Another client has the lease. The message names the client.
        """
        answer = await self._session.call("AcquireLease", {"resource": p.LEASE_RESOURCE})
        owner = answer.get("lease_owner", {}).get("client_name", "")
        if answer.get("status") == p.LEASE_CLAIMED and owner == self._session.client:
            answer = await self._session.call("TakeLease", {"resource": p.LEASE_RESOURCE})
        if answer.get("status") != p.OK or "lease" not in answer:
            lease_state = f"held by {owner}" if owner else f"not given (status {answer.get('status', 0)})"
            raise WireDown(f"lease: the body is {lease_state}. Let its owner return the lease, then resume()")
        self._lease, self._uses, self.was_taken, self._owner = answer["lease"], 0, False, ""

    async def retain(self) -> None:
        """Tell the robot that we still use the lease (the right to command the body). Raise ``LeaseLost`` or
        ``WireDown``."""
        if self._lease is not None:
            answer = await self._session.call("RetainLease", {"lease": p.newer_lease(self._lease, self._uses)})
            self.check(answer)

    def check(self, answer: Message) -> bool:
        """Read from an answer whether the robot accepted the lease (the right to command the body) in our request.

        Returns:
            True if the robot accepted the lease. False if a newer use of our lease has overtaken the request.

        Raises:
            LeaseLost: The lease is no longer ours.
        """
        use = answer.get("lease_use_result", {})
        status, owner = use.get("status", 0), use.get("owner", {}).get("client_name", "")
        if status in (p.LeaseUse.OK, p.LeaseUse.UNMANAGED):
            return True
        if status == p.LeaseUse.OLDER and owner == self._session.client:
            return False
        self._lease, self.was_taken, self._owner = None, True, owner
        raise LeaseLost(owner)

    async def give_back(self) -> str:
        """Give the lease (the right to command the body) back to the robot. Return the reason for a failure; empty
        after success, or if there is no lease. Raise ``WireDown``."""
        if self._lease is None:
            return ""
        lease, self._lease = self._lease, None
        answer = await self._session.call("ReturnLease", {"lease": lease})
        status = answer.get("status", 0)
        return "" if status == p.OK else f"the lease was not returned (status {status}): another client has it"


class EstopEndpoint:
    """Our endpoint of the robot's e-stop. It must check in regularly. When a check-in is late or
    requests a stop, the robot sits down and cuts its motors."""

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
        """Forget our e-stop endpoint, because the robot no longer knows it."""
        self._endpoint, self._challenge = {}, 0

    async def find(self) -> bool:
        """Look in the robot's e-stop configuration for an endpoint with our name. Return True if
        there is one. Raise ``WireDown``."""
        answer = await self._session.call("GetEstopConfig", {})
        try:
            self._endpoint = p.endpoint_of(answer, self._session.client)
        except MalformedFrame as malformed:
            raise WireDown(f"e-stop: {malformed}") from None
        return self.is_known

    async def set_up(self) -> None:
        """Make our endpoint the robot's only e-stop endpoint, and register it.

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
            reason = (
                "its motors are on" if answer.get("status") == _MOTORS_ON else f"status {answer.get('status', 0)}"
            )
            raise WireDown(
                f"e-stop: the robot refuses our endpoint ({reason}). Let its operator sit it down and power it off"
            )
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
            raise WireDown(
                f"e-stop: the robot did not register our endpoint (status {answer.get('status', 0)}). Try again"
            )
        self._endpoint, self._challenge = answer.get("new_endpoint", new), 0

    def send_check_in(self, level: p.StopLevel, permit: Permit | None = None) -> SentRequest:
        """Send a check-in that responds to the robot's newest challenge (a number), without waiting for the
        answer. Raise ``WireDown``."""
        if level is not p.StopLevel.NONE:
            # A stop stores its e-stop level even if this check-in cannot be sent: ``feed`` then sends no check-ins.
            self.level = level
        body = {
            "endpoint": self._endpoint,
            "challenge": self._challenge,
            "response": p.challenge_response(self._challenge),
            "stop_level": int(level),
        }
        request = self._session.ask("EstopCheckIn", body, permit)
        # A denied permit raises above, so it never sets a level that lets the motors be powered.
        self.level = level
        return request

    async def read_check_in(self, request: SentRequest, within_s: float = ANSWER_S) -> p.CheckIn | int:
        """Wait for the answer to a check-in. Store its challenge (a number to which the next check-in responds),
        and return its status. Raise ``WireDown``."""
        answer = await self._session.answer(request, within_s)
        self._challenge = answer.get("challenge", 0)
        status: int = answer.get("status", 0)
        return status

    async def check_in(self, level: p.StopLevel, permit: Permit | None = None) -> bool:
        """Check in with the robot's e-stop, and wait for the answer. Try once more if the challenge (a number from
        the robot to which the check-in responds) was out of date.

        Returns:
            True if the robot knows our endpoint.

        Raises:
            WireDown: The robot refuses the check-in, or does not answer.
        """
        status = await self.read_check_in(self.send_check_in(level, permit))
        if status == p.CheckIn.INCORRECT_CHALLENGE_RESPONSE:
            status = await self.read_check_in(self.send_check_in(level, permit))
        if status == p.CheckIn.ENDPOINT_UNKNOWN:
            self.forget()
            return False
        if status != p.CheckIn.OK:
            raise WireDown(f"e-stop: the robot answered a check-in with status {status}. Check the robot")
        return True

    async def read_back(self) -> str:
        """Read the e-stop back from the robot. Return why our endpoint does not protect the robot:
        a software e-stop is asserted, or the robot's timeout differs from ours. Empty if all is
        well. Raise ``WireDown``."""
        status = (await self._session.call("GetEstopSystemStatus", {})).get("status", {})
        ours = [endpoint.get("endpoint", {}) for endpoint in status.get("endpoints", ())]
        waits_s = [
            p.stamp_ns(endpoint.get("timeout", {})) / NS
            for endpoint in ours
            if endpoint.get("name") == self._session.client
        ]
        if not waits_s:
            return "our endpoint is not in force"
        if abs(waits_s[0] - self._timeout_s) > _ROUNDING_S:
            return f"our endpoint's timeout is {waits_s[0]:g} s, not {self._timeout_s:g}"
        return "" if status.get("stop_level") == p.StopLevel.NONE else "the robot's e-stop is asserted"


async def read_state(session: SpotSession, within_s: float = ANSWER_S) -> p.Reading:
    """Return the robot's present state. Raise ``WireDown``."""
    try:
        return p.reading(await session.call("GetRobotState", {}, within_s))
    except MalformedFrame as malformed:
        raise WireDown(f"robot state: {malformed}") from None


async def power_status(session: SpotSession, number: int) -> p.Power | int:
    """Return the progress of a power command. Raise ``WireDown``.

    A missing answer counts as "in progress", because ``SpotWire.read`` judges how long the robot
    may be silent.
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


async def see_it_report(session: SpotSession, within_s: float) -> None:
    """Wait until the robot reports a state that is newer than the first one read. Raise
    ``WireDown``."""
    with trio.move_on_after(within_s):
        first_ns = (await read_state(session)).stamp_ns
        while True:
            if (await read_state(session)).stamp_ns > first_ns:
                return
            await trio.sleep(SAMPLE_S)
    raise WireDown(f"robot state: the robot has reported nothing new for {within_s:g} s. Check the robot")


_MOTORS_ON = 4
_ROUNDING_S = 0.001
