"""The right to write, and how long what was written with it may stand."""

from __future__ import annotations

import msgspec

from strands_actors.runtime.clock import NS
from strands_actors.runtime.messages import Refused

from .messages import LEASE_TTL_S, MAX_LIFETIME_S

LEASE_TTL_NS = round(LEASE_TTL_S * NS)
_MAX_LIFETIME_NS = round(MAX_LIFETIME_S * NS)


class Held(msgspec.Struct):
    """The lease, and how long it has been beaten for. ``under`` is the lease of the caller it writes for."""

    id: int
    holder: str
    expires_ns: int  # unless its process is heard of
    latches_until_ns: int  # unless the thread that commands answers: a latched target lives no longer
    under: Held | None = None
    refused: Refused | None = None  # what nobody waited to hear: the stream is over, and who asks next hears why

    @property
    def owner(self) -> Held:
        return self.under or self

    def beat(self, until_ns: int, answered_ago_s: float = 0.0) -> None:
        self.expires_ns = until_ns
        if answered_ago_s >= 0.0:
            self.latches_until_ns = max(self.latches_until_ns, until_ns - round(answered_ago_s * NS))


def refuse_by_deadline(deadline_ns: int, now_ns: int, prefix: str = "") -> Refused | None:
    """None when that time has neither passed nor is far away. ``prefix``: of the reason, what was asked for."""
    late_ns = now_ns - deadline_ns
    if late_ns >= 0:
        return Refused("expired", f"{prefix}the command is {late_ns / 1e6:.1f} ms past its deadline")
    if -late_ns > _MAX_LIFETIME_NS:
        return Refused(
            "too_distant",
            f"{prefix}the deadline is {-late_ns / NS:.1f} s away",
            f"ask for at most {MAX_LIFETIME_S:g} s",
        )
    return None
