"""What a gate remembers, for who records it and for who plays it again."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from strands_actors.contract.driver import Live
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Deferred
from strands_actors.supervisors.gate.messages import Lease, LockKept, StopReport

from . import failsafe
from .cause import Cause
from .lease import Leases


class Waiting(NamedTuple):
    """Who waits for a stop. ``report``: what covers it, while its lock is not on the disk yet."""

    epoch: int
    who: Deferred
    locks: bool
    report: StopReport | None = None
    releases: bool = False  # it gave its lease back: told by ``Released``


class GateMemory(msgspec.Struct, frozen=True):
    """All that a gate's decisions depend on, beside the message and when it was taken up: its
    attributes of these names."""

    state: failsafe.State
    leases: Leases
    observation: Observation | None
    target: tuple[float, ...]
    target_ns: int
    live: Live | None
    stops: list[Waiting]
    lock: LockKept
    resumes: list[Deferred]
    cause: Cause
    connect_error: str
    facts: dict[str, Any]
    last_stop: StopReport | None
    last_stop_ns: int
    services: dict[int, Deferred]
    service: int
    writes: int
    reads: int
    refusals: int
    last_refusal: str
    no_standby: str = ""
    audited: bool = False
    grants: list[tuple[Lease, Deferred]] = []
    stopped_ns: int = 0
    report_stands: bool = False
    rearming: list[Deferred] = []
