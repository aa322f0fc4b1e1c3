"""What the gate is told and asked, and what it answers.

Times are CLOCK_MONOTONIC nanoseconds of the robot's host. An *epoch* is the robot's count of safety
events; a *lease* is the right to write, one holder at a time.
"""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.driver import ORDERED, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation
from strands_actors.kernel.messages import Message, Refused

LEASE_TTL_S = 1.0
"""A caller that has not been heard of for this long has lost its lease."""


MAX_LIFETIME_S = 10.0
"""No setpoint may ask to live longer: such a deadline is a wrong clock, not a wish."""


# -- from writers


MOVE, OBSERVE, ACQUIRE, RESUME = "move", "observe", "acquire", "resume"
"""Verbs of what the gate refuses."""


class Acquire(Message, frozen=True):
    """Ask for the lease. ``over``: a lease of the same caller that the new one is to write under.
    ``pid``: the process that will write, if it is one of this host. ``again``: the lease that it
    has, in whose place it wants another: a holder's name proves nothing."""

    holder: str
    over: int = 0
    pid: int = 0
    channel: str = ""
    """In this and in what is told under a lease: over which channel it came. The receiving process
    writes it; who sends leaves it empty."""
    again: int = 0
    instruction: str = ""
    """Of a rollout: what it is to do, for who looks on."""


GRANT_S = 2.0
"""How long to wait for a lease: in the middle of a hold it is given when the robot holds."""


class Lease(Message, frozen=True):
    id: int
    epoch: int


class Beat(Message, frozen=True):
    """The holder's process lives. ``answered_ago_s``: when the thread that commands the robot last
    did anything but compute; negative: not since the last beat."""

    lane = "latest"

    lease: int
    answered_ago_s: float = 0.0
    channel: str = ""


class Stopped(Message, frozen=True):
    """The system has stopped a process that writes (SIGSTOP, Ctrl-Z, a debugger): it cannot say so
    itself."""

    lane = "urgent"

    pid: int


class Release(Message, frozen=True):
    """Give the lease up. One that writes under another (``over``) is then held before, unless it
    ``keeps``: its last setpoint was latched, and stands as one of the lease it wrote under."""

    lease: int
    keeps: bool = False
    channel: str = ""


class GetSafety(Message, frozen=True):
    """Ask what is known of the robot's safety. The answer is the report of the last stop, as long as
    it stands. Orders nothing."""

    channel: str = ""


class Setpoint(Message, frozen=True):
    """A target. Written before ``deadline_ns`` or never; ``latched``: then kept while the lease
    lives, otherwise kept until the deadline."""

    lane = "latest"

    lease: int
    epoch: int
    deadline_ns: int
    action: dict[str, Any]  # checked by the driver: a wrong value is refused by its name
    period_s: float = 0.0  # of the stream this is part of; 0 for a one-shot
    latched: bool = False
    channel: str = ""
    observe: bool = False  # the answer is to bring the newest observation


class Accepted(Message, frozen=True):
    epoch: int
    values: tuple[float, ...]  # the whole target, axis order, the driver's units
    sensors: dict[str, tuple[float, ...]] = msgspec.field(
        default_factory=dict
    )  # ``Driver.ANSWERS_WITH``, as last read
    observation: Observation | None = None  # with ``Setpoint.observe``, unless it is too old


class Stop(Message, frozen=True):
    """Make safe. ``lock``: an e-stop, which stays until a resume."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False
    channel: str = ""

    def as_ordered(self) -> Stop:
        """Return it as somebody may order it who is not the tree itself: another reason would end the
        tree, or hold under a lock."""
        if self.reason in ORDERED:
            return self
        return msgspec.structs.replace(self, reason=Reason.ESTOP if self.lock else Reason.STOP)


class StopReport(Message, frozen=True):
    """What became of a stop. ``confirmed`` only when every motor was read back safe."""

    reason: Reason
    safe_state: SafeState
    epoch: int
    confirmed: bool
    motors: tuple[MotorReport, ...]
    path: str = "wire"  # or "stop_channel": the root's own way
    took_ms: float = 0.0
    at_ns: int = 0  # when it was made: all motors had been asked
    note: str = ""  # of an e-stop: why its lock does not outlive the tree; empty: it does

    @property
    def unconfirmed(self) -> list[str]:
        return [motor.axis for motor in self.motors if not motor.safe]


class Released(Message, frozen=True):
    """The lease was given up, or was not held. ``holds``: this has made the robot hold what was
    commanded under it. ``report``: what became of that, or what is known of the robot's safety."""

    holds: bool
    report: StopReport


class Resume(Message, frozen=True):
    """Lift a lockout (unless ``lift`` is false) and energise at the measured position. Restarts no
    motion. ``asked_ns``: when somebody asked for it, by the host's monotonic clock; a stop that came
    since wins. 0: now."""

    lane = "urgent"

    by: str = ""
    lift: bool = True
    asked_ns: int = 0


class Resumed(Message, frozen=True):
    epoch: int
    observation: Observation


class Perform(Message, frozen=True):
    """Do one of the driver's own services."""

    lease: int
    epoch: int
    service: str
    arguments: dict[str, Any]  # checked by the driver
    first: Setpoint | None = None  # written before it; refused, nothing is done
    channel: str = ""


class Performed(Message, frozen=True):
    result: dict[str, Any]


class GetObservation(Message, frozen=True):
    channel: str = ""


class GetStatus(Message, frozen=True):
    channel: str = ""


class Writing(Message, frozen=True):
    """A rollout that writes now, in whatever process it runs. ``steps``: its setpoints so far."""

    instruction: str
    steps: int
    elapsed_s: float


class Status(Message, frozen=True):
    mode: str
    epoch: int
    connected: bool
    connect_error: str
    locked_by: str
    cause: str  # why it is safe: the last reason
    holder: str
    observation: Observation | None
    age_s: float  # of the observation; -1 when there is none
    target: tuple[float, ...]
    writes: int
    reads: int
    refusals: int
    last_refusal: str
    last_stop: StopReport | None
    facts: dict[str, Any] = msgspec.field(default_factory=dict)
    locked_since: str = ""  # ISO 8601, UTC
    no_standby: str = ""  # why standby or root could not stop the robot, so that nothing may be energised
    no_motion: Refused | None = None  # what a command would be told now, whatever it says; None: it is looked at
    rollout: Writing | None = None
    lapse: str = ""  # how a command ended by itself, of ``cause.Lapse``; empty: it did not


BROUGHT = 0
"""Instead of a probe's number: a setpoint of a stream that is as quick as ticks has made the gate
look."""


# -- from its own process


class Probe(Message, frozen=True):
    """The watchdog asks the gate to show that it lives, and to look at its deadlines."""

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
    hold_failed: str = ""  # why it could not hold, and was brought to rest in another way
    observation: Observation | None = None  # read after a hold that says nothing of its targets


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
    """The lock that stood in this epoch is on the disk. ``problem``: why it is not."""

    lane = "urgent"

    epoch: int
    since: str = ""
    problem: str = ""


class StoppedAt(Message, frozen=True):
    """The root was told to stop the robot then, and the gate was not asked."""

    lane = "urgent"

    at_ns: int


class StandbyIs(Message, frozen=True):
    """Whether the standby, and the root's own stop channel, could make the robot safe at once.
    ``problem``: why not; empty: both could."""

    lane = "urgent"

    problem: str = ""
