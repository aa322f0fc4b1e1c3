"""Model a robot for the explorer: its driver, the frames written to it, and its faults."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

from strands_actors.contract.driver import Driver

from .plan import Event
from .world import World

Seam = tuple[Any, str, Any]
"""An owner, the name of its attribute, and the value that replaces the attribute."""
Effect = tuple[Callable[[], None], Callable[[], None]]
"""A function that applies a fault, and a function that undoes it."""


class Frame(NamedTuple):
    """A frame that the robot received, with the state of the motors before and after it."""

    t_s: float
    left_s: float
    """When its writer had written it. A network may deliver it later."""
    role: str  # of the process that wrote it
    kind: str  # as the twin's log names it: setpoint, safe, enable
    safe_state: str
    goals: Mapping[int, float]  # of the frame, by motor
    before: Mapping[int, float]  # goals before it
    lost: Mapping[int, float]  # goals that were written after ``before`` and lost
    positions: Mapping[int, float]  # true positions of the joints
    energised_before: frozenset[int]
    energised: frozenset[int]


class Actions(Protocol):
    """Draws the actions of writers. Each action can be distinguished from all others on the wire."""

    def next(self, far: bool) -> dict[str, float]: ...


class RobotModel(ABC):
    """A robot and its wire, in memory.

    Attributes:
        frames: The received frames that change something. Frames that only read are left out.
    """

    PORT: ClassVar[str]
    SETTLE_S: ClassVar[float] = 3.5
    """After its caller was killed, the rest of a tree ends by itself within this time: the
    guardian's longest pause, and one attempt."""
    KEEPS_TORQUE_BY_RESUME: ClassVar[bool]
    """True if a motor that lost its torque gets it back only by a resume."""

    OPTIONS: ClassVar[Mapping[str, Any]] = {}
    """Options of the driver."""
    FIRST: ClassVar[tuple[tuple[str, Mapping[str, Any]], ...]] = ()
    """Services, with their arguments, after which the robot accepts a target."""

    driver: Driver
    driver_class: type[Driver]
    rest: Mapping[int, float]
    """By motor: the goal of a velocity that an action does not name."""

    def __init__(self, world: World, robot: str) -> None:
        self.world = world
        self.rest = {}
        self.robot = robot
        self.frames: list[Frame] = []
        self.energised_log: list[tuple[float, frozenset[int]]] = [(world.now_s, frozenset())]

    def energised_at(self, t_s: float) -> frozenset[int]:
        """Return the motors that have torque at this time."""
        last: frozenset[int] = frozenset()
        for since_s, motors in self.energised_log:
            if since_s > t_s:
                break
            last = motors
        return last

    def log_energised(self, now: frozenset[int]) -> None:
        if now != self.energised_log[-1][1]:
            self.energised_log.append((self.world.now_s, now))

    def make_driver(self, driver_class: type[Driver]) -> Driver:
        return driver_class(self.robot, self.PORT, driver_class.resolve(self.robot, self.OPTIONS))

    @abstractmethod
    def actions(self) -> Actions: ...

    @abstractmethod
    def told(self, key: str, value: float) -> tuple[int, float]:
        """Return the motor, and the goal that the wire carries for this value of an action."""

    @abstractmethod
    def marks(self, key: str) -> bool:
        """Return whether each action has a unique value for this axis, by which it is recognised."""

    @abstractmethod
    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return the lowest and the highest goal that a safe frame may give a motor."""

    @abstractmethod
    def seams(self) -> tuple[Seam, ...]:
        """Return the replacements that connect the driver to this model instead of a port."""

    @abstractmethod
    def effect(self, event: Event) -> Effect | None:
        """Return the effect of a fault; None if this wire does not have the fault."""

    @abstractmethod
    def mend(self) -> None:
        """Undo every fault."""


def put(owner: object, name: str, value: object, before: object) -> Effect:
    return lambda: setattr(owner, name, value), lambda: setattr(owner, name, before)


def nothing() -> None:
    pass


@contextlib.contextmanager
def replaced(owner: Any, name: str, value: object) -> Iterator[None]:
    """Replace an attribute while a twin is made."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)
