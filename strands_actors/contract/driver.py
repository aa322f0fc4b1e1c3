"""The driver contract: what the author of a driver writes.

A driver *declares*; it never loops, sleeps, retries or keeps anything alive. It is four things:

``Driver``      pure: the robots it serves, axes and units, gates, table of fallbacks, timing. Built in the caller,
                in the wire process and in the root process from the same plain options.
``Wire``        (``wire.py``) the I/O, in the wire process only, used by one actor (the transport), call by call.
``StopChannel`` (``wire.py``) how the root reaches the hardware when the wire process is gone;
                ``stop_channels`` and ``stop_process`` have five kinds ready made.
a twin          the robot's side of the wire (see ``drivers/common/twin/``).

The tree around it does the rest: lease, epoch, lifetimes, re-send, stop, restart.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .axis import Axis, AxisMode, Part, axes_of, finite, first_target, parse_action
from .loading import load
from .positions import SUFFIX
from .safe_state import SafeState
from .sensors import ReadOnlyJoint, Sensor
from .tool_verbs import SENSORS, STATUS, STOP, ToolVerb
from .wire import Observation, StopChannel, Wire


class Reason(enum.StrEnum):
    """Why the robot is asked to be safe. A driver's table of fallbacks maps each to a safe
    state."""

    EXPIRED = "expired"  # a streamed setpoint outlived its lifetime
    LEASE = "lease"  # the caller stopped answering
    POLICY = "policy"  # the policy died, froze or raised
    STOP = "stop"
    ESTOP = "estop"
    CLEANUP = "cleanup"
    CALLER = "caller"  # the caller's process ended
    WIRE = "wire"  # the wire process died or stopped answering
    ROOT = "root"  # the root process died or stopped answering
    LINK = "link"  # the cable, the socket, the bus
    FAULT = "fault"  # the restart budget is spent, an actor broke, or the robot may not be commanded any more


HOLDING_REASONS = frozenset({Reason.EXPIRED, Reason.LEASE, Reason.POLICY})
"""Reasons after which a position robot stays energised (DESIGN: which reason does what)."""

ORDERED = frozenset({Reason.STOP, Reason.ESTOP})
"""Somebody wants it stopped, whatever is known of it; the other reasons are for what the tree itself
sees."""


class Timing(msgspec.Struct, frozen=True):
    """The clocks of one wire. The lifetime (what the writer promised) and the keepalive (what the
    firmware needs) are different numbers."""

    control_hz: float
    keepalive_s: float  # period of re-sending the last live setpoint
    stream_ttl_s: float = 0.1  # lifetime of a streamed setpoint
    oneshot_ttl_s: float | None = None  # of a single send_action; None: latched while the lease lives
    state_ttl_s: float = 0.3  # an observation older than this is no observation
    arm_s: float = 2.0  # longest time that ``Wire.arm`` may take
    # In ``Wire.open`` and ``arm`` the whole wire process may be silent for so long: an SDK's
    # constructor keeps the interpreter's lock. So long the root waits before it calls the process
    # frozen.
    silent_s: float = 0.0
    tick_s: float = 0.01  # how often the tree looks at deadlines, and wire and root beat
    heartbeat_ttl_s: float = 0.1  # without a heartbeat for so long, the other process counts as frozen
    # Longest time that ``Wire.read``, ``write`` or ``feed`` may wait, where that is longer than a
    # heartbeat: it is announced to the watchdog, and who takes longer counts as frozen. 0: they
    # wait less than a heartbeat.
    call_s: float = 0.0
    open_s: float = 5.0  # longest time that ``Wire.open`` and the first reading may take, and the stop channel's
    handover_s: float = 3.0  # of these: what the root may take to have its stop channel ready
    safe_s: float = 1.5  # longest time that ``make_safe`` may take: the wire's, and the stop channel's
    # Longest time for which an arming that was cut off (a stop cancelled it, its process was killed)
    # may still take effect on the robot: the request is in a buffer, in the network, or the robot
    # has taken it and acts on it later. No stop is confirmed before this time has passed. 0: the
    # robot carries out what arrives at once and in order, so the safe frame is always the last.
    late_s: float = 0.0


class Service(msgspec.Struct, frozen=True):
    """Something a robot can do beyond the common verbs: a method of its handle. ``arguments``: name
    to default."""

    about: str
    within_s: float  # longest time that ``Wire.perform`` may take
    arguments: Mapping[str, Any] = msgspec.field(default_factory=dict)
    counts: Mapping[str, int] = msgspec.field(default_factory=dict)  # arguments that are whole: 1 to so many
    in_motion: bool = False  # may be asked for while a target stands
    # It moves the robot: refused whenever a setpoint would be for the robot's state, and what it
    # began is live as a latched setpoint is, until a stop or the end of the lease. An older target
    # is not sent again.
    moves: bool = False
    # It ends what is live, which it may be asked in the middle of: an older target is not sent again.
    # No condition refuses it, as a landing must not be refused for a low battery.
    ends_motion: bool = False
    # It gives motors power, lets go of them, or has them move by themselves afterwards: motion for
    # whoever is not the robot's own program, also where ``moves`` would refuse it (to a robot that
    # is not armed yet).
    powers: bool = False
    # Refused to a robot that is not armed, as a setpoint is: after a stop only ``resume`` lets it go
    # on, also where a stopped robot keeps its power. For what ``moves`` this is so anyway.
    needs_armed: bool = False
    # As ``Timing.late_s``, of this service: it powers or moves the robot, and may do so later.
    late_s: float = 0.0
    # No service of the wire's, but a command: its arguments are an action, with the lifetime and the
    # gates of one. An argument whose default is None is left out of it unless it is given.
    acts: bool = False
    # No service of the wire's, but an order to stop for this reason, which locks as an e-stop does:
    # never refused, ahead of everything, and carried out by whoever is left.
    stops: Reason | None = None


class Live(msgspec.Struct, frozen=True, gc=False):
    """A target that the robot follows. ``until_ns``: when it ends; None: it is latched, and ends with
    its writer's lease."""

    until_ns: int | None = None

    @property
    def latched(self) -> bool:
        return self.until_ns is None

    def over(self, now_ns: int) -> bool:
        """Return whether its time has passed."""
        return self.until_ns is not None and now_ns >= self.until_ns


