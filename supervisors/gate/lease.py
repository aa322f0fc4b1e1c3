"""Leases: the right to write setpoints, and how long a setpoint stays in force.

At most two leases exist. A script acquires one. A policy process gets a second one under it, and
writes instead of the script. When the policy releases its lease, the robot is held before the reply
is sent; ``stop_task()`` waits for that.

A lease ends when its holder sends no heartbeat for ``LEASE_TTL_S``. A latched setpoint also ends when
the thread of the holder that commands no longer answers.
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
"""Random bits in the number of a lease. At the rate that the gate accepts, guessing takes weeks."""
_MAX_LIFETIME_NS = round(MAX_LIFETIME_S * NS)


class Held(msgspec.Struct):
    """A lease that is held."""

    id: int
    holder: str
    expires_ns: int  # each heartbeat of its process moves this on
    latches_until_ns: int  # end of a latched target; moved on while the thread that commands answers
    pid: int  # of its process; 0 on another host
    channel: str  # the link over which it was acquired; it counts on no other
    under: Held | None = None  # the lease of the caller for which it writes
    instruction: str = ""
    began_ns: int = 0
    steps: int = 0  # setpoints that were accepted under it
    told: str = ""  # for the audit: the last decision about its setpoints
    refused: Refused | None = None  # of a stream without replies: the next question is answered with it

    @property
    def owner(self) -> Held:
        return self.under or self

    def beat(self, until_ns: int, answered_ago_s: float = 0.0) -> None:
        self.expires_ns = until_ns
        if answered_ago_s >= 0.0:
            self.latches_until_ns = max(self.latches_until_ns, until_ns - round(answered_ago_s * NS))


class Leases(msgspec.Struct):
    """All leases of a robot.

    Attributes:
        given: How many were given so far; it numbers them.
        held: The newest lease; None if the robot is free.
        ended: The newest lease at the last stop. A rollout under an older lease may not start.
        secret: Key of the random bits of a lease's number, since knowing the number is the right to
            write.
    """

    given: int
    held: Held | None = None
    ended: int = 0
    secret: bytes = b""

    def acquire(self, message: Acquire, now_ns: int, holding: bool = False) -> int | Refused:
        """Return the number of a new lease, or a refusal.

        A policy process (a channel with a name) gets a lease under its caller's only. A holder that
        names its lease (``message.again``) gets a new one in its place.

        Args:
            message: The request.
            now_ns: The time.
            holding: True if no target is in force. The script may then take its lease back from a
                rollout that has not returned it, for example because the policy was cut off.
        """
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
        """Return the random bits for a number. They depend on the secret alone, so that a replay
        computes the same."""
        digest = blake2b(str(number).encode(), key=self.secret, digest_size=_PROOF_BITS // 8).digest()
        return int.from_bytes(digest, "big") if self.secret else 0

    def beat(self, message: Beat, now_ns: int) -> None:
        held = self.held
        while held is not None:
            if (held.id, held.channel) == (message.lease, message.channel):
                held.beat(now_ns + LEASE_TTL_NS, message.answered_ago_s)
            held = held.under

    def find(self, lease: int, channel: str) -> Held | None:
        """Return the held lease if it has this number and this channel."""
        held = self.held
        return held if held is not None and (held.id, held.channel) == (lease, channel) else None

    def release(self, lease: int, channel: str) -> Held | None:
        """Release a lease and return it; None if it was not held."""
        held = self.find(lease, channel)
        if held is not None:
            self.held = held.under
        return held

    def stop(self) -> None:
        """End the rollout, since a policy that has died cannot release its lease."""
        self.ended = self.given
        if self.held is not None:
            self.held = self.held.owner

    def lapsed(self, now_ns: int, latched: bool) -> str:
        """Return why the lease has lapsed; empty if its holder sends heartbeats, or there is no lease."""
        held = self.held
        if held is None:
            return ""
        over = now_ns >= held.owner.expires_ns or (latched and now_ns >= held.latches_until_ns)
        return f"{held.holder} stopped answering" if over else ""

    def rollout(self, now_ns: int) -> Writing | None:
        """Return the rollout that writes under its caller's lease; None if there is none, or the caller
        sends no heartbeats."""
        held = self.held
        if held is None or held.under is None or held.owner.expires_ns <= now_ns:
            return None
        return Writing(held.instruction, held.steps, (now_ns - held.began_ns) / NS)

    def refuse(self, lease: int, channel: str) -> Refused | None:
        """Return a refusal for a lease that is not the held one."""
        held = self.held
        if held is None:
            return Refused(Code.NO_LEASE, "the lease is free", "acquire it first")
        if self.find(lease, channel) is None:
            return Refused(Code.LEASE, f"{held.holder} holds the lease", "wait until it is released")
        return None


def is_given_back(lapse: str, holder: str) -> bool:
    """Return True if the robot holds because every writer has released its lease.

    Args:
        lapse: ``Status.lapse``, a ``Lapse``. It is empty after a late or dead writer.
        holder: The present holder of a lease; empty if there is none.
    """
    return lapse == Lapse.GIVEN_BACK or (not holder and lapse == Lapse.ROLLOUT_ENDED)


def _is_its_own(held: Held, message: Acquire) -> bool:
    return held.under is None and (held.id, held.channel) == (message.again, message.channel)


def _is_asked_again(held: Held, message: Acquire) -> bool:
    """Return True if a policy process asks again because the reply with its lease came too late."""
    over = 0 if held.under is None else held.under.id
    return held.channel != "" and (held.channel, over) == (message.channel, message.over)


def refuse_by_deadline(deadline_ns: int, now_ns: int) -> Refused | None:
    """Return a refusal for a deadline that has passed, or lies too far ahead."""
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
