"""Model any robot by the server of its twin: the kit from which a new wire gets its model.

The driver's own code speaks the robot's protocol to the twin's own code. Only the network between them is
simulated (``stream_robot.py``, ``datagram_robot.py``). A wire adds a class to ``stream_wires.py`` or
``datagram_wires.py``, which names its driver and its twin.

The kit does not decode the protocol. The kind of a frame, and the safe state to which it leads, come from the log
of the twin. The goals of a setpoint are the values of the last ``Wire.write`` before the frame was sent.
"""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Awaitable, Callable, Mapping
from types import ModuleType
from typing import Any, ClassVar, Generic, TypeVar

from strands_actors.contract.axis import AxisMode
from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.loading import load

from .plan import Event
from .robot_model import Actions, Effect, Frame, RobotModel, Seam, nothing
from .service_robot import ALL, SpreadActions
from .world import World

T = TypeVar("T")
Method = Callable[..., Awaitable[Any]]

LOGGED = frozenset({"setpoint", "safe", "enable"})
GARBLED = 0.05
"""Share of the answers in which one bit is wrong, under the fault "garble"."""


class SimTime:
    """Replaces the module ``time`` in the code of a twin."""

    def __init__(self, world: World) -> None:
        self._world = world

    def monotonic(self) -> float:
        return self._world.now_s

    def time(self) -> float:
        return self._world.now_s

    def monotonic_ns(self) -> int:
        return round(self._world.now_s * 1e9)

    time_ns = monotonic_ns


class History(Generic[T]):
    """Values with the time of each, by process."""

    def __init__(self) -> None:
        self._times_s: dict[str, list[float]] = {}
        self._values: dict[str, list[T]] = {}

    def add(self, role: str, t_s: float, value: T) -> None:
        self._times_s.setdefault(role, []).append(t_s)
        self._values.setdefault(role, []).append(value)

    def last(self, role: str, t_s: float, default: T) -> T:
        """Return the last value of a process until this time."""
        at = bisect_right(self._times_s.get(role, []), t_s)
        return self._values[role][at - 1] if at else default

    def since(self, role: str, t_s: float) -> float:
        """Return when a process had its last value until this time; 0 if it had none."""
        at = bisect_right(self._times_s.get(role, []), t_s)
        return self._times_s[role][at - 1] if at else 0.0