class GateState(msgspec.Struct, frozen=True, gc=False):
    """What a gate may look at. Pure data: a gate knows no clock and no I/O."""

    now_ns: int
    observation: Observation
    target: tuple[float, ...]  # the last accepted target, or the measured position after arming
    target_ns: int  # when that was accepted
    stream: bool  # part of a stream of setpoints, whose period is known
    period_s: float = 0.0  # the stream's period; 0 for a one-shot
    live: Live | None = None  # None: the robot follows no target


class Candidate(msgspec.Struct, frozen=True, gc=False):
    """An action on its way through the gates."""

    values: tuple[float, ...]  # the whole target, axis order; then what modifies it, where there is such
    named: tuple[int, ...]  # indices of the axes the action names
    until_ns: int = 0  # it ends then at the latest: it goes on with motion that was promised so long; 0: its own


GateCheck = Callable[[Candidate, GateState], Refused | None]

ConditionCheck = Callable[[Observation, int], Refused | None]
"""Refuses when something is not true of the robot: from the newest observation and now_ns. Pure."""


class OnResume(enum.StrEnum):
    """What ``resume()`` of an armed robot does when a condition is broken."""

    REFUSE = "refuse"  # somebody has to mend it first, as the refusal says; no stop of ours breaks it
    ARM_ANEW = "arm anew"  # arming mends it: the robot is stopped, then armed
    STAY_ARMED = "stay armed"  # one of the robot's services mends it: take off, stand up


class Condition(msgspec.Struct, frozen=True):
    """What must be true of the robot, whatever it is told, and what is done when it no longer is.

    Each has a fallback of its own: a drone with a low battery lands, one whose link is weak
    hovers. A driver lists the most specific one first: the first that is broken is the cause that
    people are told."""

    check: ConditionCheck
    reason: Reason = Reason.FAULT
    safe_state: SafeState | None = None  # None: what the driver's table has for ``reason``
    always: bool = False  # looked at while the robot is energised, not only while a setpoint is live
    on_resume: OnResume = OnResume.REFUSE
    is_silence: bool = False  # it only says that the robot is not heard: any other cause is more specific


