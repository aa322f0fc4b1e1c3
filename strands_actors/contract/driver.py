"""The driver contract: the classes that the author of a driver writes.

A driver declares the robot. It never loops, sleeps or retries. It has four parts:

``Driver``      Pure data and functions: robots, axes and units, gates, safe states, timing. It is built in
                the caller, the wire process and the root process from the same plain options.
``Wire``        All I/O (``wire.py``). Only the transport in the wire process calls it.
``StopChannel`` The root's way to the hardware when the wire process is gone (``wire.py``). ``stop_channels``
                and ``stop_process`` have five ready-made kinds.
a twin          The robot's side of the wire, as a process (``drivers/common/twin/``).

The tree does the rest: leases, epochs, lifetimes, re-sending, stops and restarts.
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
    """Why the robot has to be in a safe state. A driver's table of fallbacks maps each reason to one."""

    EXPIRED = "expired"  # the lifetime of a setpoint has ended
    LEASE = "lease"  # the caller sends no heartbeats, or has released its lease
    POLICY = "policy"  # the policy died, froze or raised
    STOP = "stop"
    ESTOP = "estop"
    CLEANUP = "cleanup"
    CALLER = "caller"  # the caller's process ended
    WIRE = "wire"  # the wire process died or stopped answering
    ROOT = "root"  # the root process died or stopped answering
    LINK = "link"  # the cable, socket or bus was lost
    FAULT = "fault"  # a broken condition of the robot, a failed hold or arming, too many restarts


HOLDING_REASONS = frozenset({Reason.EXPIRED, Reason.LEASE, Reason.POLICY})
"""Reasons after which a robot that can hold its position stays energised."""

ORDERED = frozenset({Reason.STOP, Reason.ESTOP})
"""Reasons that a person or a program may order. The tree itself uses the others."""


class Timing(msgspec.Struct, frozen=True):
    """The times of one wire.

    The lifetime (promised by the writer) and the keepalive (needed by the firmware) are different numbers.
    """

    control_hz: float
    keepalive_s: float  # period of re-sending the last live setpoint
    stream_ttl_s: float = 0.1  # lifetime of a streamed setpoint
    oneshot_ttl_s: float | None = None  # of a single send_action; None: latched while the lease lives
    state_ttl_s: float = 0.3  # an observation older than this is no observation
    arm_s: float = 2.0  # longest time that ``Wire.arm`` may take
    # In ``Wire.open`` and ``arm`` the whole wire process may be silent for this time, because an SDK's
    # constructor keeps the interpreter's lock. The root waits so long before it counts the process as frozen.
    silent_s: float = 0.0
    tick_s: float = 0.01  # period in which the tree checks deadlines, and in which wire and root beat
    heartbeat_ttl_s: float = 0.1  # without a heartbeat for so long, the other process counts as frozen
    # Longest time that ``Wire.read``, ``write`` or ``feed`` may wait, where that is longer than a heartbeat.
    # The watchdog gets notice of it, and a longer call counts as frozen. 0 if they wait less than a heartbeat.
    call_s: float = 0.0
    open_s: float = 5.0  # longest time that ``Wire.open`` and the first reading may take, and the stop channel's
    handover_s: float = 3.0  # the part of it in which the root gets its stop channel ready
    safe_s: float = 1.5  # longest time that ``make_safe`` may take: the wire's, and the stop channel's
    # Longest time for which an arming that was cut off (cancelled by a stop, or its process was killed) may
    # still take effect on the robot. The request may be in a buffer or in the network, or the robot may act on
    # it later. No stop is confirmed before this time has passed. 0 if the robot carries out requests at once
    # and in order, so that the safe frame is always the last.
    late_s: float = 0.0


