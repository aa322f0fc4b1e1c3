"""Messages to the gate, and its replies.

All times are nanoseconds of CLOCK_MONOTONIC on the robot's host. An *epoch* is a counter that every stop and hold
of the robot raises. A *lease* is the right to write setpoints; one writer holds it at a time.

``channel`` in a message is the name of the link over which the message came. The receiving process sets it, and
senders leave it empty.
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


# -- messages from writers (scripts, policies and other programs)


MOVE, OBSERVE, ACQUIRE, RESUME = "move", "observe", "acquire", "resume"
"""Verbs that the gate's refusals name."""


class Acquire(Message, frozen=True):
    """Request a lease, the right to write setpoints.

    Attributes:
        holder: Name of the writer, for people. It proves nothing.
        over: For a policy process: the lease of the script that started it. 0 for a script.
        pid: Id of the process that will write; 0 if it is on another host.
        channel: Name of the link; set by the receiver.
        again: The sender's present lease, which the new lease replaces; 0 without one.
        instruction: The task of a policy, for people.
    """

    holder: str
    over: int = 0
    pid: int = 0
    channel: str = ""
    again: int = 0
    instruction: str = ""


GRANT_S = 2.0
"""Timeout for the reply to ``Acquire``, in seconds. During a hold the reply comes when the hold is done."""


class Lease(Message, frozen=True):
    id: int
    epoch: int


class Beat(Message, frozen=True):
    """A heartbeat of the process that holds a lease.

    Attributes:
        lease: The lease.
        answered_ago_s: Seconds since the thread that sends commands last let other threads run. Negative if it has
            not done so since the last heartbeat.
        channel: Name of the link; set by the receiver.
    """

    lane = "latest"

    lease: int
    answered_ago_s: float = 0.0
    channel: str = ""


class Stopped(Message, frozen=True):
    """The operating system has suspended the process of a writer (SIGSTOP, Ctrl-Z, a debugger)."""

    lane = "urgent"

    pid: int


class WriterEnded(Message, frozen=True):
    """The process of a program that had attached itself to the robot has ended. Its lease ends at once."""

    lane = "urgent"

    pid: int


class Release(Message, frozen=True):
    """Release a lease, the right to write setpoints.

    If a policy releases its lease, the robot is made to hold before the reply is sent. With ``keeps``, it does not
    hold: the last setpoint of the policy, which has no end, stays in force under the script's lease.
    """

    lease: int
    keeps: bool = False
    channel: str = ""


class GetSafety(Message, frozen=True):
    """Request the report of the last stop. Nothing is ordered."""

    channel: str = ""


class Setpoint(Message, frozen=True):
    """A target for some or all axes.

    Attributes:
        lease: The sender's lease.
        epoch: The value of the epoch (a counter of stops and holds) when the setpoint was made.
        deadline_ns: The setpoint is written before this time or never. The motion also ends at this time, unless
            ``latched``.
        action: Values by key. The driver checks them.
        period_s: Time between two setpoints of a stream, in seconds; 0 for a single command.
        latched: True if the setpoint stays in force while the lease is held.
        channel: Name of the link; set by the receiver.
        observe: True to get the newest observation with the reply.
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
    )  # the newest values of the sensors in ``Driver.ANSWERS_WITH``
    # The newest observation, if ``Setpoint.observe`` is set and it is not too old.
    observation: Observation | None = None


class Stop(Message, frozen=True):
    """Order the safe state for ``reason``. With ``lock`` it is an e-stop, and the robot stays locked until a
    resume."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False
    channel: str = ""

    def as_ordered(self) -> Stop:
        """Return this order of a stop. If another program may not use its reason, the reason is replaced, since it
        would end the robot's processes, or only make a locked robot hold."""
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
    path: str = "wire"  # "wire", or "stop_channel" if the root stopped the robot over its own connection
    took_ms: float = 0.0
    at_ns: int = 0  # time at which the safe state had been requested from every motor
    note: str = ""  # why the lock of an e-stop is lost when the robot's processes end; empty if it is on the disk
    # Time from the order until the wire process began to wait for replies. The first frame of the safe state was
    # written by then. 0 if it is not known.
    written_ms: float = 0.0

    @property
    def unconfirmed(self) -> list[str]:
        return [motor.axis for motor in self.motors if not motor.safe]


