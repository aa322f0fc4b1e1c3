"""Messages to the gate, and its replies.

All times are nanoseconds of CLOCK_MONOTONIC on the robot's host. An *epoch* counts the safety events
of a robot. A *lease* is the right to write setpoints; it has one holder at a time.

``channel`` in a message is the name of the link over which it came. The receiving process fills it
in; senders leave it empty.
"""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.driver import ORDERED, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation
from strands_actors.kernel.messages import Message, Refused

LEASE_TTL_S = 1.0
"""A holder that has sent no heartbeat for this long has lost its lease."""


MAX_LIFETIME_S = 10.0
"""Longest time from now to a setpoint's deadline. A later deadline comes from a wrong clock."""


# -- from writers


MOVE, OBSERVE, ACQUIRE, RESUME = "move", "observe", "acquire", "resume"
"""Verbs in the gate's refusals."""


class Acquire(Message, frozen=True):
    """Request a lease.

    Attributes:
        holder: Name of the writer, for people. It proves nothing.
        over: The caller's lease under which a policy process will write; 0 for a script.
        pid: The process that will write; 0 if it is on another host.
        channel: See above.
        again: The sender's present lease, which the new one replaces; 0 without one.
        instruction: The task of a rollout, for people.
    """

    holder: str
    over: int = 0
    pid: int = 0
    channel: str = ""
    again: int = 0
    instruction: str = ""


GRANT_S = 2.0
"""How long to wait for the reply to ``Acquire``. During a hold it comes when the hold is done."""


class Lease(Message, frozen=True):
    id: int
    epoch: int


class Beat(Message, frozen=True):
    """A heartbeat of the holder's process.

    Attributes:
        lease: The lease that it holds.
        answered_ago_s: Seconds since the thread that commands the robot last let other threads run;
            negative if it has not since the last heartbeat.
        channel: See above.
    """

    lane = "latest"

    lease: int
    answered_ago_s: float = 0.0
    channel: str = ""


class Stopped(Message, frozen=True):
    """The process of a writer was stopped by the system (SIGSTOP, Ctrl-Z, a debugger)."""

    lane = "urgent"

    pid: int


class Release(Message, frozen=True):
    """Release the lease.

    A rollout's release makes the robot hold before the reply is sent, unless ``keeps`` is true. Then
    its last setpoint, which was latched, stays in force under the caller's lease.
    """

    lease: int
    keeps: bool = False
    channel: str = ""


class GetSafety(Message, frozen=True):
    """Ask for the report of the last stop, without ordering anything."""

    channel: str = ""


class Setpoint(Message, frozen=True):
    """A target for some or all axes.

    Attributes:
        lease: The sender's lease.
        epoch: The epoch in which it was made.
        deadline_ns: It is written before this time or never. It also ends then, unless ``latched``.
        action: Values by key. The driver checks them.
        period_s: Period of its stream in seconds; 0 for a single command.
        latched: It stays in force while the lease lives.
        channel: See above.
        observe: The reply shall contain the newest observation.
    """

    lane = "latest"

    lease: int
    epoch: int
    deadline_ns: int
    action: dict[str, Any]
    period_s: float = 0.0
    latched: bool = False
    channel: str = ""
    observe: bool = False


class Accepted(Message, frozen=True):
    epoch: int
    values: tuple[float, ...]  # the target of every axis, in the driver's order and units
    sensors: dict[str, tuple[float, ...]] = msgspec.field(
        default_factory=dict
    )  # the newest readings of ``Driver.ANSWERS_WITH``
    observation: Observation | None = None  # if ``Setpoint.observe`` is set and the reading is not too old