class TwinRobot(RobotModel):
    """A robot that counts as energised, as a whole, while ``follows_commands``.

    Attributes:
        DRIVER: Where to load the driver's class.
        MARK: The axis that gets another value in each action.
        TIMED: Modules of the driver or its twin that use ``time``.
    """

    KEEPS_TORQUE_BY_RESUME = False
    DRIVER: ClassVar[str]
    MARK: ClassVar[str]
    TIMED: ClassVar[tuple[ModuleType, ...]] = ()

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.driver_class = load(self.DRIVER)
        self.driver: Driver = self.make_driver(self.driver_class)
        self._motors = {axis.key: number for number, axis in enumerate(self.driver.table, 1)}
        velocities = (axis for axis in self.driver.table if axis.mode is AxisMode.VELOCITY)
        self.rest = {self._motors[axis.key]: axis.rest for axis in velocities}
        self.rng = world.rng("robot")
        self.garbled = 0.0
        self.time = SimTime(world)
        self._goals: Mapping[int, float] = {}
        self._writes = History[tuple[float, ...]]()
        self._stops = History[str]()
        self._services = History[int]()  # number of services that run
        self.make_twin()

    # -- the wire's part

    @abstractmethod
    def make_twin(self) -> None:
        """Make the twin, whose time is ``now_s``."""

    @property
    @abstractmethod
    def follows_commands(self) -> bool:
        """True while the robot moves, or would follow a target."""

    def pass_time(self) -> None:
        """Advance the twin to the present time."""

    @abstractmethod
    def switch_off_and_on(self) -> None:
        """Restart the twin, as after a dip of its supply."""

    # -- a model of the explorer

    def now_s(self) -> float:
        return self.world.now_s

    def actions(self) -> Actions:
        return SpreadActions(self.driver, self.world.rng("actions"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        return self._motors[key], value

    def marks(self, key: str) -> bool:
        return key == self.MARK

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return no range, because the kit reads no goals from safe frames."""
        return 0.0, 0.0

    def seams(self) -> tuple[Seam, ...]:
        wire = load(self.driver_class.WIRE)
        return (
            (wire, "write", self._noting(self._writes, wire.write)),
            (wire, "make_safe", self._noting(self._stops, wire.make_safe)),
            (wire, "reach", self._noting(self._stops, wire.reach)),
            (wire, "perform", self._noting_services(wire.perform)),
            *((module, "time", self.time) for module in self.TIMED),
        )

    def effect(self, event: Event) -> Effect | None:
        match event.kind:
            case "garble":
                return lambda: setattr(self, "garbled", GARBLED), lambda: setattr(self, "garbled", 0.0)
            case "brown out":
                return self.brown_out, nothing
        return None

    def mend(self) -> None:
        self.garbled = 0.0

    def brown_out(self) -> None:
        self.switch_off_and_on()
        self.look()

    def look(self) -> None:
        """Note whether the robot is energised now."""
        self.log_energised(self._energised)

    @property
    def _energised(self) -> frozenset[int]:
        return ALL if self.follows_commands else frozenset()

    def note_frame(self, kind: str, safe_state: str | None, role: str, left_s: float) -> None:
        """Note a frame that the twin has carried out.

        Args:
            kind: As the twin logs it.
            safe_state: As the twin logs it. If it cannot know, the frame belongs to the last stop of its sender.
            role: The process that sent the frame.
            left_s: When the process had written it.
        """
        if kind not in LOGGED:
            return
        if kind == "setpoint" and self._is_of_a_service(role, left_s):
            self.look()
            return
        goals: Mapping[int, float] = {}
        if kind == "setpoint":
            goals = dict(zip(self._motors.values(), self._writes.last(role, left_s, ()), strict=False))
        elif kind == "safe":
            ordered = str(self.driver.fallbacks[Reason.STOP])
            safe_state = safe_state or self._stops.last(role, left_s, ordered)
        was, now = self.energised_log[-1][1], self._energised
        state = str(safe_state or "")
        self.frames.append(Frame(self.world.now_s, left_s, role, kind, state, goals, {}, {}, {}, was, now))
        self.log_energised(now)
        news = {motor: round(goal, 4) for motor, goal in goals.items() if goal != self._goals.get(motor)}
        self._goals = goals or self._goals
        self.world.note("wire", role, f"{kind} {state} {news}")

    def _is_of_a_service(self, role: str, left_s: float) -> bool:
        """Return whether a service of a process caused a motion. Then no setpoint belongs to it."""
        services = self._services
        runs = services.last(role, left_s, 0) > 0
        return runs and self._writes.since(role, left_s) < services.since(role, left_s)

    def spoil(self, data: bytes) -> bytes:
        """Return an answer of the robot, garbled if this fault is on."""
        if self.garbled and data and self.rng.random() < self.garbled:
            at = self.rng.randrange(len(data))
            data = data[:at] + bytes([data[at] ^ (1 << self.rng.randrange(8))]) + data[at + 1 :]
        return data

    def _noting(self, history: History[Any], method: Method) -> Method:
        """Return the method of a wire, which first notes its first argument."""

        async def noting(wire: object, first: Any, *others: Any) -> Any:
            noted = str(first) if isinstance(first, str) else tuple(first)
            history.add(self.world.current.role, self.world.now_s, noted)
            return await method(wire, first, *others)

        return noting

    def _noting_services(self, perform: Method) -> Method:
        """Return the method of a wire, which notes the time in which a service runs."""

        async def noting(wire: object, *args: Any) -> Any:
            role = self.world.current.role
            self._note_service(role, 1)
            try:
                return await perform(wire, *args)
            finally:
                self._note_service(role, -1)

        return noting

    def _note_service(self, role: str, more: int) -> None:
        now_s = self.world.now_s
        self._services.add(role, now_s, self._services.last(role, now_s, 0) + more)
