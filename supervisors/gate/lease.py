"""Leases: the right to write setpoints, and how long a setpoint stays in force.

At most two leases exist. A script acquires the first one. A policy process gets a second one from the script, and
then writes in its place. When the policy releases its lease, the robot is made to hold before the reply is sent.
``stop_task()`` waits for this reply.

A lease ends when its holder sends no heartbeat for ``LEASE_TTL_S``. A latched setpoint (one without an end) also
ends when the thread that sends the commands no longer runs.
"""

from __future__ import annotations

from hashlib import blake2b

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.gate.messages import LEASE_TTL_S, MAX_LIFETIME_S, Acquire, Beat, Writing

from . import refusals

LEASE_TTL_NS = round(LEASE_TTL_S * NS)
_PROOF_BITS = 32
"""Number of random bits in the number of a lease. At the rate that the gate accepts, guessing takes weeks."""
_MAX_LIFETIME_NS = round(MAX_LIFETIME_S * NS)


class HeldLease(msgspec.Struct):
    """One lease (right to command the robot) that a writer holds now."""

    id: int
    holder: str
    expires_ns: int  # when the lease ends; each heartbeat of the holder's process moves this time on
    # When a setpoint without an end is ended; moved on while the thread that sends commands runs.
    latches_until_ns: int
    pid: int  # id of the holder's process; 0 on another host
    channel: str  # name of the link over which the lease was acquired; the lease is valid on this link only
    under: HeldLease | None = None  # for a policy: the lease of the script that started it
    instruction: str = ""
    began_ns: int = 0
    steps: int = 0  # number of setpoints accepted under this lease
    # Code of the last decision about a setpoint, so that the audit has each change once.
    last_decision: str = msgspec.field(name="told", default="")
    # Refusal of a setpoint that was sent without a reply; the next setpoint with a reply gets it.
    refused: Refused | None = None

    @property
    def owner(self) -> HeldLease:
        return self.under or self

    def beat(self, until_ns: int, answered_ago_s: float = 0.0) -> None:
        self.expires_ns = until_ns
        if answered_ago_s >= 0.0:
            self.latches_until_ns = max(self.latches_until_ns, until_ns - round(answered_ago_s * NS))


class Leases(msgspec.Struct):
    """All leases of a robot.

    Attributes:
        count: Number of leases given so far. The next lease gets the next number.
        held: The newest lease; None if no writer holds one.
        ended: Number of the newest lease at the last stop. A policy cannot start under this lease or an older one.
        secret: Key for the random bits in the number of a lease. A writer proves its right by the number.
    """

    count: int = msgspec.field(name="given")
    held: HeldLease | None = None
    ended: int = 0
    secret: bytes = b""

    def acquire(self, message: Acquire, now_ns: int, holding: bool = False) -> int | Refused:
        """Return the number of a new lease, or a refusal.

        A policy process (a message with ``channel``) gets a lease only if the script that started it holds one. If
        a holder names its present lease (``message.again``), the new lease replaces it.

        Args:
            message: The request.
            now_ns: The time.
            holding: True if the robot holds, so that no setpoint is in force. A script may then take its lease back
                from a policy that did not return it, for example because its link was cut.
        """
        if message.channel and not message.over:
            return refusals.no_script_lease(message.channel)
        if 0 < message.over >> _PROOF_BITS <= self.ended:
            return refusals.stopped_since_policy_start()
        held = self.held
        under: HeldLease | None = None
        if held is not None and held.owner.expires_ns > now_ns:
            if held.id == message.over and not held.channel:
                under = held.owner
            elif _is_repeated(held, message):
                under = held.under
            elif not _is_renewal(held.owner if holding else held, message):
                return refusals.lease_taken(held.holder)
        elif message.over:
            return refusals.script_lease_ended()
        self.count += 1
        until_ns = now_ns + LEASE_TTL_NS
        lease = self.count << _PROOF_BITS | self._proof(self.count)
        self.held = HeldLease(
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
        """Return the random bits for a lease with this number. They depend only on ``secret``, so that a replay
        gives the same."""
        digest = blake2b(str(number).encode(), key=self.secret, digest_size=_PROOF_BITS // 8).digest()
        return int.from_bytes(digest, "big") if self.secret else 0

    def beat(self, message: Beat, now_ns: int) -> None:
        held = self.held
        while held is not None:
            if (held.id, held.channel) == (message.lease, message.channel):
                held.beat(now_ns + LEASE_TTL_NS, message.answered_ago_s)
            held = held.under

    def find(self, lease: int, channel: str) -> HeldLease | None:
        """Return the lease with this number and channel; None if it is not held."""
        held = self.held
        return held if held is not None and (held.id, held.channel) == (lease, channel) else None

    def release(self, lease: int, channel: str) -> HeldLease | None:
        """End a lease and return it; None if it was not held."""
        held = self.find(lease, channel)
        if held is not None:
            self.held = held.under
        return held

    def stop(self) -> None:
        """End the lease of a policy at a stop, since a policy that has died cannot release it."""
        self.ended = self.count
        if self.held is not None:
            self.held = self.held.owner

    def lapsed(self, now_ns: int, latched: bool) -> str:
        """Return why the lease has ended by itself; empty if it has not, or if no lease is held."""
        held = self.held
        if held is None:
            return ""
        over = now_ns >= held.owner.expires_ns or (latched and now_ns >= held.latches_until_ns)
        return f"{held.holder} stopped answering" if over else ""

    def rollout(self, now_ns: int) -> Writing | None:
        """Return the policy run (rollout) that writes setpoints now. Return None if no policy writes, or if the
        script that started it sends no heartbeats."""
        held = self.held
        if held is None or held.under is None or held.owner.expires_ns <= now_ns:
            return None
        return Writing(held.instruction, held.steps, (now_ns - held.began_ns) / NS)

    def refuse(self, lease: int, channel: str) -> Refused | None:
        """Return a refusal if this lease is not held now; otherwise None."""
        held = self.held
        if held is None:
            return refusals.no_lease()
        if self.find(lease, channel) is None:
            return refusals.lease_of_another(held.holder)
        return None


def is_lease_released(lapse: str, holder: str) -> bool:
    """Return True if the robot holds because every writer has released its lease.

    Args:
        lapse: ``Status.lapse``: how the last command ended. It is empty if a writer was late or died.
        holder: Name of the writer that holds a lease now; empty if no writer does.
    """
    return lapse == Lapse.LEASE_RELEASED or (not holder and lapse == Lapse.ROLLOUT_ENDED)


def _is_renewal(held: HeldLease, message: Acquire) -> bool:
    return held.under is None and (held.id, held.channel) == (message.again, message.channel)


def _is_repeated(held: HeldLease, message: Acquire) -> bool:
    """Return True if a policy process repeats its request because the reply with its lease came too late."""
    over = 0 if held.under is None else held.under.id
    return held.channel != "" and (held.channel, over) == (message.channel, message.over)


def refuse_by_deadline(deadline_ns: int, now_ns: int) -> Refused | None:
    """Return a refusal for a deadline that has passed or is too far ahead; otherwise None."""
    late_ns = now_ns - deadline_ns
    if late_ns >= 0:
        return refusals.expired(late_ns / 1e6)
    if -late_ns > _MAX_LIFETIME_NS:
        return refusals.too_distant(-late_ns / NS, MAX_LIFETIME_S)
    return None