class Stop(Message, frozen=True):
    """Order the safe state of a reason. ``lock`` makes it an e-stop, which lasts until a resume."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False
    channel: str = ""

    def as_ordered(self) -> Stop:
        """Return the stop with a reason that a sender outside the tree may use. Other reasons would end
        the tree, or hold a robot that is locked."""
        if self.reason in ORDERED:
            return self
        return msgspec.structs.replace(self, reason=Reason.ESTOP if self.lock else Reason.STOP)


class StopReport(Message, frozen=True):
    """The result of a stop. ``confirmed`` is true only if every motor was read back and is safe."""

    reason: Reason
    safe_state: SafeState
    epoch: int
    confirmed: bool
    motors: tuple[MotorReport, ...]
    path: str = "wire"  # or "stop_channel", the connection of the root
    took_ms: float = 0.0
    at_ns: int = 0  # when every motor had been asked
    note: str = ""  # why the lock of an e-stop does not outlive the tree; empty if it does

    @property
    def unconfirmed(self) -> list[str]:
        return [motor.axis for motor in self.motors if not motor.safe]


class Released(Message, frozen=True):
    """The lease is released, or was not held. ``holds`` is true if the release made the robot hold;
    ``report`` is then the result, otherwise the report of the last stop."""

    holds: bool
    report: StopReport


class Resume(Message, frozen=True):
    """Energise the robot at its measured position. It starts no motion.

    Attributes:
        by: The sender, for the audit.
        lift: Lift a lockout, too.
        asked_ns: When the request was made; 0 for now. It is refused if a stop came since.
    """

    lane = "urgent"

    by: str = ""
    lift: bool = True
    asked_ns: int = 0


class Resumed(Message, frozen=True):
    epoch: int
    observation: Observation


class Perform(Message, frozen=True):
    """Run a service of the driver."""

    lease: int
    epoch: int
    service: str
    arguments: dict[str, Any]  # checked by the driver
    first: Setpoint | None = None  # written before the service runs; if it is refused, nothing is done
    channel: str = ""


class Performed(Message, frozen=True):
    result: dict[str, Any]


class GetObservation(Message, frozen=True):
    channel: str = ""


class GetStatus(Message, frozen=True):
    channel: str = ""


class Writing(Message, frozen=True):
    """A rollout that writes now. ``steps`` counts its accepted setpoints."""

    instruction: str
    steps: int
    elapsed_s: float


class Status(Message, frozen=True):
    mode: str
    epoch: int
    connected: bool
    connect_error: str
    locked_by: str
    cause: str  # why it is in its safe state, for people
    holder: str
    observation: Observation | None
    age_s: float  # of the observation; -1 if there is none
    target: tuple[float, ...]
    writes: int
    reads: int
    refusals: int
    last_refusal: str
    last_stop: StopReport | None
    facts: dict[str, Any] = msgspec.field(default_factory=dict)
    locked_since: str = ""  # ISO 8601, UTC
    no_standby: str = ""  # why standby or root could not stop the robot; nothing may be energised then
    no_motion: Refused | None = None  # the refusal that every setpoint would get now
    rollout: Writing | None = None
    lapse: str = ""  # how the last command ended by itself (``cause.Lapse``); empty if it did not


BROUGHT = 0
"""In place of a probe's number: the gate checked its deadlines because of a setpoint. In a stream as fast as
the watchdog's ticks, each setpoint has the effect of a probe."""


# -- from its own process


class Probe(Message, frozen=True):
    """A request of the watchdog: check the deadlines, and reply as a sign of life."""

    lane = "latest"

    number: int
    now_ns: int


class Observed(Message, frozen=True):
    lane = "latest"

    observation: Observation
    writes: int
    reads: int


class SafeDone(Message, frozen=True):
    lane = "urgent"

    report: StopReport
    hold_failed: str = ""  # why the hold failed, after which the robot was stopped in another way
    observation: Observation | None = None  # read after a hold whose report has no positions


class ArmDone(Message, frozen=True):
    lane = "urgent"

    epoch: int
    observation: Observation | None
    error: str = ""


class CarriedOut(Message, frozen=True):
    lane = "urgent"

    number: int
    result: dict[str, Any]
    refusal: Refused | None = None
    moved: bool = False  # it may have moved the robot


class LinkUp(Message, frozen=True):
    lane = "urgent"

    facts: dict[str, Any]
    observation: Observation


class LinkLost(Message, frozen=True):
    lane = "urgent"

    why: str


# -- from the guardian


class LockKept(Message, frozen=True):
    """The lock of this epoch is on the disk, or why it is not (``problem``)."""

    lane = "urgent"

    epoch: int
    since: str = ""
    problem: str = ""


class StoppedAt(Message, frozen=True):
    """The root was ordered to stop the robot at this time, without the gate."""

    lane = "urgent"

    at_ns: int


class StandbyIs(Message, frozen=True):
    """The state of the standby and the root's stop channel. ``problem`` names the one that is not ready, and
    the reason. It is empty if both are ready."""

    lane = "urgent"

    problem: str = ""
