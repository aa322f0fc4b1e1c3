"""Share faults, restarts, the control cycle and control lines among all simulated robots."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Protocol, runtime_checkable

from .faults import Fault, Faults


class Controls(Protocol):
    """Events that a test can cause in a simulated robot."""

    def set_fault(self, fault: Fault, unit: int | None) -> None: ...

    def power_cycle(self) -> None: ...


@runtime_checkable
class HasControlLines(Protocol):
    """A simulated robot that accepts additional control lines (commands on the standard input of its process)."""

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line, split into words. Return False if this robot does not know the line."""
        ...


class TwinRobot(ABC):
    """One simulated robot, which all its clients share.

    A subclass defines its restart, its joints that can fail, and its control cycle.
    """

    PARTS: Sequence[int] = ()
    """The numbers of the joints that can get stuck one by one."""
    TICK_S: ClassVar[float] = 0.0
    """The period of the control cycle, in seconds. 0: there is none."""
    RESTART_CUTS: ClassVar[bool] = False
    """True if a restart ends every connection, and if the network is down while the robot has no power."""

    def __init__(self) -> None:
        self.faults = Faults()

    @property
    def is_off(self) -> bool:
        """True if the robot has no power."""
        return self.faults.of(None) is Fault.OFF

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Set a fault of the whole robot, or let one joint get stuck.

        Args:
            fault: The fault.
            unit: The number of a joint. None: the whole robot.

        Raises:
            ValueError: There is no such joint, or a joint cannot have this fault.
        """
        if unit is not None:
            if unit not in self.PARTS or fault not in (Fault.OK, Fault.STUCK):
                has = (
                    f"joints {self.PARTS[0]} to {self.PARTS[-1]}, which can be ok or stuck"
                    if self.PARTS
                    else "no joints"
                )
                raise ValueError(
                    f"fault {fault}:{unit}: this robot has {has}. Use {fault} alone for the whole robot"
                )
            self.jam(self.PARTS.index(unit), fault is Fault.STUCK)
            return
        self.begin_fault(fault)
        self.faults.set(fault)
        if fault is Fault.OFF:
            self.power_cycle()

    def begin_fault(self, fault: Fault) -> None:  # noqa: B027  # most robots have nothing to do
        """Prepare for a fault of the whole robot, which begins right afterwards. For example, keep the readings
        that a stuck robot repeats. ``Fault.OK`` ends the present fault."""

    def jam(self, index: int, on: bool) -> None:
        """Let a joint get stuck, or free it. ``index`` is its place in ``PARTS``."""
        raise NotImplementedError(f"{type(self).__name__} has PARTS, so it needs the method jam")

    @abstractmethod
    def power_cycle(self) -> None:
        """Switch the power off and on."""

    def tick(self) -> None:  # noqa: B027  # without a control cycle it is never called
        """Run one control cycle. It is called once in ``TICK_S``."""

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line (see ``HasControlLines``)."""
        return False


__all__ = ["Controls", "HasControlLines", "TwinRobot"]
