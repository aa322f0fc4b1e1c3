"""``arm.bus``: the last readings of a servo robot, under the names of lerobot's buses.

It sends nothing to the servos. The robot's own process reads them all the time, and no other process does.
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
"""Register to the name of the sensor, and the counts per unit of the sensor."""
READABLE = (POSITION, VELOCITY, *RAW)


class Bus:
    """Read the servos of one robot.

    Args:
        driver: The robot's driver.
        look: Function that returns the newest observation. It raises ``ConnectionError`` if there is no
            observation.
    """

    def __init__(self, driver: Driver, look: Callable[[], Observation]) -> None:
        self._driver = driver
        self._look = look

    @property
    def motors(self) -> dict[str, int]:
        """The servo id of each joint."""
        return dict(zip(self._driver.axes, self._driver.ids, strict=True))

    def sync_read(self, data_name: str = POSITION, motors: Any = None, num_retry: int = 0) -> dict[str, float]:
        """Return the last reading of a register by joint.

        Args:
            data_name: ``Present_Position`` (joint's unit), ``Present_Velocity`` (that unit per second),
                ``Present_Load``, ``Present_Current``, ``Present_Voltage`` or ``Present_Temperature``
                (counts of the servo).
            motors: One joint or several; None for all joints.
            num_retry: No effect, since all servos are read again all the time.

        Returns:
            Value by joint, without servos that do not answer.

        Raises:
            ValueError: The register is not one of these, or the robot has no such joint.
            ConnectionError: The robot is not connected.
        """
        if data_name not in READABLE:
            raise ValueError(
                f"bus: the register {str(data_name)[:40]!r} is not available. Use one of {', '.join(READABLE)}"
            )
        names = self._names(motors)
        observation = self._look()
        row = self._row(data_name, observation)
        silent = {axis for axis, fault in observation.faults.items() if "silent" in fault.split(", ")}
        values = zip(self._driver.axes, row, strict=False)
        return {
            axis: value for axis, value in values if axis in names and axis not in silent and math.isfinite(value)
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
            raise ValueError(f"bus: the robot has no joint {str(unknown[0])[:40]!r}. Use {', '.join(axes)}")
        return frozenset(names)
