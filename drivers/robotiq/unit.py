"""The simulated gripper and its registers. All clients access the same registers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from strands_actors.drivers.common.twin import Fault, TwinRobot

from . import protocol as p
from .body import GripperBody
from .mechanism import Fingers, Gripper, Setup


class RobotiqTwin(TwinRobot):
    """One simulated gripper with its registers, its injected faults, and the model for pictures of it. All clients
    share it."""

    def __init__(
        self,
        setup: Setup,
        unit: int,
        table: Mapping[str, Any],
        now_s: Callable[[], float] = time.monotonic,
        fingers: Fingers | None = None,
    ) -> None:
        """Build the gripper. ``table`` is its table in ``robots.toml``, from which the model for pictures is
        built. ``fingers`` are those of a gripper on an arm."""
        super().__init__()
        self.gripper = Gripper(setup, now_s, fingers)
        self.unit = unit
        self.body = GripperBody(self.gripper, table)
        self._felt = p.Status()
        self._output = p.RESET.registers()

    @property
    def fault(self) -> Fault:
        return self.faults.of(None)

    def begin_fault(self, fault: Fault) -> None:
        if self.is_off and fault is not Fault.OFF:
            self.power_cycle()
        self.gripper.note_request()
        self._felt = self.gripper.status()
        self.gripper.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        self.gripper.power_cycle()
        self._output = p.RESET.registers()

    def status(self) -> p.Status:
        """Return the status that clients read. An injected fault repeats or falsifies it."""
        if self.fault is Fault.STUCK:
            return self._felt
        status = self.gripper.status()
        if self.fault is Fault.WRONG:
            return msgspec.structs.replace(status, request=p.TOP - status.request, position=p.TOP - status.position)
        return status

    def output(self) -> list[int]:
        return list(self._output)

    def write(self, first: int, registers: Sequence[int]) -> None:
        """Write some registers of the command, beginning with the register at index ``first``."""
        self._output[first : first + len(registers)] = registers
        self.gripper.write(p.Command.from_registers(self._output))

    def kind_of(self, first: int, registers: Sequence[int]) -> str:
        """Return the kind of a write as the log of received messages (wire log) names it: ``setpoint``, ``enable``
        or ``safe``."""
        output = self.output()
        output[first : first + len(registers)] = registers
        return p.classify(p.Command.from_registers(output), self.gripper.activation_requested)
