"""What a servo robot's bus was last read to say, in the words of lerobot's buses: ``arm.bus``.

Nothing is asked of the servos here: the tree reads them all the time, and it is their only reader.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import Observation

POSITION = "Present_Position"
VELOCITY = "Present_Velocity"
RAW: Mapping[str, tuple[str, float]] = {
    "Present_Load": ("load_pct", 10.0),
    "Present_Current": ("current_ma", 1.0),
    "Present_Voltage": ("voltage_v", 10.0),
    "Present_Temperature": ("temperature_c", 1.0),
}
"""Register to our sensor, and how many counts are one of its unit."""
READABLE = (POSITION, VELOCITY, *RAW)


class Bus:
    """The servos of one robot, to be read."""

    def __init__(self, driver: Driver, look: Callable[[], Observation]) -> None:
        """``look``: the newest observation; raises ``ConnectionError`` where there is none."""
        self._driver = driver
        self._look = look

    @property
    def motors(self) -> dict[str, int]:
        """Return each joint's servo id."""
        return dict(zip(self._driver.axes, self._driver.ids, strict=True))

    def sync_read(self, data_name: str = POSITION, motors: Any = None, num_retry: int = 0) -> dict[str, float]:
        """Return joint to value: position in the joint's unit, velocity in that a second, and the
        rest as the servo's own counts. A servo that is silent is not in it. ``motors``: a joint or
        several; None: all. ``num_retry`` changes nothing: the tree asks again by itself.

        Raise ``ValueError`` for a register that is not read, or a joint that is not there;
        ``ConnectionError`` without a connection."""
        if data_name not in READABLE:
            raise ValueError(f"bus: {str(data_name)[:40]!r} is not read. Use one of {', '.join(READABLE)}")
        wanted = self._names(motors)
        observation = self._look()
        row = self._row(data_name, observation)
        silent = {axis for axis, said in observation.faults.items() if "silent" in said.split(", ")}
        values = zip(self._driver.axes, row, strict=False)
        return {
            axis: value for axis, value in values if axis in wanted and axis not in silent and math.isfinite(value)
        }

    def _row(self, data_name: str, observation: Observation) -> tuple[float, ...]:
        if data_name == POSITION:
            return observation.position
        if data_name == VELOCITY:
            return observation.velocity
        sensor, counts = RAW[data_name]
        return tuple(
            round(value * counts) if math.isfinite(value) else value
            for value in observation.sensors.get(sensor, ())
        )

    def _names(self, motors: Any) -> frozenset[str]:
        axes = self._driver.axes
        if motors is None:
            return frozenset(axes)
        names = (motors,) if isinstance(motors, str) else tuple(motors)
        if unknown := [name for name in names if name not in axes]:
            raise ValueError(f"bus: {str(unknown[0])[:40]!r} is no joint of it. Use {', '.join(axes)}")
        return frozenset(names)
