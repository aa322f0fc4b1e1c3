"""The state of a gate as data. Recordings store it, and replays restore it."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from strands_actors.contract.driver import Live
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Deferred
from strands_actors.supervisors.gate.messages import Lease, LockKept, StopReport

from . import failsafe
from .cause import Cause
from .intervals import Intervals
from .lease import Leases


class Waiting(NamedTuple):
    """A request to the gate that is answered when a stop of the robot is done."""

    epoch: int
    reply: Deferred
    locks: bool
    report: StopReport | None = None  # the report of the stop, while the lock of the e-stop is not on the disk yet
    # True for the release of a lease; its reply is ``Released``.
    releases: bool = False


class GateMemory(msgspec.Struct, frozen=True):
    """Everything on which the gate's decisions depend, besides a message and its time. The gate has an attribute
    for each field."""

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
    last_cause: str = ""
    ordered: SafeState = SafeState.HOLD
    refused: dict[str, int] = {}
    setpoints: int = 0
    intervals: Intervals = msgspec.field(default_factory=Intervals)
