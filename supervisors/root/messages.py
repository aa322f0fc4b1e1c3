"""What the root's actors are told and asked, and what they answer: the guardian, the root itself,
the tasks."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import StopReport


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


class Handover(Message, frozen=True):
    """Descriptors for the stop channels of root and standby. They travel with the message.
    ``again``: for a standby that was started since; the root has its own."""

    lane = "urgent"

    descriptors: tuple[int, ...]
    again: bool = False


class HandedOver(Message, frozen=True):
    pass


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
    """What a policy actor needs to run: until its steps are done or its duration is over, whichever
    comes first. ``over``: the caller's lease it writes under."""

    robot: str
    axes: tuple[str, ...]
    instruction: str
    period_s: float
    ttl_s: float
    duration_s: float  # infinite: until the steps are done
    n_steps: int = 0  # 0: until the duration ends
    over: int = 0
    table: tuple[Axis, ...] = ()
    """What each axis can do, for a policy that asks for it."""
    keeps: bool = False
    """Whether its last step is a command on its own, which stands afterwards as one of the caller's."""


START_TASK = "start_task"
"""The verb of ``StartTask``."""


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


class EpisodeKey(Message, frozen=True):
    """The operator of a teleoperation presses a key of the recorder's, who hears of it in the
    root's journal. ``word``: as ``record --dataset`` takes it; ``t_ns``: when it was pressed."""

    t_ns: int
    word: str


class EpisodeState(Message, frozen=True):
    """A recorder of episodes tells the operator of a teleoperation how far it is: at each change,
    and once a second. ``running``: an episode; ``text``: its line of progress; ``said``: what
    happened last."""

    lane = "latest"

    running: bool = False
    text: str = ""
    said: str = ""


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
    channel: str = ""


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
    locked_by: str = ""  # who e-stopped it


class Happened(Message, frozen=True):
    """What no message between actors says: a process was started or has ended."""

    what: str
    detail: str = ""
    pid: int = 0
