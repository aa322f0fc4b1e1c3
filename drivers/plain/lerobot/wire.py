"""Connect the wire process to a robot by LeRobot's class, in the same way as by a user's class. If this package's
own driver knows the servo bus, that driver stops the robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, ProcessSpent, WireDown

from ..wire import PlainWire, reports
from .follower import LIMP
from .types import TYPES


class LeRobotWire(PlainWire):
    async def open(self) -> dict[str, Any]:
        facts = await super().open()
        robot_type = TYPES[self._config.robot]
        if robot_type.wire and not self.handover():
            raise WireDown(
                f"LeRobot's {robot_type.type} is connected, but its port is not open in this process, so that no "
                "other process could switch the torque off. Install a version of LeRobot that this package was "
                "tried with (docs/lerobot.md)"
            )
        ours = "torque off by our own codec, on the port that it has open, or opened anew"
        return {**facts, "lerobot_type": robot_type.type, **({"stop_channel": ours} if robot_type.wire else {})}

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if safe_state != SafeState.HOLD or self._instance.made is None:
            return await super().make_safe(safe_state)
        try:
            failure = await self._call("hold", self._within.stop_s, self._instance.hold)
        except ProcessSpent as error:
            return reports(self._config, str(error), written=False)
        limp = self._limp()
        motors = reports(self._config, failure)
        return tuple(
            replace(motor, safe=False, detail=failure or LIMP) if motor.axis in limp else motor for motor in motors
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write a setpoint. Raise ``PermitDenied`` if a motor that it would move has lost its torque after the
        gate had accepted the setpoint."""
        made, count = self._instance.made, len(self._config.axes)
        named = [key for index, key in enumerate(self._config.declared.keys) if values[count + index]]
        if made is not None and made.limp_of(named):
            raise PermitDenied("a motor that the setpoint would move has no torque")
        await super().write(values, permit)

    def _limp(self) -> frozenset[str]:
        """Return the axes without torque. If a motor without torque is no axis, such as a wheel, return all
        axes."""
        made = self._instance.made
        limp = frozenset[str]() if made is None else made.limp
        axes = self._config.axes
        return limp if limp.issubset(axes) else limp.union(axes)

    def _observation(self, trouble: str = "") -> Observation:
        observation = super()._observation(trouble)
        if not (limp := self._limp()):
            return observation
        return replace(observation, faults={**observation.faults, **dict.fromkeys(sorted(limp), LIMP)})

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot with an object of LeRobot's class. If this package's own driver has a stop channel for the
        bus, do nothing and return no reports, since that channel then stops the robot."""
        return () if TYPES[self._config.robot].wire else await super().reach(safe_state)

    def handover(self) -> Sequence[int]:
        if not TYPES[self._config.robot].wire:
            return super().handover()
        made = self._instance.made
        return () if made is None else made.descriptors()
