"""What a modelled robot is to the explorer: its driver, what was written to it, what can befall it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

from strands_actors.contract.driver import Driver

from .plan import Event
from .world import World

Seam = tuple[Any, str, Any]
"""Where a name is replaced, the name, and by what."""
Effect = tuple[Callable[[], None], Callable[[], None]]
"""What happens, and how it is undone."""


class Frame(NamedTuple):
    """What the robot was told, and how that left it."""

    t_s: float
    left_s: float
    """When who wrote it had written it. A network may keep it for a while."""
    role: str  # of the process that wrote it
    kind: str  # as the twin's log names it: setpoint, safe, enable
    safe_state: str
    goals: Mapping[int, float]  # of the frame, by motor
    before: Mapping[int, float]  # goals before it
    lost: Mapping[int, float]  # goals that were written since then and lost
    positions: Mapping[int, float]  # where the joints truly were
    energised_before: frozenset[int]
    energised: frozenset[int]


class Actions(Protocol):
    """Draws what a writer asks for; each action can be told from all others on the wire."""

    def next(self, far: bool) -> dict[str, float]: ...


class RobotModel(ABC):
    """A robot and its wire, in memory. ``frames``: what it heard that asks for more than an answer."""

    PORT: ClassVar[str]
    SETTLE_S: ClassVar[float] = 3.5
    """What is left of a tree whose caller was killed ends by itself within this time: the
    guardian's longest pause, and an attempt."""
    KEEPS_TORQUE_BY_RESUME: ClassVar[bool]
    """A motor that lost its torque gets it back by a resume only."""

    OPTIONS: ClassVar[Mapping[str, Any]] = {}
    """Of the driver."""

    driver: Driver
    driver_class: type[Driver]
    rest: Mapping[int, float]
    """By motor: what a velocity is told that nobody asks for."""

    def __init__(self, world: World, robot: str) -> None:
        self.world = world
        self.rest = {}
        self.robot = robot
        self.frames: list[Frame] = []
        self.energised_log: list[tuple[float, frozenset[int]]] = [(world.now_s, frozenset())]

    def energised_at(self, t_s: float) -> frozenset[int]:
        """Return the motors that may move then."""
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
        """Return the motor, and what it is told for ``value`` of an action."""

    @abstractmethod
    def marks(self, key: str) -> bool:
        """Return whether the axis has a value in each action that no other action has."""

    @abstractmethod
    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return between which goals a safe frame may leave a motor."""

    @abstractmethod
    def seams(self) -> tuple[Seam, ...]:
        """Return what the driver is given in place of a port."""

    @abstractmethod
    def effect(self, event: Event) -> Effect | None:
        """Return what a fault of the wire does; None: it is no fault of this wire."""

    @abstractmethod
    def mend(self) -> None:
        """Undo every fault."""


def put(owner: object, name: str, value: object, before: object) -> Effect:
    return lambda: setattr(owner, name, value), lambda: setattr(owner, name, before)


def nothing() -> None:
    pass