class Service(msgspec.Struct, frozen=True):
    """A service of a robot beyond the common verbs: a method of its handle.

    ``arguments`` maps names to defaults.
    """

    about: str
    within_s: float  # longest time that ``Wire.perform`` may take
    arguments: Mapping[str, Any] = msgspec.field(default_factory=dict)
    counts: Mapping[str, int] = msgspec.field(default_factory=dict)  # arguments that are whole: 1 to so many
    in_motion: bool = False  # it may run while a target is in force
    # It moves the robot. It is refused whenever a setpoint would be. Its motion counts as a latched
    # target, until a stop or the end of the lease. An older target is not sent again.
    moves: bool = False
    # It ends the present motion, and may be asked for during it. An older target is not sent again. No
    # condition refuses it: a landing must not be refused for a low battery.
    ends_motion: bool = False
    # It gives motors power, takes it away, or lets them move by themselves afterwards. For agents and
    # the mesh it counts as motion, even when the robot is not armed.
    powers: bool = False
    # It is refused when the robot is not armed, even if a stopped robot keeps its power. ``moves`` includes
    # that.
    needs_armed: bool = False
    # As ``Timing.late_s``, for a service that powers or moves the robot with a delay.
    late_s: float = 0.0
    # It is no service of the wire but a command. Its arguments are an action, with the lifetime and the
    # gates of one. An argument with the default None is left out of it unless it is given.
    acts: bool = False
    # It is no service of the wire but a stop for this reason, with a lock as of an e-stop. It is never
    # refused, and goes ahead of everything.
    stops: Reason | None = None


class Live(msgspec.Struct, frozen=True, gc=False):
    """A target that the robot follows.

    ``until_ns`` is its end; None if it is latched, and ends with the lease.
    """

    until_ns: int | None = None

    @property
    def latched(self) -> bool:
        """True if the target has no end by time, and ends with the lease."""
        return self.until_ns is None

    def over(self, now_ns: int) -> bool:
        """Return True if its end has passed."""
        return self.until_ns is not None and now_ns >= self.until_ns


class GateState(msgspec.Struct, frozen=True, gc=False):
    """The input of a gate. A gate is pure: without a clock and without I/O."""

    now_ns: int
    observation: Observation
    target: tuple[float, ...]  # the last accepted target, or the measured position after arming
    target_ns: int  # when the target was accepted
    stream: bool  # True if the setpoint is part of a stream
    period_s: float = 0.0  # period of the stream; 0 for a single command
    live: Live | None = None  # the target in force; None if there is none


class Candidate(msgspec.Struct, frozen=True, gc=False):
    """A parsed action, before the gates.

    Attributes:
        values: The target of every axis, in axis order, then modifiers that the driver adds.
        named: Indices of the axes that the action names.
        until_ns: Latest end, for an action that continues a motion with an earlier end; 0 for none.
    """

    values: tuple[float, ...]
    named: tuple[int, ...]
    until_ns: int = 0


GateCheck = Callable[[Candidate, GateState], Refused | None]

ConditionCheck = Callable[[Observation, int], Refused | None]
"""Return a refusal if a condition is broken, from the newest observation and the time (ns). Pure."""


class OnResume(enum.StrEnum):
    """The reaction of ``resume()`` of an armed robot to a broken condition."""

    REFUSE = "refuse"  # a person has to mend it first; our own stop does not break it
    ARM_ANEW = "arm anew"  # arming mends it, so the robot is stopped and armed
    STAY_ARMED = "stay armed"  # a service mends it: take off, stand up


class Condition(msgspec.Struct, frozen=True):
    """A condition that must be true while the robot is commanded, and its safe state.

    Each condition may have its own safe state: a drone with a low battery lands, one with a weak link
    hovers. A driver lists the most specific condition first, since the first broken one is shown as the
    cause.

    Attributes:
        check: The check.
        reason: The reason of the stop.
        safe_state: The safe state; None for the driver's one for ``reason``.
        always: Check it while the robot is energised, too, and not only while a target is in force.
        on_resume: The reaction of ``resume()``.
        is_silence: It only shows that the robot does not answer. Any other cause is more specific.
    """

    check: ConditionCheck
    reason: Reason = Reason.FAULT
    safe_state: SafeState | None = None
    always: bool = False
    on_resume: OnResume = OnResume.REFUSE
    is_silence: bool = False