class Driver(ABC):
    """One robot of one wire, as data and pure functions."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]]
    ALIASES: ClassVar[Mapping[str, str]] = {}
    """Other names to robots of ``SUPPORTED_ROBOTS``."""
    PORT_KIND: ClassVar[Literal["serial", "address"]]
    PORT_OPTIONAL: ClassVar[bool] = False
    """Whether the robot can be driven without ``port``: it speaks first, and whoever does is it."""
    PORT_LIKE: ClassVar[str] = "192.0.2.10"
    """An address as this robot's are written, for who left it out."""
    TOLD_APART_BY: ClassVar[tuple[str, ...]] = ()
    """Options by which several robots at one address are told apart: units behind a gateway."""
    TRANSPORTS: ClassVar[tuple[str, ...]] = ("twin",)
    WIRE: ClassVar[str] = ""
    """``module:class`` of the wire, made as ``class(config, clock)``. A name: only the wire process
    imports it."""
    STOP_CHANNEL: ClassVar[str] = ""
    """``module:class`` of the stop channel, made as ``class(config, descriptors, clock)``."""
    TWIN: ClassVar[str]
    """``module:function`` that serves the twin."""
    OPTIONS: ClassVar[Mapping[str, str]] = {}
    """Constructor keywords beyond ``port``, with what each means."""
    SPELLINGS: ClassVar[Mapping[str, str]] = {}
    """Other names of those keywords, as the drivers page has them: ``baud_rate`` for ``baud``."""
    SECRETS: ClassVar[frozenset[str]] = frozenset()
    """Those of them that are in no recording, no certificate and no answer: passwords."""
    USB_IDS: ClassVar[tuple[tuple[int, int], ...]] = ()
    """Vendor and product of the USB adapters that this wire is usually behind. A hint, no proof."""
    CAMERAS: ClassVar[Mapping[str, str]] = {}
    """Pictures that the robot's own service gives, by name: ``module:function`` of what opens them
    (``contract/cameras.py``)."""
    ROLLOUTS: ClassVar[str] = ""
    """Why this robot runs no policies; empty: it does."""
    TASKS: ClassVar[str] = ""
    """Why this robot runs no policy in a process of its own; empty: it does."""
    EXPERIMENTAL: ClassVar[Mapping[str, str]] = {}
    """Ways to this robot that nobody has seen on a real one, and what each was tried with. A driver
    that takes one says so in its ``caveats`` (``experimental``)."""
    SIMULATION: ClassVar[str] = ""
    """Why there is no simulation of this robot; empty: there is."""
    SIMULATED: ClassVar[bool] = False
    """Whether it drives a simulation: nobody's approval is needed for it."""
    SIMULATED_ROWS: ClassVar[int] = 1
    """How many numbers per axis a target of ``parse_simulated`` has, row by row."""
    WHOLE_ACTIONS: ClassVar[bool] = False
    """Whether its gates want every axis named: an arm that is only moved as a whole."""
    SERVICES: ClassVar[Mapping[str, Service]] = {}
    """What this robot can do beyond the common verbs: methods of its handle, by name."""
    BEFORE_MOTION: ClassVar[str] = ""
    """Which of them must have been done, after each resume, before the robot takes commands: take
    off, stand up. Empty: none. A drill and the kill matrix do it, too."""
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (SENSORS, STATUS, STOP)
    """What an agent, an MCP client or a command from the mesh may ask."""
    SENSORS: ClassVar[tuple[Sensor, ...]] = ()
    """What the robot has beyond its axes, and where it is published; the rest of what is read is in
    ``health``."""
    READ_ONLY_JOINTS: ClassVar[tuple[ReadOnlyJoint, ...]] = ()
    """Joints that are observed beside the axes, and that no action may name."""
    ANSWERS_WITH: ClassVar[tuple[str, ...]] = ()
    """Sensors whose newest reading goes with the answer to an accepted command (``accepted``)."""
    GUARDED: ClassVar[tuple[str, ...]] = ()
    """Verbs, and keys of an action, that those may use only with an operator's approval. A stop
    never needs one, nor does a zero of a velocity axis."""
    TOPICS: ClassVar[Mapping[str, str]] = {}
    """Guarded keys that go out on a ROS topic, and which: who has approved the topic has approved
    them."""

    robot: str
    parts: tuple[Part, ...] = ()
    """The axes as data. ``declare`` takes them; a driver of another kind sets ``axes`` and ``ids``
    itself."""
    axes: tuple[str, ...]
    ids: tuple[int, ...]  # motor id per axis
    table: tuple[Axis, ...] = ()
    unit: str  # for people: "degrees (gripper: percent open)"
    timing: Timing
    fallbacks: Mapping[Reason, SafeState]
    firmware_watchdog: str  # what the firmware does alone when all of us are gone
    bound_s: float = 0.05  # published: from a death to the safe frame
    config: Any
    """What ``WIRE`` and ``STOP_CHANNEL`` know of the robot: a frozen struct. Neither is given the
    driver itself."""
    gates: tuple[GateCheck, ...]
    caveats: tuple[str, ...] = ()
    """What its user should know of this robot when it is connected: in the log, and in status."""
    conditions: tuple[Condition, ...] = ()
    """Asked before the gates, and at every tick while a setpoint is live: it ends when one of them
    refuses. Those that are ``always`` looked at also end a hold."""

    LEVELS: ClassVar[Mapping[str, str]] = {}
    """Robots of this driver that can be commanded in another way, too, by another driver:
    ``robot:level`` to its ``module:class``. The option ``level`` chooses it; the kill matrix calls it
    by that name."""

    @classmethod
    def at_level(cls, robot: str, options: Mapping[str, Any]) -> type[Driver]:
        """Return the driver that is chosen by the option ``level``: one of ``LEVELS``, or this
        one."""
        where = cls.LEVELS.get(f"{robot}:{options.get('level')}")
        return cls if where is None else load(where)

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Runs once, in the caller: check keywords, read files, return plain options for
        ``__init__``. Raise ``ValueError`` or ``TypeError`` with what would be accepted."""
        return dict(options)

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        """Return the services of a robot that was resolved to these options."""
        return cls.SERVICES

    @classmethod
    async def complete(cls, robot: str, port: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Runs in the caller, before the tree is started: return the options with what only the
        robot, or a process that may be killed, can tell. Asked again, it changes nothing. Raise
        ``WireDown``."""
        return dict(options)

    @abstractmethod
    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None: ...

    def check_port(self) -> None:  # noqa: B027  # a default that accepts
        """Raise ``ValueError`` for a port whose form is none of this robot's, with what would be
        accepted. Asked in the caller when a robot is made with ``port``; nothing is opened. Default:
        any will do."""

    @property
    def late_s(self) -> float:
        """Return the longest time for which anything that was cut off may still take effect."""
        return max((self.timing.late_s, *(service.late_s for service in self.SERVICES.values())))

    def declare(self, *parts: Part) -> None:
        """Take the axes of the parts: names, ids, parsing and the first target follow from them."""
        self.parts = parts
        self.table = axes_of(parts)
        self.axes = tuple(axis.key for axis in self.table)
        self.ids = tuple(axis.id for axis in self.table)
        self._index = {key: at for at, key in enumerate(self.axes)}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the whole target: position axes that are not named keep ``state.target``, velocity
        axes rest."""
        parsed = parse_action(action, self.robot, self.table, self._index, state.target)
        return parsed if isinstance(parsed, Refused) else Candidate(*parsed)

    def parse_simulated(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """As ``parse``, for the twin's body at its simulation control, which may take more than the
        wire does (``aim`` of that body). Default: the same."""
        return self.parse(action, state)

    def to_approve(self, action: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of an action that may need approval: all but velocities at rest, which
        stop the robot."""
        at_rest = {axis.key: axis.rest for axis in self.table if axis.mode is AxisMode.VELOCITY}
        keys = ((key, str(key).removesuffix(".pos")) for key in action)
        return tuple(plain for key, plain in keys if plain not in at_rest or finite(action[key]) != at_rest[plain])

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return the target from which a robot that was just armed goes on: the measured position,
        so that nothing jumps, and rest for velocity axes, so that nothing drives off."""
        return first_target(self.table, observation.position) if self.parts else observation.position

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        """Pure. Only names and arguments that ``SERVICES`` declares pass, and counts that are
        some."""
        known = self.SERVICES.get(service)
        if known is None:
            names = ", ".join(self.SERVICES) or "none"
            return Refused(
                Code.UNKNOWN_SERVICE, f"{self.robot} has no such service", f"it has {names}", service, names
            )
        for name in arguments:
            if name not in known.arguments:
                names = ", ".join(known.arguments) or "none"
                return Refused(Code.UNKNOWN_ARGUMENT, f"no argument {name}", f"it takes {names}", name, names)
        for name, most in known.counts.items():
            value = arguments.get(name, known.arguments[name])
            if not _is_count(value, most):
                why, limit = f"{name} is {value!r}", f"1..{most}"
                return Refused(Code.BAD_ARGUMENT, why, f"give a whole number, 1 to {most}", f"{value}", limit)
        return None

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        """Return the command that a verb with these inputs is, for verbs in other units than the
        axes'. Pure. Default: as ``ToolVerb`` says."""
        return verb.command(inputs)

    def preload(self) -> None:
        """Import what ``stop_channel`` needs. Called in the root and in the wire process before
        they begin to beat: on a busy machine an import takes longer than they may be silent."""
        if self.STOP_CHANNEL:
            load(self.STOP_CHANNEL)

    def preload_wire(self) -> None:
        """Import what ``open_wire`` needs. Called in the wire process alone: the root is spared
        SDKs."""
        if self.WIRE:
            load(self.WIRE)

    def open_wire(self, clock: Clock) -> Wire:
        """Return the wire, not yet opened."""
        wire: Wire = load(self.WIRE)(self.config, clock)
        return wire

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        """Return the root's way to the hardware, from what ``Wire.handover`` gave. ``descriptors``
        empty: nothing was handed over, or it was closed since; then the path opens what it needs by
        itself, when it is used."""
        channel: StopChannel = load(self.STOP_CHANNEL)(self.config, descriptors, clock)
        return channel

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return a row in axis order as the public keys."""
        return dict(zip(self.axes, values, strict=True))

    def experimental(self, way: str) -> str:
        """Return what is said of a way of ``EXPERIMENTAL``."""
        return f"{way} is experimental: {self.EXPERIMENTAL[way]}"

    def observed(self, observation: Observation) -> dict[str, float]:
        """Return where the robot is, by public key: its axes, and its read-only joints that were read."""
        rows = {joint.key: observation.sensors.get(joint.sensor) for joint in self.READ_ONLY_JOINTS}
        return self.as_json(observation.position) | {key: row[0] for key, row in rows.items() if row}

    def as_telemetry(self, observation: Observation) -> dict[str, float]:
        """``observed`` for other hosts: a position stands under ``x`` and under ``x.pos``, since a
        reader of JSON cannot ask for the other."""
        told = self.observed(observation)
        rates = {axis.key for axis in self.table if axis.mode is AxisMode.VELOCITY}
        return told | {f"{key}{SUFFIX}": value for key, value in told.items() if key not in rates}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """Return what ``send_action`` answers: an accepted action and the target it became."""
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"commanded": {key: target[key] for key in target if key in named}, "unit": self.unit}

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        """Return what ``send_action`` answers: ``commanded``, and what the driver makes of
        ``sensors``, those of ``ANSWERS_WITH`` as they were last read."""
        return self.commanded(action, values)

    def timed(
        self, targets: Mapping[str, Any], seconds: float, observation: Observation
    ) -> dict[str, Any] | Refused | None:
        """Return the command by which the robot itself goes to ``targets`` in so many seconds, for one
        that plans its motions. None: it is sent a path of small steps. Default: None."""
        return None

    def readings(self, observation: Observation) -> dict[str, Any]:
        """Return what ``state`` and ``status`` say of the robot beside its positions and
        velocities, in the words of its users: a pose, a charge, a mode by its name. JSON."""
        return {}

    def model_units(self) -> tuple[tuple[float, float], ...]:
        """Per axis (zero, scale): ``value = zero + scale * m``, where ``m`` is the joint in the
        twin's model, radians or metres. Default: the same."""
        return ((0.0, 1.0),) * len(self.axes)

    def travel(self) -> dict[str, tuple[float, float]]:
        """Return each axis' range as its calibration found it, in the driver's units, lower end
        first. Empty when there is no calibration; default: there is none."""
        return {}

    def energised(self, safe_state: SafeState) -> bool:
        """Return whether the robot stays ready in this state, so that the next setpoint moves it
        again: motors keep torque, or a base stands at velocity zero."""
        return safe_state in (SafeState.HOLD, SafeState.ZERO)


def _is_count(value: object, most: int) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 1 <= value <= most and value == int(value)
