"""What the actors of one robot say to each other.

Times are CLOCK_MONOTONIC nanoseconds of the robot's host. An *epoch* is the robot's count of safety
events; a *lease* is the right to write, one holder at a time.
"""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.driver import MotorReport, Observation, Reason
from strands_actors.kernel.messages import Message, Refused

LEASE_TTL_S = 1.0
"""A caller that has not been heard of for this long has lost its lease."""

MAX_LIFETIME_S = 10.0
"""No setpoint may ask to live longer: such a deadline is a wrong clock, not a wish."""


# -- from writers to the gate


class Acquire(Message, frozen=True):
    """Ask for the lease. ``over``: a lease of the same caller that the new one is to write under.
    ``pid``: the process that will write, if it is one of this host."""

    holder: str
    over: int = 0
    pid: int = 0
    channel: str = ""
    """In this and in what is told under a lease: over which channel it came. The receiving process
    writes it; who sends leaves it empty."""


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
    """Give the lease up. One that writes under another (``over``) is then held before."""

    lease: int
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


class Accepted(Message, frozen=True):
    epoch: int
    values: tuple[float, ...]  # the whole target, axis order, the driver's units
    sensors: dict[str, tuple[float, ...]] = msgspec.field(
        default_factory=dict
    )  # ``Driver.ANSWERS_WITH``, as last read


class Stop(Message, frozen=True):
    """Make safe. ``lock``: an e-stop, which stays until a resume."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False


class StopReport(Message, frozen=True):
    """What became of a stop. ``confirmed`` only when every motor was read back safe."""

    reason: Reason
    safe_state: str
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


class Resume(Message, frozen=True):
    """Lift a lockout (unless ``lift`` is false) and energise at the measured position. Restarts no
    motion."""

    lane = "urgent"

    by: str = ""
    lift: bool = True


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
    pass


class GetStatus(Message, frozen=True):
    pass


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
    no_standby: str = ""  # why there is no standby, so that nothing may be energised
    no_motion: Refused | None = None  # what a command would be told now, whatever it says; None: it is looked at


# -- inside the wire group


class Probe(Message, frozen=True):
    """The watchdog asks the gate to show that it lives, and to look at its deadlines."""

    lane = "latest"

    number: int
    now_ns: int


BROUGHT = 0
"""Instead of a probe's number: a setpoint of a stream that is as quick as ticks has made the gate
look."""


class Alive(Message, frozen=True):
    """The gate's answer. ``live``: there is a setpoint whose writer and lifetime still stand."""

    lane = "latest"

    number: int
    epoch: int
    live: bool


class Write(Message, frozen=True):
    """A gated setpoint. The transport checks epoch and deadline again just before the bytes
    leave."""

    lane = "latest"

    epoch: int
    deadline_ns: int
    values: tuple[float, ...]
    expires_ns: int = 0  # when a re-send is no longer allowed; 0: latched


class Cycle(Message, frozen=True):
    """One period of the wire: re-send the last setpoint and feed the firmware's watchdog if told
    so, then read."""

    lane = "latest"

    number: int
    resend_epoch: int = 0  # 0: read only
    feed: bool = False


class Cycled(Message, frozen=True):
    """The transport's answer; ``busy_until_ns``: it is in a bounded operation (connecting,
    confirming)."""

    lane = "latest"

    number: int
    busy_until_ns: int = 0


class Observed(Message, frozen=True):
    lane = "latest"

    observation: Observation
    writes: int
    reads: int


class MakeSafe(Message, frozen=True):
    lane = "urgent"

    epoch: int
    safe_state: str
    reason: Reason


class SafeDone(Message, frozen=True):
    lane = "urgent"

    report: StopReport


class Arm(Message, frozen=True):
    epoch: int


class ArmDone(Message, frozen=True):
    lane = "urgent"

    epoch: int
    observation: Observation | None
    error: str = ""


class CarryOut(Message, frozen=True):
    """A service that passed the gate. ``number`` tells its answer from others."""

    epoch: int
    number: int
    service: str
    arguments: dict[str, Any]


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


# -- between the wire group and the guardian


class Renew(Message, frozen=True):
    """The wire asks for a new process: its SDK is spent."""

    lane = "urgent"

    why: str


class SilentUntil(Message, frozen=True):
    """The wire process may not beat until then: it opens or arms an SDK that keeps the
    interpreter's lock. 0: that is over. The root believes it for ``Timing.silent_s`` at most."""

    lane = "urgent"

    until_ns: int


class StateIs(Message, frozen=True):
    """The gate's failsafe state, told at each change: what a restarted wire must go on from."""

    lane = "urgent"

    mode: str
    epoch: int
    locked_by: str
    cause: str


class Decided(Message, frozen=True):
    """What the gate was told, by whom, and what it answered: for the audit. ``over``: the name of
    the channel, where it has one."""

    who: str
    what: str
    how: str
    over: str = ""