class Driver(ABC):
    """One robot as data and pure functions.

    A subclass defines ``SUPPORTED_ROBOTS``, ``PORT_KIND``, ``WIRE`` and ``STOP_CHANNEL``, and ``TWIN`` if it has a
    twin. In place of ``WIRE`` and ``STOP_CHANNEL`` it may override ``open_wire`` and ``stop_channel``.

    Its constructor calls ``declare`` with the axes, and sets ``robot``, ``unit``, ``timing``, ``fallbacks``,
    ``firmware_watchdog``, ``config`` and ``gates``.

    Args:
        robot: The robot's name.
        port: Its serial port or address; empty if it was left out. It is not opened here.
        options: The plain options that ``resolve`` and ``complete`` have returned.
    """

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]]
    ALIASES: ClassVar[Mapping[str, str]] = {}
    """Other names of the robots in ``SUPPORTED_ROBOTS``."""
    PORT_KIND: ClassVar[Literal["serial", "address"]]
    PORT_OPTIONAL: ClassVar[bool] = False
    """True if ``port`` may be left out, because the robot sends first."""
    PORT_LIKE: ClassVar[str] = "192.0.2.10"
    """An example of this robot's addresses, for the refusal of a missing port."""
    TOLD_APART_BY: ClassVar[tuple[str, ...]] = ()
    """Options that distinguish several robots at one address, as units behind a gateway."""
    TRANSPORTS: ClassVar[tuple[str, ...]] = ("twin",)
    WIRE: ClassVar[str] = ""
    """``module:class`` of the wire, made as ``class(config, clock)``. It is a name, because only the wire
    process imports it."""
    STOP_CHANNEL: ClassVar[str] = ""
    """``module:class`` of the stop channel, made as ``class(config, descriptors, clock)``."""
    TWIN: ClassVar[str]
    """``module:function`` that serves the twin."""
    OPTIONS: ClassVar[Mapping[str, str]] = {}
    """Keywords of the constructor besides ``port``, and their meanings."""
    SPELLINGS: ClassVar[Mapping[str, str]] = {}
    """Other names of these keywords: ``baud_rate`` for ``baud``."""
    SECRETS: ClassVar[frozenset[str]] = frozenset()
    """The keywords that appear in no recording, certificate or reply: passwords."""
    USB_IDS: ClassVar[tuple[tuple[int, int], ...]] = ()
    """Vendor and product ids of the usual USB adapters. They are a hint and no proof."""
    CAMERAS: ClassVar[Mapping[str, str]] = {}
    """The robot's own cameras by name: ``module:function`` that opens one (``contract/cameras.py``)."""
    ROLLOUTS: ClassVar[str] = ""
    """Why this robot runs no policies; empty if it does."""
    TASKS: ClassVar[str] = ""
    """Why this robot runs no policies in a separate process; empty if it does."""
    EXPERIMENTAL: ClassVar[Mapping[str, str]] = {}
    """Ways to connect that were never tried on a real robot, and how each was tried. A driver that uses
    one adds ``experimental(way)`` to its ``caveats``."""
    SIMULATION: ClassVar[str] = ""
    """Why there is no simulation of this robot; empty if there is."""
    SIMULATED: ClassVar[bool] = False
    """True if it drives a simulation, for which no approval is needed."""
    SIMULATED_ROWS: ClassVar[int] = 1
    """Numbers per axis in a target of ``parse_simulated``, row by row."""
    WHOLE_ACTIONS: ClassVar[bool] = False
    """True if an action has to name every axis."""
    SERVICES: ClassVar[Mapping[str, Service]] = {}
    """Services of this robot by name. Each becomes a method of its handle."""
    BEFORE_MOTION: ClassVar[str] = ""
    """The service that has to run after each resume, before the robot takes commands: take off, stand
    up. Empty for none. Drills and the kill matrix run it, too."""
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (SENSORS, STATUS, STOP)
    """The verbs that agents, MCP clients and commands from the mesh may use."""
    SENSORS: ClassVar[tuple[Sensor, ...]] = ()
    """Sensors and the topics on which they are published. All other readings are in ``health``."""
    READ_ONLY_JOINTS: ClassVar[tuple[ReadOnlyJoint, ...]] = ()
    """Joints that are observed but not commanded."""
    ANSWERS_WITH: ClassVar[tuple[str, ...]] = ()
    """Sensors with readings that are part of the reply to an accepted command (``accepted``), the newest ones."""
    GUARDED: ClassVar[tuple[str, ...]] = ()
    """Verbs and keys of actions that need an operator's approval when an agent or the mesh uses them. A
    stop and the zero of a velocity axis never do."""
    TOPICS: ClassVar[Mapping[str, str]] = {}
    """The ROS topic of a guarded key. An approval of the topic approves the key."""

    robot: str
    parts: tuple[Part, ...] = ()
    """The axes as data, set by ``declare``. A driver without parts sets ``axes`` and ``ids`` itself."""
    axes: tuple[str, ...]
    ids: tuple[int, ...]  # motor id per axis
    table: tuple[Axis, ...] = ()
    unit: str  # for people: "degrees (gripper: percent open)"
    timing: Timing
    fallbacks: Mapping[Reason, SafeState]
    firmware_watchdog: str  # the reaction of the firmware when every process of the tree is gone
    bound_s: float = 0.05  # longest time from a death to the safe frame, a published bound
    config: Any
    """A frozen struct with everything that ``WIRE`` and ``STOP_CHANNEL`` know of the robot."""
    gates: tuple[GateCheck, ...]
    caveats: tuple[str, ...] = ()
    """Warnings for the user when the robot is connected. They stand in the log and in status."""
    conditions: tuple[Condition, ...] = ()
    """Checked before the gates, and at every tick while a target is in force. A broken one ends it. The
    conditions with ``always`` also end a hold."""

    LEVELS: ClassVar[Mapping[str, str]] = {}
    """Other drivers for robots of this one that can be commanded in two ways: ``robot:level`` to
    ``module:class``. The option ``level`` selects one. The kill matrix uses the same name."""

    @classmethod
    def at_level(cls, robot: str, options: Mapping[str, Any]) -> type[Driver]:
        """Return the driver for the option ``level``: one of ``LEVELS``, or this class."""
        where = cls.LEVELS.get(f"{robot}:{options.get('level')}")
        return cls if where is None else load(where)

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Check the keywords, read files, and return plain options for ``__init__``.

        It runs once, in the caller.

        Args:
            robot: The robot's name in the registry.
            options: The user's keywords, under the names of ``OPTIONS``.

        Returns:
            Options that every process of the tree can be given. The default returns the keywords unchanged.

        Raises:
            ValueError: A value is wrong. The text says what is accepted.
            TypeError: A type is wrong.
        """
        return dict(options)

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        """Return the services of a robot with these resolved options."""
        return cls.SERVICES

    @classmethod
    async def complete(cls, robot: str, port: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options, completed by facts that only the robot can give.

        It runs in the caller before the tree is started, and may run again.

        Args:
            robot: The robot's name.
            port: Its serial port or address.
            options: The options that ``resolve`` has returned.

        Raises:
            WireDown: The robot does not answer.
        """
        return dict(options)

    @abstractmethod
    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None: ...

    def check_port(self) -> None:  # noqa: B027  # a default that accepts
        """Check the form of ``port``, without opening it. The default accepts any.

        Raises:
            ValueError: The form is wrong. The text says what is accepted.
        """

    @property
    def late_s(self) -> float:
        """Longest time after a cut-off in which an arming or a service may still take effect."""
        return max((self.timing.late_s, *(service.late_s for service in self.SERVICES.values())))

    def declare(self, *parts: Part) -> None:
        """Set the axes of the robot. Names, ids, parsing and the first target follow from them."""
        self.parts = parts
        self.table = axes_of(parts)
        self.axes = tuple(axis.key for axis in self.table)
        self.ids = tuple(axis.id for axis in self.table)
        self._index = {key: at for at, key in enumerate(self.axes)}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of every axis, or a refusal of the action.

        Position axes that the action does not name keep ``state.target``; velocity axes get zero.
        """
        parsed = parse_action(action, self.robot, self.table, self._index, state.target)
        return parsed if isinstance(parsed, Refused) else Candidate(*parsed)

    def parse_simulated(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """As ``parse``, for a simulation. Its body may accept more than the wire. The default is the same."""
        return self.parse(action, state)

    def to_approve(self, action: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of an action that may need approval.

        Velocities of zero are excluded, since they stop the robot.
        """
        at_rest = {axis.key: axis.rest for axis in self.table if axis.mode is AxisMode.VELOCITY}
        keys = ((key, str(key).removesuffix(".pos")) for key in action)
        return tuple(plain for key, plain in keys if plain not in at_rest or finite(action[key]) != at_rest[plain])

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return the target of a robot that was just armed.

        These are the measured positions, so that it does not jump, and zero for velocity axes.
        """
        return first_target(self.table, observation.position) if self.parts else observation.position

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        """Return a refusal of a service, or None if it may run. Pure.

        It may run if ``SERVICES`` declares the service and its arguments, and all counts are valid.
        """
        declared = self.SERVICES.get(service)
        if declared is None:
            names = ", ".join(self.SERVICES) or "none"
            return Refused(
                Code.UNKNOWN_SERVICE, f"{self.robot} has no such service", f"it has {names}", service, names
            )
        for name in arguments:
            if name not in declared.arguments:
                names = ", ".join(declared.arguments) or "none"
                return Refused(Code.UNKNOWN_ARGUMENT, f"no argument {name}", f"it takes {names}", name, names)
        for name, most in declared.counts.items():
            value = arguments.get(name, declared.arguments[name])
            if not _is_count(value, most):
                why, limit = f"{name} is {value!r}", f"1..{most}"
                return Refused(Code.BAD_ARGUMENT, why, f"give a whole number, 1 to {most}", f"{value}", limit)
        return None

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        """Return the command of a verb with these inputs. Pure.

        A driver overrides it for verbs in other units than those of the axes. The default is
        ``ToolVerb.command``.
        """
        return verb.command(inputs)

    def preload(self) -> None:
        """Import the modules of ``stop_channel``.

        It is called in the root and in the wire process before their first heartbeat. On a busy machine an
        import takes longer than they may be silent.
        """
        if self.STOP_CHANNEL:
            load(self.STOP_CHANNEL)

    def preload_wire(self) -> None:
        """Import the modules of ``open_wire``.

        It is called in the wire process only, so that the root loads no SDK.
        """
        if self.WIRE:
            load(self.WIRE)

    def open_wire(self, clock: Clock) -> Wire:
        """Return a new wire, which is not open yet."""
        wire: Wire = load(self.WIRE)(self.config, clock)
        return wire

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        """Return a new stop channel.

        Args:
            descriptors: Those of ``Wire.handover``. Without any, the channel opens its own connections when it
                is used.
            clock: The clock.
        """
        channel: StopChannel = load(self.STOP_CHANNEL)(self.config, descriptors, clock)
        return channel

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return a row in axis order as a mapping of public keys."""
        return dict(zip(self.axes, values, strict=True))

    def experimental(self, way: str) -> str:
        """Return the warning for a transport in ``EXPERIMENTAL``."""
        return f"{way} is experimental: {self.EXPERIMENTAL[way]}"

    def observed(self, observation: Observation) -> dict[str, float]:
        """Return the positions by public key: of the axes, and of read-only joints that were read."""
        rows = {joint.key: observation.sensors.get(joint.sensor) for joint in self.READ_ONLY_JOINTS}
        return self.as_json(observation.position) | {key: row[0] for key, row in rows.items() if row}

    def as_telemetry(self, observation: Observation) -> dict[str, float]:
        """Return ``observed`` for subscribers on the mesh, with each position under ``x`` and ``x.pos``."""
        positions = self.observed(observation)
        rates = {axis.key for axis in self.table if axis.mode is AxisMode.VELOCITY}
        return positions | {f"{key}{SUFFIX}": value for key, value in positions.items() if key not in rates}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """Return the reply of ``send_action``: the accepted action and its target."""
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"commanded": {key: target[key] for key in target if key in named}, "unit": self.unit}

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        """Return the reply of ``send_action`` with readings.

        Args:
            action: The accepted action.
            values: Its target.
            sensors: The newest readings of ``ANSWERS_WITH``.
        """
        return self.commanded(action, values)

    def timed(
        self, targets: Mapping[str, Any], seconds: float, observation: Observation
    ) -> dict[str, Any] | Refused | None:
        """Return the command with which the robot itself plans a timed motion.

        Args:
            targets: Target by joint, in the driver's units.
            seconds: Duration of the motion, in seconds.
            observation: The newest observation.

        Returns:
            The command, or a refusal. None (the default) if the robot cannot plan one; then a path of small
            steps is sent.
        """
        return None

    def readings(self, observation: Observation) -> dict[str, Any]:
        """Return more readings for ``state`` and ``status``, as JSON.

        They are in the users' words: a pose, a charge, the name of a mode.
        """
        return {}

    def model_units(self) -> tuple[tuple[float, float], ...]:
        """Return (zero, scale) of each axis, to convert from the joints of the twin's model.

        ``value = zero + scale * m``, where ``m`` is the joint of the model in radians or metres. The default is
        (0, 1).
        """
        return ((0.0, 1.0),) * len(self.axes)

    def travel(self) -> dict[str, tuple[float, float]]:
        """Return the calibrated range (low, high) of each axis, in the driver's units.

        It is empty without a calibration.
        """
        return {}

    def energised(self, safe_state: SafeState) -> bool:
        """Return True if the next setpoint moves the robot out of this safe state without a resume.

        It does where motors keep torque, or a base stands at velocity zero.
        """
        return safe_state in (SafeState.HOLD, SafeState.ZERO)


def _is_count(value: object, most: int) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 1 <= value <= most and value == int(value)
