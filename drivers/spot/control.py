"""What it takes to command a Spot, beside a session: its time, the lease of its body, and an e-stop
endpoint of our own. Each method is one exchange, or a few; nothing is repeated by itself."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

from . import protocol as p
from .messages import Message
from .session import ANSWER_S, Asked, NoAnswer, SpotSession

SAMPLE_S = 0.01
"""Between two samples of the robot's time."""
SYNC_S = 5.0
"""Within which the robot's clock must be known."""
SYNC_AGAIN_S = 60.0
"""It is asked again so long after."""
SYNCED_S = 600.0
"""What is as old, and could not be asked again, is not relied on any more: two clocks that are
0.01 % apart are 0.06 s apart then [assumed]."""


class LeaseLost(Exception):
    """Somebody else has the body, or nobody. The text says who."""

    def __init__(self, owner: str) -> None:
        super().__init__(f"the lease was taken over by {owner}" if owner else "the lease is not ours any more")
        self.owner = owner


class RobotTime:
    """The robot's clock, as it told it. Without it no command has an end."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._skew_ns: int | None = None
        self.clock_identifier = ""
        self._synced_ns = self._asked_ns = 0

    async def sync(self) -> None:
        """Exchange stamps until the robot says that it is enough. Until then commands end by what
        was known before. Raise ``WireDown``."""
        self._asked_ns = self._session.host_ns()
        previous: Message = {}
        clock = self.clock_identifier
        with trio.move_on_after(SYNC_S):
            while True:
                sent_ns = self._session.host_ns()
                body: Message = {"clock_identifier": clock} if clock else {}
                told = await self._session.call("TimeSyncUpdate", {**body, **previous}, ANSWER_S)
                heard_ns = self._session.host_ns()
                clock = told.get("clock_identifier", "")
                state = told.get("state", {})
                if state.get("status") == p.OK and clock:
                    self._skew_ns = p.stamp_ns(state.get("best_estimate", {}).get("clock_skew", {}))
                    self.clock_identifier, self._synced_ns = clock, self._session.host_ns()
                    return
                header = told.get("header", {})
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
        """Ask again when that is due. It may take as long as the first time, and need not succeed at
        once. Raise ``WireDown`` when what is known is too old."""
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
        """Return the robot's time so many seconds from now. Raise ``WireDown`` when it is not
        known."""
        if self._skew_ns is None:
            raise WireDown("time sync: the robot's clock is not known. Reconnect")
        return self._session.host_ns() + self._skew_ns + round(seconds * NS)


class BodyLease:
    """The lease of the body. Each use is newer than the one before: what comes late, behind a stop,
    the robot refuses."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._lease: Message | None = None
        self._uses = 0
        self.was_taken = False
        """Whether we had it, and it was taken from us since, by somebody or by the robot."""
        self._owner = ""

    @property
    def is_held(self) -> bool:
        return self._lease is not None

    def use(self) -> Message:
        """Return the lease for the next command. Raise ``LeaseLost``."""
        if self._lease is None:
            raise LeaseLost(self._owner)
        self._uses += 1
        return p.newer_lease(self._lease, self._uses)

    async def acquire(self) -> None:
        """Take the lease that is free, or that an earlier process of ours had. Raise ``WireDown``,
        which names the owner."""
        told = await self._session.call("AcquireLease", {"resource": p.LEASE_RESOURCE})
        owner = told.get("lease_owner", {}).get("client_name", "")
        if told.get("status") == p.LEASE_CLAIMED and owner == self._session.client:
            told = await self._session.call("TakeLease", {"resource": p.LEASE_RESOURCE})
        if told.get("status") != p.OK or "lease" not in told:
            who = f"held by {owner}" if owner else f"not given (status {told.get('status', 0)})"
            raise WireDown(f"lease: the body is {who}. Let its owner return it, then resume()")
        self._lease, self._uses, self.was_taken, self._owner = told["lease"], 0, False, ""

    async def retain(self) -> None:
        """Say that we are still there. Raise ``LeaseLost``, ``WireDown``."""
        if self._lease is not None:
            told = await self._session.call("RetainLease", {"lease": p.newer_lease(self._lease, self._uses)})
            self.check(told)

    def check(self, told: Message) -> bool:
        """Return whether the robot took a request by its lease. False: it has seen a newer use of
        ours. Raise ``LeaseLost``: then the lease is ours no more."""
        use = told.get("lease_use_result", {})
        status, owner = use.get("status", 0), use.get("owner", {}).get("client_name", "")
        if status in (p.LeaseUse.OK, p.LeaseUse.UNMANAGED):
            return True
        if status == p.LeaseUse.OLDER and owner == self._session.client:
            return False
        self._lease, self.was_taken, self._owner = None, True, owner
        raise LeaseLost(owner)

    async def give_back(self) -> str:
        """Return the lease. Return why it was not; empty: it was, or there is none. Raise
        ``WireDown``."""
        if self._lease is None:
            return ""
        lease, self._lease = self._lease, None
        told = await self._session.call("ReturnLease", {"lease": lease})
        status = told.get("status", 0)
        return "" if status == p.OK else f"the lease was not returned (status {status}): it is another's"


