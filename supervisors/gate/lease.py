"""The right to write, and how long what was written with it may stand.

There are two leases at most: a policy writes under its caller's. When it gives its own back, the
robot is held before the answer is given: that is what ``stop_task()`` waits for.
"""

from __future__ import annotations

from hashlib import blake2b

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.gate.messages import LEASE_TTL_S, MAX_LIFETIME_S, Acquire, Beat, Writing

LEASE_TTL_NS = round(LEASE_TTL_S * NS)
_PROOF_BITS = 32
"""So many guesses would take weeks at the rate that is let through."""
_MAX_LIFETIME_NS = round(MAX_LIFETIME_S * NS)


class Held(msgspec.Struct):
    """The lease, and how long it has been beaten for. ``under`` is the lease of the caller it
    writes for."""

    id: int
    holder: str
    expires_ns: int  # unless its process is heard of
    latches_until_ns: int  # unless the thread that commands answers: a latched target lives no longer
    pid: int  # of its process; 0: of another host
    channel: str  # over which it was acquired, and over which alone it counts
    under: Held | None = None
    instruction: str = ""
    began_ns: int = 0
    steps: int = 0  # setpoints that were accepted under it
    told: str = ""  # for the audit: how its setpoints were decided last
    refused: Refused | None = None  # what nobody waited to hear: the stream is over, and who asks next hears why

    @property
    def owner(self) -> Held:
        return self.under or self

    def beat(self, until_ns: int, answered_ago_s: float = 0.0) -> None:
        self.expires_ns = until_ns
        if answered_ago_s >= 0.0:
            self.latches_until_ns = max(self.latches_until_ns, until_ns - round(answered_ago_s * NS))


class Leases(msgspec.Struct):
    """Who may write. ``given``: so many so far, which numbers them; ``ended``: the newest when it
    was last stopped: a rollout of before begins no more. ``secret``: a lease's number alone could
    be guessed, and who knows a lease may write by it."""

    given: int
    held: Held | None = None
    ended: int = 0
    secret: bytes = b""

    def acquire(self, message: Acquire, now_ns: int, holding: bool = False) -> int | Refused:
        """Return the number of a new lease. Who has a channel with a name (a policy process) gets
        one under its caller's only. Who has it and says which it is may have another in its place.
        ``holding``: nothing of the present writer stands any more. Who has lent its lease to a
        rollout may then have it back, though that rollout (cut off, perhaps) has not returned
        it."""
        if message.channel and not message.over:
            why = f"{message.channel} may write under its caller's lease alone"
            return Refused(Code.CHANNEL, why, "name that lease")
        if 0 < message.over >> _PROOF_BITS <= self.ended:
            return Refused(Code.STOPPED, "the robot was stopped since the rollout began", "start it again")
        held = self.held
        under: Held | None = None
        if held is not None and held.owner.expires_ns > now_ns:
            if held.id == message.over and not held.channel:
                under = held.owner
            elif _is_asked_again(held, message):
                under = held.under
            elif not _is_its_own(held.owner if holding else held, message):
                why = f"{held.holder} holds the lease"
                return Refused(Code.LEASE, why, "wait until it is released, or stop it")
        elif message.over:
            return Refused(Code.LEASE, "the lease to write under has lapsed", "acquire it again")
        self.given += 1
        until_ns = now_ns + LEASE_TTL_NS
        lease = self.given << _PROOF_BITS | self._proof(self.given)
        self.held = Held(
            lease,
            message.holder,
            until_ns,
            until_ns,
            message.pid,
            message.channel,
            under,
            message.instruction,
            began_ns=now_ns,
        )
        return lease

    def _proof(self, number: int) -> int:
        """Return what goes with a number, for who knows the secret; the same when this is played
        again."""
        digest = blake2b(str(number).encode(), key=self.secret, digest_size=_PROOF_BITS // 8).digest()
        return int.from_bytes(digest, "big") if self.secret else 0

    def beat(self, message: Beat, now_ns: int) -> None:
        held = self.held
        while held is not None:
            if (held.id, held.channel) == (message.lease, message.channel):
                held.beat(now_ns + LEASE_TTL_NS, message.answered_ago_s)
            held = held.under

    def find(self, lease: int, channel: str) -> Held | None:
        """Return the lease that is held, if it is this one, and was acquired over that channel."""
        held = self.held
        return held if held is not None and (held.id, held.channel) == (lease, channel) else None

    def release(self, lease: int, channel: str) -> Held | None:
        """Return the one that was given back; None: it was not held."""
        held = self.find(lease, channel)
        if held is not None:
            self.held = held.under
        return held

    def stop(self) -> None:
        """A stop ends the rollout; a dead policy could not release its lease."""
        self.ended = self.given
        if self.held is not None:
            self.held = self.held.owner

    def lapsed(self, now_ns: int, latched: bool) -> str:
        """Return why its holder does not beat any more for what stands; empty: it does, or there is
        none."""
        held = self.held
        if held is None:
            return ""
        over = now_ns >= held.owner.expires_ns or (latched and now_ns >= held.latches_until_ns)
        return f"{held.holder} stopped answering" if over else ""

    def rollout(self, now_ns: int) -> Writing | None:
        """Return what writes under its caller's lease; None: nothing does, or nobody beats for it
        any more."""
        held = self.held
        if held is None or held.under is None or held.owner.expires_ns <= now_ns:
            return None
        return Writing(held.instruction, held.steps, (now_ns - held.began_ns) / NS)

    def refuse(self, lease: int, channel: str) -> Refused | None:
        held = self.held
        if held is None:
            return Refused(Code.NO_LEASE, "the lease is free", "acquire it first")
        if self.find(lease, channel) is None:
            return Refused(Code.LEASE, f"{held.holder} holds the lease", "wait until it is released")
        return None


def is_given_back(lapse: str, holder: str) -> bool:
    """Return whether a robot holds because all who wrote have given their leases back.

    Args:
        lapse: ``Status.lapse``, of ``Lapse``. A late or dead writer has none.
        holder: Who has a lease now.
    """
    return lapse == Lapse.GIVEN_BACK or (not holder and lapse == Lapse.ROLLOUT_ENDED)


def _is_its_own(held: Held, message: Acquire) -> bool:
    return held.under is None and (held.id, held.channel) == (message.again, message.channel)


def _is_asked_again(held: Held, message: Acquire) -> bool:
    """A policy process whose answer did not come in time: it does not know its lease's number."""
    over = 0 if held.under is None else held.under.id
    return held.channel != "" and (held.channel, over) == (message.channel, message.over)


def refuse_by_deadline(deadline_ns: int, now_ns: int) -> Refused | None:
    """Return None when that time has neither passed nor is far away."""
    late_ns = now_ns - deadline_ns
    if late_ns >= 0:
        return Refused(Code.EXPIRED, f"the command is {late_ns / 1e6:.1f} ms past its deadline")
    if -late_ns > _MAX_LIFETIME_NS:
        return Refused(
            Code.TOO_DISTANT,
            f"the deadline is {-late_ns / NS:.1f} s away",
            f"ask for at most {MAX_LIFETIME_S:g} s",
        )
    return None
