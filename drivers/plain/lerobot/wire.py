"""The wire of a robot of LeRobot's: that of a plain class, and what our own codec can do on its
bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, ProcessSpent

from ..wire import PlainWire, reports
from .types import TYPES


class LeRobotWire(PlainWire):
    async def open(self) -> dict[str, Any]:
        facts = await super().open()
        kind = TYPES[self._config.robot]
        ours = "torque off by our own codec, on the port that it has open, or opened anew"
        return {**facts, "lerobot_type": kind.type, **({"stop_channel": ours} if kind.wire else {})}

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        if safe_state != SafeState.HOLD or self._instance.made is None:
            return await super().make_safe(safe_state)
        try:
            failure = await self._call("hold", self._within.stop_s, self._instance.hold)
        except ProcessSpent as spent:
            return reports(self._config, str(spent), written=False)
        return reports(self._config, failure)

    async def reach(self, safe_state: str) -> tuple[MotorReport, ...]:
        """By the stop channel, where it is our own: it needs no object."""
        return () if TYPES[self._config.robot].wire else await super().reach(safe_state)

    def handover(self) -> Sequence[int]:
        made = self._instance.made
        ours = [] if made is None else made.descriptors()
        return ours or super().handover()
