"""The driver contract: the classes that the author of a driver writes.

A driver declares one type of robot. It contains no loops, sleeps or retries. It has four parts:

``Driver``      Pure data and functions: robots, axes and units, gates, safe states, timing. It is built in
                the caller, the wire process and the root process from the same plain options.
``Wire``        All I/O with the robot (``wire.py``). Only one process, the wire process, calls it.
``StopChannel`` The connection by which the root process (the supervisor) stops the robot when the wire process has
                ended (``wire.py``). ``stop_channels`` and ``stop_process`` have five ready-made kinds.
a twin          A simulated robot that speaks the robot's protocol, as a process (``drivers/common/twin/``).

The processes of a robot (its tree) do the rest: they decide which program may command, drop old commands, repeat
setpoints, stop the robot and restart after a failure.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from . import refusals
from .arm_model import ArmModel
from .axis import Axis, AxisMode, Part, axes_of, finite, first_target, parse_action
from .contract_version import UNDECLARED
from .loading import load
from .positions import SUFFIX
from .safe_state import SafeState
from .sensors import ReadOnlyJoint, Sensor
from .tool_verbs import SENSORS, STATUS, STOP, ToolVerb
from .wire import Observation, StopChannel, Wire


class Reason(enum.StrEnum):
    """Why the robot has to go to a safe state.

    A driver's table ``fallbacks`` gives a safe state for each reason.
    """

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
    FAULT = "fault"  # the robot has broken a condition, a hold or arming has failed, or restarts were too many


HOLDING_REASONS = frozenset({Reason.EXPIRED, Reason.LEASE, Reason.POLICY})
"""Reasons after which a robot that can hold its position stays energised."""

ORDERED = frozenset({Reason.STOP, Reason.ESTOP})
"""Reasons that a person or a program may order. The tree itself uses the others."""


class Timing(msgspec.Struct, frozen=True):
    """The times of the connection to a robot, in seconds.

    A setpoint has a lifetime, after which the robot must hold. The keepalive period is another time: the firmware
    needs a frame that often.
    """

    control_hz: float
    keepalive_s: float  # period in which the last setpoint is sent again while it is valid
    stream_ttl_s: float = 0.1  # lifetime of a setpoint that is part of a stream
    oneshot_ttl_s: float | None = None  # lifetime of a single send_action; None: valid as long as the lease
    state_ttl_s: float = 0.3  # an older observation counts as missing
    arm_s: float = 2.0  # longest time that ``Wire.arm`` may take
    # The root process waits for this time before it counts the wire process as frozen during ``Wire.open`` and
    # ``Wire.arm``. An SDK's constructor may keep the interpreter's lock, so that the wire process cannot send
    # heartbeats.
    silent_s: float = 0.0
    tick_s: float = 0.01  # period of the deadline checks, and of the heartbeats between wire and root process
    heartbeat_ttl_s: float = 0.1  # a process without a heartbeat for this time counts as frozen
    # Longest time that a call of ``Wire.read``, ``write`` or ``feed`` may wait, if it is longer than
    # ``heartbeat_ttl_s``. A call that takes longer counts as frozen. 0 if these calls wait less than
    # ``heartbeat_ttl_s``.
    call_s: float = 0.0
    open_s: float = 5.0  # longest time of ``Wire.open`` with the first reading, and of opening a stop channel
    handover_s: float = 3.0  # the part of ``open_s`` in which the root process prepares its stop channel
    safe_s: float = 1.5  # longest time of ``make_safe``, of the wire and of the stop channel
    # Longest time after which a request to arm can still take effect, although it was cut off: a stop cancelled it,
    # or its process was killed. The request may be in a buffer or in the network, or the robot may act on it later.
    # No stop is confirmed before this time has passed. 0 if the robot carries out requests at once and in order, so
    # that the safe frame is always the last.
    late_s: float = 0.0


class Service(msgspec.Struct, frozen=True):
    """A method of the robot's handle beyond the common verbs, for example ``take_off``.

    ``about`` describes the service. ``arguments`` maps the names of arguments to their defaults.
    """

    about: str
    within_s: float  # longest time that ``Wire.perform`` may take
    arguments: Mapping[str, Any] = msgspec.field(default_factory=dict)
    counts: Mapping[str, int] = msgspec.field(default_factory=dict)  # whole numbers from 1 to this value, by name
    in_motion: bool = False  # True if the service may run while the robot follows a target
    # The service moves the robot. It is refused whenever a setpoint would be refused. Its motion counts as a target
    # that does not expire, until a stop or the end of the lease. Earlier targets are not sent again.
    moves: bool = False
    # The service ends the present motion, so it may be requested while the robot moves. Earlier targets are not
    # sent again. No condition refuses it: a drone must be able to land with a low battery.
    ends_motion: bool = False
    # The service switches motor power, or lets motors move afterwards. If an agent or another computer requests it,
    # it counts as motion. Like a setpoint it needs a robot that ``resume()`` has armed, so that no service
    # energises a stopped robot. Declare exceptions in ``releases``.
    powers: bool = False
    # True if a service with ``powers`` only takes power away, so that a stopped robot may run it, too. If that
    # depends on an argument: a mapping from its name to the value with which the service only takes power away.
    releases: bool | Mapping[str, Any] = False
    # Longest time after a cut-off for which the service can still power or move the robot (see ``Timing.late_s``).
    late_s: float = 0.0
    # The service is sent as an action. Its arguments are the action's values, with the lifetime and the checks of
    # any action. An argument with the default None is left out if the user does not give it.
    acts: bool = False
    # If this is set, the service is a stop, and this is the reason that the stop gives. It locks the robot as an
    # e-stop does, is never refused, and is handled before all other messages.
    stops: Reason | None = None

    def arms(self, arguments: Mapping[str, Any]) -> bool:
        """Return True if a call with these arguments may energise the robot. It then needs an armed robot."""
        if not isinstance(self.releases, Mapping):
            return self.powers and not self.releases
        values = {**self.arguments, **arguments}
        return self.powers and not any(values.get(name) == value for name, value in self.releases.items())


class Live(msgspec.Struct, frozen=True, gc=False):
    """A target that the robot follows.

    ``until_ns`` is the time at which the target expires. None means that it does not expire (it is latched): it
    ends with the lease of the program that commands.
    """

    until_ns: int | None = None

    @property
    def latched(self) -> bool:
        """True if the target does not expire, and ends with the lease of the program that commands."""
        return self.until_ns is None

    def over(self, now_ns: int) -> bool:
        """Return True if the target has expired."""
        return self.until_ns is not None and now_ns >= self.until_ns


class GateState(msgspec.Struct, frozen=True, gc=False):
    """The input of a gate (a function that accepts or refuses a command). A gate has no clock and does no I/O."""

    now_ns: int
    observation: Observation
    target: tuple[float, ...]  # the last accepted target, or the measured position after arming
    target_ns: int  # time at which the target was accepted
    stream: bool  # True if the setpoint is part of a stream, False for a single command
    period_s: float = 0.0  # period of the stream, in seconds; 0 for a single command
    live: Live | None = None  # the target that the robot follows now; None if it follows no target


class Candidate(msgspec.Struct, frozen=True, gc=False):
    """A parsed action, before the gates check it.

    Attributes:
        values: The target of every axis, in axis order, and then further numbers that the driver adds.
        named: Indices of the axes that the action names.
        until_ns: Time at which the target expires at the latest, for an action that continues a motion; 0 for no
            such time.
    """

    values: tuple[float, ...]
    named: tuple[int, ...]
    until_ns: int = 0


GateCheck = Callable[[Candidate, GateState], Refused | None]

ConditionCheck = Callable[[Observation, int], Refused | None]
"""Return a refusal if a condition is broken, from the newest observation and the time (ns). Pure."""


class OnResume(enum.StrEnum):
    """What ``resume()`` does with an armed robot while a condition (such as a charged battery) is broken."""

    # Refuse to resume, because a person has to repair the condition first.
    REFUSE = "refuse"
    # Stop the robot and arm it again, which repairs the condition.
    ARM_ANEW = "arm anew"
    # Stay armed, because a service (take off, stand up) repairs the condition.
    STAY_ARMED = "stay armed"


class Condition(msgspec.Struct, frozen=True):
    """A condition that must be true while the robot is commanded, and its safe state.

    Each condition may lead to another safe state: a drone lands when its battery is low, and hovers when its radio
    link is weak. A driver lists the most specific condition first, since the first broken one is shown as the
    cause.

    Attributes:
        check: The function that checks the condition.
        reason: The reason for the stop that is reported.
        safe_state: The safe state to go to; None for the one that the driver declares for ``reason``.
        always: True checks it whenever the robot is energised. False checks it only while the robot follows a
            target.
        on_resume: What ``resume()`` does if this condition is broken.
        is_silence: True if the condition only shows that the robot does not answer. Any other broken condition is
            then shown as the cause.
    """

    check: ConditionCheck
    reason: Reason = Reason.FAULT
    safe_state: SafeState | None = None
    always: bool = False
    on_resume: OnResume = OnResume.REFUSE
    is_silence: bool = False


class Driver(ABC):
    """The description of one robot as data and pure functions.

    A subclass defines ``SUPPORTED_ROBOTS``, ``PORT_KIND``, ``WIRE`` and ``STOP_CHANNEL``, and ``TWIN`` if it has a
    twin. In place of ``WIRE`` and ``STOP_CHANNEL`` it may override ``open_wire`` and ``stop_channel``.

    The constructor of the subclass calls ``declare`` with the axes, and sets ``robot``, ``unit``, ``timing``,
    ``fallbacks``, ``firmware_watchdog``, ``config`` and ``gates``.

    Args:
        robot: The robot's name.
        port: The robot's serial port or address; empty if it was left out. The driver does not open it.
        options: The plain options that ``resolve`` and ``complete`` have returned.
    """

    CONTRACT_VERSION: ClassVar[int] = UNDECLARED
    """The version of the driver contract that the driver was written for, as a number. A driver of another
    package declares it, so that a release with another contract refuses the driver."""
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]]
    ALIASES: ClassVar[Mapping[str, str]] = {}
    """Other names of the robots in ``SUPPORTED_ROBOTS``."""
    PORT_KIND: ClassVar[Literal["serial", "address"]]
    PORT_OPTIONAL: ClassVar[bool] = False
    """True if ``port`` may be left out, because the robot sends first."""
    PORT_LIKE: ClassVar[str] = "192.0.2.10"
    """An example of this robot's addresses, for the refusal of a missing port."""
    DISTINGUISHED_BY: ClassVar[tuple[str, ...]] = ()
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
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ()
    """Options that describe the robot's body, such as a gripper. The simulated robot takes them, too."""
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
    one adds ``experimental(connection)`` to its ``caveats``."""
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
    TORQUES: ClassVar[str] = ""
    """The sensor with the torques of the first axes, in N m and in the axes' order; empty if there is none."""
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
    ids: tuple[int, ...]  # the motor id of each axis
    table: tuple[Axis, ...] = ()
    unit: str  # the unit of the values, to show to people: "degrees (gripper: percent open)"
    timing: Timing
    fallbacks: Mapping[Reason, SafeState]
    firmware_watchdog: str  # what the firmware does when all processes of this package have ended
    bound_s: float = 0.05  # published bound: longest time from the end of a process to the stop command
    config: Any
    """A frozen struct with everything that ``WIRE`` and ``STOP_CHANNEL`` know of the robot."""
    gates: tuple[GateCheck, ...]
    caveats: tuple[str, ...] = ()
    """Warnings for the user when the robot is connected. They stand in the log and in status."""
    conditions: tuple[Condition, ...] = ()
    """Checked before the gates, and at every tick while a target is in force. A broken one ends it. The
    conditions with ``always`` also end a hold."""

    part_prefixes: Mapping[str, str] = {}
    """Of a robot that is made of other robots: what stands before the axes of each part, by the part's name."""

    LEVELS: ClassVar[Mapping[str, str]] = {}
    """Other drivers for robots of this one that can be commanded in two ways: ``robot:level`` to
    ``module:class``. The option ``level`` selects one. The kill matrix uses the same name."""

    @classmethod
    def for_level(cls, robot: str, options: Mapping[str, Any]) -> type[Driver]:
        """Return the driver for the option ``level`` (a way to command the robot), or this class by default."""
        class_path = cls.LEVELS.get(f"{robot}:{options.get('level')}")
        return cls if class_path is None else load(class_path)

    @classmethod
    def is_lowered(cls, robot: str) -> bool:
        """Return True if the robot is an arm that can be lowered before its torque is switched off."""
        return False

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Check the keywords, read files, and return plain options for ``__init__``.

        It runs once, in the caller.

        Args:
            robot: The robot's name in the registry.
            options: The user's keywords, under the names of ``OPTIONS``.

        Returns:
            Options as plain data, which can be sent to every process of the robot. The default returns the
            keywords unchanged.

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
        """Add facts to the options that only the robot knows, and return them.

        It runs in the caller's process, before the robot's other processes are started. It may be called several
        times.

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
        """Check the form of ``port``, without opening it. The default accepts any text.

        Raises:
            ValueError: The form is wrong. The text describes the accepted form.
        """

    @property
    def late_s(self) -> float:
        """Longest time (s) in which a request to arm, or a service, still takes effect after a stop cut it off."""
        return max((self.timing.late_s, *(service.late_s for service in self.SERVICES.values())))

    def declare(self, *parts: Part) -> None:
        """Set the axes of the robot. Their names, motor ids, parsing and first target are derived from them."""
        self.parts = parts
        self.table = axes_of(parts)
        self.axes = tuple(axis.key for axis in self.table)
        self.ids = tuple(axis.id for axis in self.table)
        self._index = {key: index for index, key in enumerate(self.axes)}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of every axis, or a refusal of the action.

        Position axes that the action does not name keep ``state.target``. Velocity axes that it does not name get
        their rest value.
        """
        parsed = parse_action(action, self.robot, self.table, self._index, state.target)
        return parsed if isinstance(parsed, Refused) else Candidate(*parsed)

    def parse_simulated(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of every axis for a simulated robot, or a refusal.

        By default it does the same as ``parse``. A simulation may accept more keys than the real robot.
        """
        return self.parse(action, state)

    def to_approve(self, action: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of an action that may need an operator's approval.

        Velocities of zero are excluded, since they stop the robot.
        """
        rest_values = {axis.key: axis.rest for axis in self.table if axis.mode is AxisMode.VELOCITY}
        keys = ((key, str(key).removesuffix(".pos")) for key in action)
        return tuple(
            plain for key, plain in keys if plain not in rest_values or finite(action[key]) != rest_values[plain]
        )

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return the first target of a robot whose motors were just energised.

        Position axes get their measured position, so that the robot does not jump. Velocity axes get their rest
        value.
        """
        return first_target(self.table, observation.position) if self.parts else observation.position

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        """Return a refusal of a service, or None if it may run. Pure.

        It may run if ``SERVICES`` declares the service and its arguments, and if each argument in ``counts`` is a
        whole number in range.
        """
        declared = self.SERVICES.get(service)
        if declared is None:
            names = ", ".join(self.SERVICES) or "none"
            return refusals.unknown_service(self.robot, service, names)
        for name in arguments:
            if name not in declared.arguments:
                names = ", ".join(declared.arguments) or "none"
                return refusals.unknown_argument(name, names)
        for name, most in declared.counts.items():
            value = arguments.get(name, declared.arguments[name])
            if not _is_count(value, most):
                return refusals.bad_count(name, value, most)
        return None

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        """Return the action that a verb with these inputs commands. Pure.

        The default is ``ToolVerb.command``. A driver overrides this if its verbs have other units than its axes.
        """
        return verb.command(inputs)

    def preload(self) -> None:
        """Import the modules of ``stop_channel``.

        The root and the wire process call this before their first heartbeat. An import on a busy computer takes so
        long that the process would look frozen afterwards.
        """
        if self.STOP_CHANNEL:
            load(self.STOP_CHANNEL)

    def preload_wire(self) -> None:
        """Import the modules of ``open_wire``.

        Only the wire process calls this, so that the root process never loads an SDK.
        """
        if self.WIRE:
            load(self.WIRE)

    def open_wire(self, clock: Clock) -> Wire:
        """Return a new connection to the robot, which is not open yet."""
        wire: Wire = load(self.WIRE)(self.config, clock)
        return wire

    def stop_channel(self, descriptors: Sequence[int], clock: Clock) -> StopChannel:
        """Return a new stop channel.

        Args:
            descriptors: The descriptors that ``Wire.handover`` returned. If there are no descriptors, the channel
                opens a new connection when it is used.
            clock: The clock.
        """
        channel: StopChannel = load(self.STOP_CHANNEL)(self.config, descriptors, clock)
        return channel

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return numbers in axis order as a mapping with the axes' public keys."""
        return dict(zip(self.axes, values, strict=True))

    def experimental(self, connection: str) -> str:
        """Return the warning for a way to connect that was never tried on a real robot (``EXPERIMENTAL``)."""
        return f"{connection} is experimental: {self.EXPERIMENTAL[connection]}"

    def observed(self, observation: Observation) -> dict[str, float]:
        """Return the positions of the axes, and of the read-only joints that were read, by public key."""
        rows = {joint.key: observation.sensors.get(joint.sensor) for joint in self.READ_ONLY_JOINTS}
        return self.as_json(observation.position) | {key: row[0] for key, row in rows.items() if row}

    def as_telemetry(self, observation: Observation) -> dict[str, float]:
        """Return the positions for subscribers on the network. Each position has two keys, ``x`` and ``x.pos``."""
        positions = self.observed(observation)
        rates = {axis.key for axis in self.table if axis.mode is AxisMode.VELOCITY}
        return positions | {f"{key}{SUFFIX}": value for key, value in positions.items() if key not in rates}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """Return the reply of ``send_action``: the target of each axis that the accepted action names."""
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"commanded": {key: target[key] for key in target if key in named}, "unit": self.unit}

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        """Return the reply of ``send_action``, for a driver that adds sensor readings to it.

        Args:
            action: The accepted action.
            values: The target of every axis.
            sensors: The newest readings of the sensors in ``ANSWERS_WITH``.
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
            The command, or a refusal. None (the default) if the robot cannot plan a timed motion. Then a path
            of small steps is sent.
        """
        return None

    def readings(self, observation: Observation) -> dict[str, Any]:
        """Return further readings for ``state`` and ``status``, as JSON.

        They are in words and units of the robot's users: a pose, a charge, the name of a mode.
        """
        return {}

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel | None:
        """Return the model of the arm, with which ``move_to`` moves its tool to a pose.

        Args:
            sensors: The newest readings of the robot's sensors.

        Returns:
            The model. None (the default) for a robot without a tool whose pose can be computed.
        """
        return None

    def model_units(self) -> tuple[tuple[float, float], ...]:
        """Return (zero, scale) of each axis, to convert positions of the simulated robot's model.

        ``value = zero + scale * m``, where ``m`` is the joint of the model in radians or metres. The default is
        (0, 1).
        """
        return ((0.0, 1.0),) * len(self.axes)

    def link_rows(self) -> str:
        """Return the links of the robot, one row of text for each moving link.

        ``drivers/common/kinematics/link_rows.py`` describes the rows, which are in metres and radians. Joints have
        the keys of the axes. The default is an empty text, for a robot without such rows.
        """
        return ""

    def travel(self) -> dict[str, tuple[float, float]]:
        """Return the calibrated range (low, high) of each axis, in the driver's units.

        The result is empty if there is no calibration.
        """
        return {}

    def energised(self, safe_state: SafeState) -> bool:
        """Return True if the robot stays energised in this safe state, and the next setpoint moves it.

        This is so where motors keep torque, or where a base stands with velocity zero. No resume is needed then.
        """
        return safe_state in (SafeState.HOLD, SafeState.ZERO)


def _is_count(value: object, most: int) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 1 <= value <= most and value == int(value)