class Released(Message, frozen=True):
    """The lease is released, or was not held. ``holds`` is True if the robot holds because of the release.
    ``report`` is then the result of that hold, and otherwise the report of the last stop."""

    holds: bool
    report: StopReport


class Resume(Message, frozen=True):
    """Energise the robot at its measured position. This starts no motion.

    Attributes:
        by: The sender, for the audit.
        lift: True to lift the lock of an e-stop, too.
        requested_ns: When ``resume`` was called; 0 for now. The request is refused if the robot was stopped after
            this time.
    """

    lane = "urgent"

    by: str = ""
    lift: bool = True
    requested_ns: int = 0


class Resumed(Message, frozen=True):
    epoch: int
    observation: Observation


class Perform(Message, frozen=True):
    """Run a service of the driver, such as ``reset`` of a simulation."""

    lease: int
    epoch: int
    service: str
    arguments: dict[str, Any]  # arguments of the service, which the driver checks
    # Setpoint that is written before the service runs; if it is refused, the service does not run.
    first: Setpoint | None = None
    channel: str = ""


class Performed(Message, frozen=True):
    result: dict[str, Any]


class GetObservation(Message, frozen=True):
    channel: str = ""


class GetStatus(Message, frozen=True):
    channel: str = ""


class Writing(Message, frozen=True):
    """The policy run (rollout) that writes setpoints now. ``steps`` is the number of its accepted setpoints."""

    instruction: str
    steps: int
    elapsed_s: float


class Status(Message, frozen=True):
    mode: str
    epoch: int
    connected: bool
    connect_error: str
    locked_by: str
    cause: str  # why the robot is in its safe state, for people; empty while it is armed
    holder: str
    observation: Observation | None
    age_s: float  # age of the observation in seconds; -1 without an observation
    target: tuple[float, ...]
    writes: int
    reads: int
    refusals: int
    last_refusal: str
    last_stop: StopReport | None
    facts: dict[str, Any] = msgspec.field(default_factory=dict)
    locked_since: str = ""  # when the robot was locked by an e-stop, ISO 8601 in UTC; empty if it is not locked
    # Why standby or root could not stop the robot, so that nothing may be energised; empty if both could.
    no_standby: str = ""
    no_motion: Refused | None = None  # refusal that every setpoint would get now; None if setpoints are possible
    rollout: Writing | None = None
    lapse: str = ""  # how the last command ended (``cause.Lapse``), if no stop or fault ended it; otherwise empty
    last_stop_cause: str = ""  # why the robot last stopped or held, for people, also while it is armed again
    refused: dict[str, int] = msgspec.field(default_factory=dict)  # number of refused setpoints by code
    setpoints: int = 0  # number of accepted setpoints
    # Number of intervals between the setpoints of streams, by bucket (``intervals.BOUNDS_S``), and their sum.
    intervals: tuple[int, ...] = ()
    intervals_s: float = 0.0


BROUGHT = 0
"""In place of a probe's number: the gate checked its deadlines because of a setpoint. In a stream as fast as
the watchdog's ticks, each setpoint has the effect of a probe."""


# -- messages from the wire process itself


class Probe(Message, frozen=True):
    """A request of the watchdog to check the deadlines. The reply shows that the gate works."""

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
    hold_failed: str = ""  # why the hold failed, so that the robot was stopped instead; empty if it did not fail
    # Observation that was read after a hold, if the report of the hold has no positions.
    observation: Observation | None = None


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
    # True if the service may have moved the robot.
    moved: bool = False


class LinkUp(Message, frozen=True):
    lane = "urgent"

    facts: dict[str, Any]
    observation: Observation


class LinkLost(Message, frozen=True):
    lane = "urgent"

    cause: str


# -- messages from the guardian, in the root


class LockKept(Message, frozen=True):
    """The root has written the lock of an e-stop to the disk, or could not (``problem``). ``epoch`` is the value
    of the epoch (a counter of stops and holds) at the e-stop."""

    lane = "urgent"

    epoch: int
    since: str = ""
    problem: str = ""


class StoppedAt(Message, frozen=True):
    """The root was ordered to stop the robot at this time, and did so without the gate."""

    lane = "urgent"

    at_ns: int


class StandbyIs(Message, frozen=True):
    """Whether the standby process and the root's stop channel are ready. ``problem`` names the one that is not
    ready, and why. It is empty if both are ready."""

    lane = "urgent"

    problem: str = ""
