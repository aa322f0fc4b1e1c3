"""The wire of a robot of LeRobot's: the wire of a plain class, and our own codec on buses that it knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, ProcessSpent

from ..wire import PlainWire, reports
from .follower import LIMP
from .types import TYPES


class LeRobotWire(PlainWire):
    async def open(self) -> dict[str, Any]:
        facts = await super().open()
        kind = TYPES[self._config.robot]
        ours = "torque off by our own codec, on the port that it has open, or opened anew"
        return {**facts, "lerobot_type": kind.type, **({"stop_channel": ours} if kind.wire else {})}

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if safe_state != SafeState.HOLD or self._instance.made is None:
            return await super().make_safe(safe_state)
        try:
            failure = await self._call("hold", self._within.stop_s, self._instance.hold)
        except ProcessSpent as spent:
            return reports(self._config, str(spent), written=False)
        limp = self._limp()
        held = reports(self._config, failure)
        return tuple(replace(one, safe=False, detail=failure or LIMP) if one.axis in limp else one for one in held)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Drop a setpoint for a motor that lost its torque after the gate's check. The others go on."""
        made, count = self._instance.made, len(self._config.axes)
        named = [key for at, key in enumerate(self._config.declared.keys) if values[count + at]]
        if made is not None and made.limp_of(named):
            raise PermitDenied("a motor that it would move has no torque")
        await super().write(values, permit)

    def _limp(self) -> frozenset[str]:
        """Return the axes without torque; all axes if a motor without torque is no axis itself."""
        made = self._instance.made
        limp = frozenset[str]() if made is None else made.limp
        axes = self._config.axes
        return limp if limp.issubset(axes) else limp.union(axes)

    def _observation(self, trouble: str = "") -> Observation:
        seen = super()._observation(trouble)
        if not (limp := self._limp()):
            return seen
        return replace(seen, faults={**seen.faults, **dict.fromkeys(sorted(limp), LIMP)})

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Leave the stop to our own stop channel, if there is one: it needs no object."""
        return () if TYPES[self._config.robot].wire else await super().reach(safe_state)

    def handover(self) -> Sequence[int]:
        made = self._instance.made
        ours = [] if made is None else made.descriptors()
        return ours or super().handover()
