"""Decode the registers that a Dynamixel servo reports in every read cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from strands_actors.drivers.common.servo.axes import COUNTS, Axis
from strands_actors.drivers.common.servo.readings import Readings, Sample

from . import protocol, table
from .gates import UNNAMED
from .watchdog import TRIPPED, UNARMED

COUNTS_PER_S = 0.229 / 60 * COUNTS
"""Of the velocity register."""

LOAD_MODELS = ("XL430-W250", "XC430")
"""Without a current sensor: register 126 is the load."""


class DynamixelReadings(Readings[protocol.Packet]):
    SENSORS = ("load_pct", "current_ma", "voltage_v", "temperature_c")

    def __init__(self, axes: Sequence[Axis], limits: Mapping[str, tuple[float, ...]]) -> None:
        super().__init__(axes, limits)
        self._alerts: dict[int, str] = {}
        self._watchdog: dict[int, str] = {}
        self._watchdog_counts = table.WATCHDOG_OFF

    @property
    def unnamed(self) -> bool:
        """True if a servo has set its alert bit, and the register with the kind of alert was not read yet."""
        return UNNAMED in self._alerts.values()

    def watchdogs_are(self, counts: int) -> None:
        """Note the value that was written to the bus watchdog registers of all servos, and was read back. A bus
        watchdog stops its servo when the bus is silent."""
        self._watchdog.clear()
        self._watchdog_counts = counts

    def sample(self, axis: Axis, reply: protocol.Packet, base: int) -> Sample:
        block = reply.params
        torque: bool | None = None
        if base <= table.TORQUE_ENABLE.address:
            torque = bool(table.TORQUE_ENABLE.decode(block, base))
            self._alerts[axis.id] = table.error_words(table.HARDWARE_ERROR.decode(block, base))
            counts = table.BUS_WATCHDOG.decode(block, base)
            self._watchdog[axis.id] = self._words_of_watchdog(counts) if torque else ""
        elif not reply.alert:
            self._alerts[axis.id] = ""
        elif not self._alerts.get(axis.id):
            self._alerts[axis.id] = UNNAMED
        words = [self._alerts[axis.id], self._watchdog.get(axis.id, "")]
        amount = float(table.CURRENT.decode(block, base))
        has_load = axis.model in LOAD_MODELS
        return Sample(
            position=table.POSITION.decode(block, base),
            velocity=table.VELOCITY.decode(block, base) * COUNTS_PER_S,
            sensors=(
                amount / 10 if has_load else math.nan,
                math.nan if has_load else amount,
                table.VOLTAGE.decode(block, base) / 10,
                float(table.TEMPERATURE.decode(block, base)),
            ),
            words=", ".join(word for word in words if word),
            energised=torque,
        )

    def _words_of_watchdog(self, counts: int) -> str:
        if counts == table.WATCHDOG_TRIPPED:
            return TRIPPED
        return UNARMED if self._watchdog_counts and counts != self._watchdog_counts else ""