class LockKept(Message, frozen=True):
    """The lock that stood in this epoch is on the disk. ``problem``: why it is not."""

    lane = "urgent"

    epoch: int
    since: str = ""
    problem: str = ""


class RootGone(Message, frozen=True):
    """The link to the root has closed."""

    lane = "urgent"


class Handover(Message, frozen=True):
    """Descriptors for the stop channels of root and standby. They travel with the message.
    ``again``: for a standby that was started since; the root has its own."""

    lane = "urgent"

    descriptors: tuple[int, ...]
    again: bool = False


class HandedOver(Message, frozen=True):
    pass


class HandOverAgain(Message, frozen=True):
    """The root asks an open wire for another handover: there is a new standby. Not urgent: it may
    wait."""


class StandbyIs(Message, frozen=True):
    """Whether a standby lives and could make the robot safe. ``problem``: why not; empty: it
    could."""

    lane = "urgent"

    problem: str = ""


# -- between the root and the standby


class WatchOver(Message, frozen=True):
    """The pids of the root and of the wire that was started last; 0: none. ``descriptors``: the
    page of heartbeats, then a pidfd of each, where the system has such."""

    lane = "urgent"

    root: int
    wire: int
    descriptors: tuple[int, ...]


class Guard(Message, frozen=True):
    """Descriptors for the standby's stop channel. Answered when that could be used at once."""

    lane = "urgent"

    descriptors: tuple[int, ...]


class Guarding(Message, frozen=True):
    pass


class LetGo(Message, frozen=True):
    """Close the stop channel: the next wire opens the port."""

    lane = "urgent"


class LetGone(Message, frozen=True):
    pass


# -- to and from the root


class Fence(Message, frozen=True):
    """End the wire process and make safe by the stop channel: for who got no answer to a stop."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False


class Shutdown(Message, frozen=True):
    """Make safe, then end the whole tree."""

    lane = "urgent"

    reason: Reason
    by: str = ""


class Rollout(Message, frozen=True):
    """What a policy actor needs to run. ``over``: the caller's lease it writes under."""

    robot: str
    axes: tuple[str, ...]
    instruction: str
    period_s: float
    ttl_s: float
    duration_s: float
    n_steps: int = 0  # 0: until the duration ends
    over: int = 0


class StartTask(Message, frozen=True):
    """Run a policy in a process of its own. ``provider``: ``module:factory``. ``deadline_ns``: the
    process has begun by then or does nothing, since nobody waits for it any more; 0: none."""

    provider: str
    options: dict[str, Any]
    rollout: Rollout
    deadline_ns: int = 0
    is_actor: bool = False
    """``provider`` is an actor in the policy's place, made as ``factory(rollout, report, **options)``:
    it sends the setpoints itself."""


class Operate(Message, frozen=True):
    """What an operator does at a keyboard, for a teleoperation: the dead-man, and how fast each
    axis is to go, -1..1. Told again and again: it stands for a moment only."""

    lane = "latest"

    t_ns: int
    held: bool
    rates: dict[str, float] = msgspec.field(default_factory=dict)


class StopTask(Message, frozen=True):
    lane = "urgent"


class GetTask(Message, frozen=True):
    pass


class TaskStatus(Message, frozen=True):
    """One shape for every driver. ``exit_reason``: stopped, n_steps, duration, policy, gate,
    publish, stop, cleanup or refused; empty while running and before the first task."""

    lane = "latest"

    running: bool = False
    steps: int = 0
    elapsed_s: float = 0.0
    exit_reason: str = ""
    exit_detail: str = ""
    refusal: str = ""
    instruction: str = ""
    hz: float = 0.0
    teleop: dict[str, Any] = msgspec.field(default_factory=dict)  # of a teleoperation: its state, JSON


class Describe(Message, frozen=True):
    pass


class GetMesh(Message, frozen=True):
    """Ask the root whether the robot is on the mesh."""


class OnMesh(Message, frozen=True):
    problem: str = ""  # empty: it is


class ActorInfo(Message, frozen=True):
    address: str
    role: str
    pid: int
    state: str
    restarts: int


class ProcessInfo(Message, frozen=True):
    role: str
    pid: int
    restarts: int


class Introspection(Message, frozen=True):
    """The actors of one process."""

    pid: int
    actors: tuple[ActorInfo, ...]


class TreeReport(Message, frozen=True):
    robot: str
    state: str
    epoch: int
    processes: tuple[ProcessInfo, ...]
    actors: tuple[ActorInfo, ...]
    last_stop: StopReport | None = None  # by the root's own path


# -- for who records


class Happened(Message, frozen=True):
    """What no message between actors says: a process was started or has ended."""

    what: str
    detail: str = ""
    pid: int = 0
