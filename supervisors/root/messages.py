"""Messages to the actors of the root (guardian, root, tasks), and their replies."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import StopReport


class Renew(Message, frozen=True):
    """A request of the wire for a new process, because its SDK hangs."""

    lane = "urgent"

    why: str


class SilentUntil(Message, frozen=True):
    """Until then the wire process may send no heartbeat, because an SDK keeps the interpreter's lock; 0
    when that is over. The root accepts ``Timing.silent_s`` at most."""

    lane = "urgent"

    until_ns: int


class StateIs(Message, frozen=True):
    """The gate's failsafe state, sent at each change. A restarted wire continues from it."""

    lane = "urgent"

    mode: str
    epoch: int
    locked_by: str
    cause: str


class Decided(Message, frozen=True):
    """A decision of the gate, for the audit: sender, request, answer, and the name of its channel."""

    who: str
    what: str
    how: str
    over: str = ""


class Handover(Message, frozen=True):
    """Descriptors for the stop channels of root and standby. ``again`` is true if they are for a new
    standby only."""

    lane = "urgent"

    descriptors: tuple[int, ...]
    again: bool = False


class HandedOver(Message, frozen=True):
    pass


class Fence(Message, frozen=True):
    """Fence the wire process and stop the robot by the stop channel, after a stop without an answer."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False


class Shutdown(Message, frozen=True):
    """Stop the robot, then end the whole tree."""

    lane = "urgent"

    reason: Reason
    by: str = ""


class Rollout(Message, frozen=True):
    """The parameters of a rollout. It ends after its steps or its duration.

    Attributes:
        robot: The robot's name.
        axes: Its axes.
        instruction: The task, for the policy and for people.
        period_s: Time between two setpoints.
        ttl_s: Lifetime of a setpoint.
        duration_s: Longest duration; infinite for none.
        n_steps: Number of steps; 0 for no limit.
        over: The caller's lease under which it writes.
        table: The data of each axis, for a policy that asks for it.
        keeps: True if its last setpoint is a single command, which stays in force afterwards under the
            caller's lease.
    """

    robot: str
    axes: tuple[str, ...]
    instruction: str
    period_s: float
    ttl_s: float
    duration_s: float
    n_steps: int = 0
    over: int = 0
    table: tuple[Axis, ...] = ()
    keeps: bool = False


START_TASK = "start_task"
"""The verb of ``StartTask``."""


class StartTask(Message, frozen=True):
    """Run a policy in a separate process.

    Attributes:
        provider: ``module:factory``.
        options: Keywords of the factory.
        rollout: The parameters.
        deadline_ns: If the process has not begun by then it does nothing; 0 for no deadline.
        is_actor: The factory makes an actor that sends the setpoints itself, as ``factory(rollout,
            report, **options)``.
    """

    provider: str
    options: dict[str, Any]
    rollout: Rollout
    deadline_ns: int = 0
    is_actor: bool = False


class Operate(Message, frozen=True):
    """The input of an operator for a teleoperation: the dead-man switch, and the speed of each axis from
    -1 to 1. It is valid for a moment and has to be sent again and again."""

    lane = "latest"

    t_ns: int
    held: bool
    rates: dict[str, float] = msgspec.field(default_factory=dict)


class EpisodeKey(Message, frozen=True):
    """A key of the recorder that the operator of a teleoperation has pressed. The recorder reads it in the
    root's journal. ``word`` is a word of ``record --dataset``, ``t_ns`` the time of the key."""

    t_ns: int
    word: str


class EpisodeState(Message, frozen=True):
    """The progress of an episode recorder, for the operator of a teleoperation; sent at each change and
    once a second.

    Attributes:
        running: An episode is being recorded.
        text: The line of progress.
        said: The last event.
    """

    lane = "latest"

    running: bool = False
    text: str = ""
    said: str = ""


class StopTask(Message, frozen=True):
    lane = "urgent"


class GetTask(Message, frozen=True):
    pass


class TaskStatus(Message, frozen=True):
    """The status of the last task. ``exit_reason`` is stopped, n_steps, duration, policy, gate, publish,
    stop, cleanup or refused; empty while it runs and before the first task."""

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
    problem: str = ""  # why it is not; empty if it is


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


UNREACHABLE = "unreachable"
"""The state in a ``TreeReport`` of a robot that does not answer, or is not connected."""


class TreeReport(Message, frozen=True):
    robot: str
    state: str
    epoch: int
    processes: tuple[ProcessInfo, ...]
    actors: tuple[ActorInfo, ...]
    last_stop: StopReport | None = None  # the last stop by the root's stop channel
    locked_by: str = ""  # the operator of an e-stop


class Happened(Message, frozen=True):
    """An event that is in no message between actors: a process was started or has ended."""

    what: str
    detail: str = ""
    pid: int = 0