class EstopEndpoint:
    """Our end of the robot's e-stop. The robot settles and cuts its motors when we do not check in
    in time, or say so."""

    def __init__(self, session: SpotSession, timeout_s: float) -> None:
        self._session = session
        self._timeout_s = timeout_s
        self._endpoint: Message = {}
        self._challenge = 0
        self.level = p.StopLevel.SETTLE_THEN_CUT
        """What we last meant. As long as it is not NONE nothing is fed."""

    @property
    def is_known(self) -> bool:
        return bool(self._endpoint)

    def forget(self) -> None:
        """The robot does not know it any more."""
        self._endpoint, self._challenge = {}, 0

    async def find(self) -> bool:
        """Look for an endpoint of our name in the robot's configuration; return whether there is
        one. Raise ``WireDown``."""
        told = await self._session.call("GetEstopConfig", {})
        try:
            self._endpoint = p.endpoint_of(told, self._session.client)
        except MalformedFrame as malformed:
            raise WireDown(f"e-stop: {malformed}") from None
        return self.is_known

    async def set_up(self) -> None:
        """Make our endpoint the robot's only one, and register it. With motors on the robot refuses.
        Raise ``WireDown``."""
        active = (await self._session.call("GetEstopConfig", {})).get("active_config", {})
        wanted = {
            "role": p.ESTOP_ROLE,
            "name": self._session.client,
            "timeout": p.duration(self._timeout_s),
        }
        told = await self._session.call(
            "SetEstopConfig", {"config": {"endpoints": [wanted]}, "target_config_id": active.get("unique_id", "")}
        )
        if told.get("status") != p.OK:
            why = "its motors are on" if told.get("status") == _MOTORS_ON else f"status {told.get('status', 0)}"
            raise WireDown(f"e-stop: no endpoint of ours ({why}). Let who drives it sit it down and power it off")
        config = told.get("active_config", {})
        new = next(iter(config.get("endpoints", ())), wanted)
        told = await self._session.call(
            "RegisterEstopEndpoint",
            {
                "target_endpoint": {"role": p.ESTOP_ROLE},
                "target_config_id": config.get("unique_id", ""),
                "new_endpoint": new,
            },
        )
        if told.get("status") != p.OK:
            raise WireDown(f"e-stop: our endpoint is not registered (status {told.get('status', 0)}). Try again")
        self._endpoint, self._challenge = told.get("new_endpoint", new), 0

    def say(self, level: p.StopLevel, permit: Permit | None = None) -> Asked:
        """Check in now, with the challenge that is known. Raise ``WireDown``."""
        if level is not p.StopLevel.NONE:
            self.level = level  # whether it leaves or not
        body = {
            "endpoint": self._endpoint,
            "challenge": self._challenge,
            "response": p.challenge_response(self._challenge),
            "stop_level": int(level),
        }
        asked = self._session.ask("EstopCheckIn", body, permit)
        self.level = level  # a permit that is denied lets nothing be powered
        return asked

    async def heard(self, asked: Asked, within_s: float = ANSWER_S) -> p.CheckIn | int:
        """Return what the robot says to a check-in, and keep its next challenge. Raise
        ``WireDown``."""
        told = await self._session.answer(asked, within_s)
        self._challenge = told.get("challenge", 0)
        status: int = told.get("status", 0)
        return status

    async def check_in(self, level: p.StopLevel, permit: Permit | None = None) -> bool:
        """Check in; once more when the challenge was not the last one. Return whether the robot
        knows the endpoint. Raise ``WireDown``."""
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
        """Return why the robot is held by an e-stop of software, or waits longer for us than it was
        told; empty: neither. Raise ``WireDown``."""
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
    """Return what the robot reports of itself. Raise ``WireDown``."""
    try:
        return p.reading(await session.call("GetRobotState", {}, within_s))
    except MalformedFrame as malformed:
        raise WireDown(f"robot state: {malformed}") from None


async def power_status(session: SpotSession, number: int) -> p.Power | int:
    """Return how far a power command is. Raise ``WireDown``. One answer that is missing is none of a
    command's: ``SpotWire.read`` judges how long the robot may be silent."""
    try:
        told = await session.call("PowerCommandFeedback", {"power_command_id": number})
    except NoAnswer:
        return p.Power.IN_PROGRESS
    status: int = told.get("status", 0)
    return status


async def is_standing(session: SpotSession, number: int) -> bool:
    """Return whether a command to stand has been carried out. Raise ``WireDown``, as
    ``power_status`` does."""
    try:
        told = await session.call("RobotCommandFeedback", {"robot_command_id": number})
    except NoAnswer:
        return False
    feedback = told.get("feedback", {}).get("synchronized_feedback", {}).get("mobility_command_feedback", {})
    status: int = feedback.get("stand_feedback", {}).get("status", 0)
    return status == p.OK


class FreshState:
    """Readings that are newer than the first one after an order: that may have been on its way."""

    def __init__(self, session: SpotSession) -> None:
        self._session = session
        self._since_ns: int | None = None

    async def read(self) -> p.Reading | None:
        """Return what the robot reports; None: nothing newer. Raise ``WireDown``."""
        reading = await read_state(self._session)
        if self._since_ns is None:
            self._since_ns = reading.stamp_ns
        return reading if reading.stamp_ns > self._since_ns else None


async def see_it_report(session: SpotSession, within_s: float) -> None:
    """Wait until what the robot reports is newer than what it reported first. Raise ``WireDown``."""
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
