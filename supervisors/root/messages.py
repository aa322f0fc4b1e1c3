"""Messages to the actors of the root (guardian, root, tasks), and their replies."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import StopReport


class Renew(Message, frozen=True):
    """A request of the wire process to be replaced, because a call of its SDK hangs."""

    lane = "urgent"

    cause: str


class SilentUntil(Message, frozen=True):
    """A message of the wire process: it may send no heartbeat until this time, because a library holds the
    interpreter's lock. 0 means that this is over. The root accepts at most ``Timing.silent_s``."""

    lane = "urgent"

    until_ns: int


class StateIs(Message, frozen=True):
    """The gate's failsafe state, sent at each change. A restarted wire process continues from it."""

    lane = "urgent"

    mode: str
    epoch: int
    locked_by: str
    cause: str


class Decided(Message, frozen=True):
    """A decision of the gate, for the audit: the sender, the request, the decision, and the link on which the
    request came."""

    sender: str
    order: str
    result: str
    over: str = ""


class RecorderGap(Message, frozen=True):
    """A recording of the wire process has a gap, because its recorder was too slow.

    ``missed`` is the number of events that are missing.
    """

    missed: int


class GetState(Message, frozen=True):
    """Ask the guardian for the failsafe state. The host of a robot checks by the answer that the guardian runs."""


class Handover(Message, frozen=True):
    """File descriptors for the stop channels of root and standby. ``again`` is True if they are only for a new
    standby."""

    lane = "urgent"

    descriptors: tuple[int, ...]
    again: bool = False


class HandedOver(Message, frozen=True):
    pass


class Fence(Message, frozen=True):
    """Kill the wire process, and stop the robot by the root's own connection. This is sent after a stop that the
    gate did not answer."""

    lane = "urgent"

    reason: Reason
    by: str = ""
    lock: bool = False


class Shutdown(Message, frozen=True):
    """Stop the robot, then end all its processes."""

    lane = "urgent"

    reason: Reason
    by: str = ""


class Rollout(Message, frozen=True):
    """The settings for one run of a policy. It ends after its steps or its duration.

    Attributes:
        robot: Name of the robot.
        axes: Axes of the robot.
        instruction: The task, for the policy and for people.
        period_s: Time between two setpoints.
        ttl_s: Lifetime of a setpoint.
        duration_s: Longest duration; infinite for no limit.
        n_steps: Number of steps; 0 for no limit.
        over: The lease of the caller. The policy gets its own lease under it.
        table: The data of each axis, for a policy that needs it.
        keeps: True if the last setpoint stays in force after the run, under the caller's lease.
        load_s: Longest time until the first action, in seconds. ``duration_s`` then counts from the first action.
            0: it counts from the start.
        max_age_s: Largest age of the reading from which an action was computed, when the action is sent, in
            seconds. An older one is never sent, and ends the run. 0 for no limit.
        driver: The description of the driver (``supervisors/loading``), for actions with a pose of the tool. Empty:
            such actions are refused.
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
    load_s: float = 0.0
    max_age_s: float = 0.0
    driver: dict[str, Any] = msgspec.field(default_factory=dict)


START_TASK = "start_task"
"""The verb of ``StartTask``."""


class StartTask(Message, frozen=True):
    """Run a policy in a separate process.

    Attributes:
        provider: ``module:factory`` of the policy.
        options: Keyword arguments of the factory.
        rollout: The settings of the run.
        deadline_ns: The process does nothing if it has not begun by this time; 0 for no deadline.
        is_actor: True if the factory makes an actor that sends the setpoints itself. It is called as
            ``factory(rollout, report, **options)``.
        teleop: For a teleoperation: its state as JSON, until its process reports one.
    """

    provider: str
    options: dict[str, Any]
    rollout: Rollout
    deadline_ns: int = 0
    is_actor: bool = False
    teleop: dict[str, Any] = msgspec.field(default_factory=dict)


class Operate(Message, frozen=True):
    """The input of an operator in a teleoperation: the dead-man switch, and the speed of each axis from -1 to 1. It
    is valid for a moment only, so it must be sent again and again."""

    lane = "latest"

    t_ns: int
    held: bool
    rates: dict[str, float] = msgspec.field(default_factory=dict)


class EpisodeKey(Message, frozen=True):
    """A key of the dataset recorder that the operator of a teleoperation has pressed. The recorder reads it in the
    journal of the root process. ``word`` is a command of ``record --dataset``, and ``t_ns`` is the time of the
    key."""

    t_ns: int
    word: str


class EpisodeState(Message, frozen=True):
    """The progress of a dataset recorder, for the operator of a teleoperation. It is sent at each change and once a
    second.

    Attributes:
        running: True while an episode is recorded.
        text: One line about the progress.
        last_event: The last event as text.
    """

    lane = "latest"

    running: bool = False
    text: str = ""
    last_event: str = ""


class StopTask(Message, frozen=True):
    lane = "urgent"


class GetTask(Message, frozen=True):
    pass


class TaskStatus(Message, frozen=True):
    """The status of the last policy run. ``exit_reason`` is stopped, n_steps, duration, policy, gate, publish,
    stop, cleanup or refused; empty while it runs and before the first run. ``action_age_s`` is the largest age of a
    reading from which a sent action was computed, at the time when it was sent."""

    lane = "latest"

    running: bool = False
    steps: int = 0
    elapsed_s: float = 0.0
    exit_reason: str = ""
    exit_detail: str = ""
    refusal: str = ""
    instruction: str = ""
    hz: float = 0.0
    teleop: dict[str, Any] = msgspec.field(default_factory=dict)  # for a teleoperation: its state as JSON
    action_age_s: float = 0.0


class Describe(Message, frozen=True):
    channel: str = ""


class AttachProgram(Message, frozen=True):
    """Ask the root of a robot that a host keeps for everything that a program needs to command the robot.

    Attributes:
        pid: Id of the program's process on this host. When it ends or is suspended, its lease ends at once. 0: the
            program only asks.
    """

    pid: int = 0


class Hosted(Message, frozen=True):
    """The answer to ``AttachProgram``: the settings that the host gives to a handle of the robot, as plain data."""

    settings: dict[str, Any]


class GetMesh(Message, frozen=True):
    """Ask the root process whether the robot is on the mesh."""


class OnMesh(Message, frozen=True):
    problem: str = ""  # why the robot is not on the mesh; empty if it is


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
    """Describes the actors of one process."""

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
    last_stop: StopReport | None = None  # last stop that the root made over its own connection
    locked_by: str = ""  # operator of the e-stop that locks the robot; empty if it is not locked


class Happened(Message, frozen=True):
    """An event in a recording that no message between actors shows: a process was started or has ended."""

    event: str
    detail: str = ""
    pid: int = 0
