"""Ways in which a program moves the arm: each sets the joints' targets, tick by tick."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics import Plant

STANDING_RAD_S = 0.01
ARRIVED_RAD = 2e-3

BRAKING_RAD_S2 = 10.0
"""Of the joints in a stop [assumed]: what the control script asks for is the tool's."""

BRAKING_S = 0.05
"""A servo of the twin lags so far behind its target: where it halts from any speed without turning
back."""


class Motion:
    """Stands where it is told to begin; subclasses move on."""

    def __init__(self) -> None:
        self._target: list[float] = []

    def begin(self, plant: Plant) -> None:
        self._target = list(plant.position_rad)

    def advance(self, plant: Plant, seconds: float) -> None:
        for joint, rad in enumerate(self._target):
            plant.set_target(joint, rad)

    def target(self, plant: Plant) -> Sequence[float]:
        return self._target or plant.position_rad


class Hold(Motion):
    """Come to a stand and stay."""

    def begin(self, plant: Plant) -> None:
        columns = zip(plant.position_rad, plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]


class Servo(Motion):
    """Follow a goal that changes all the time, at the joints' top speed at most. Keeps the last one
    for ever."""

    def __init__(self, goal: Sequence[float]) -> None:
        super().__init__()
        self._goal = list(goal)

    def begin(self, plant: Plant) -> None:
        self._target = self._goal


class Speed(Motion):
    """Turn at constant rates, for ever: nobody who is silent stops this."""

    def __init__(self, rates_rad_s: Sequence[float]) -> None:
        super().__init__()
        self._rates = list(rates_rad_s)

    def advance(self, plant: Plant, seconds: float) -> None:
        self._target = [rad + rate * seconds for rad, rate in zip(self._target, self._rates, strict=True)]
        super().advance(plant, seconds)


class MoveTo(Motion):
    """Go to a goal at one speed and stand there."""

    def __init__(self, goal: Sequence[float], speed_rad_s: float) -> None:
        super().__init__()
        self._goal = list(goal)
        self._speed_rad_s = speed_rad_s

    def advance(self, plant: Plant, seconds: float) -> None:
        step = self._speed_rad_s * seconds
        self._target = [
            rad + max(-step, min(step, goal - rad)) for rad, goal in zip(self._target, self._goal, strict=True)
        ]
        super().advance(plant, seconds)

    def arrived(self, plant: Plant) -> bool:
        there = zip(plant.position_rad, self._goal, strict=True)
        return all(abs(rad - goal) < ARRIVED_RAD for rad, goal in there) and (
            max(abs(rad_s) for rad_s in plant.velocity_rad_s) < STANDING_RAD_S
        )
