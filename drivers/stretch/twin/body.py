"""Let a simulation drive the twin's robot. Parts that the wire drives follow the wire."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Felt, Hand
from strands_actors.drivers.stretch.config import ARM, LEFT, LIFT, RIGHT

from .world import GRIPPER, World, body_table


class StretchBody:
    def __init__(self, world: World) -> None:
        self._world = world
        self._config = world.config
        self.axes = self._config.axes
        self._servos = [
            (bus.plant, index)
            for chain, bus in zip(self._config.chains, world.chains, strict=True)
            for index in range(len(chain.joints))
        ]

    def pass_time(self) -> None:
        self._world.pass_time()
        for bus in self._world.chains:
            bus.pass_time()

    @cached_property
    def spec(self) -> Any:
        from strands_actors.drivers.common.physics.model_rows import build

        table = body_table()
        rows = table["body_rows"] + table["wrist_rows"] + table["head_rows"]
        return build({**table, "model_rows": rows})

    @property
    def hands(self) -> Sequence[Hand]:
        steppers = self._world.steppers
        wheels = [steppers[name].hand for name in (LEFT, RIGHT)]
        base = Hand.WIRE if Hand.WIRE in wheels else wheels[0]
        servos = [plant.hand(at) for plant, at in self._servos]
        return [steppers[LIFT].hand, steppers[ARM].hand, *servos, base, base]

    def felt(self) -> Felt:
        world = self._world
        base = self._config.twist(*(world.metres_per_s(name) for name in (LEFT, RIGHT)))
        position = (world.metres(LIFT), world.metres(ARM), *self._rad(), *base)
        servos = [plant.velocity_rad_s[at] for plant, at in self._servos]
        velocity = (world.metres_per_s(LIFT), world.metres_per_s(ARM), *servos, 0.0, 0.0)
        return Felt(world.time_s, position, velocity, (0.0,) * len(self.axes), self.hands)

    def pose(self) -> Sequence[float]:
        """Return the pose in the order of the model's rows: base, lift and arm, wrist and gripper, head."""
        world = self._world
        rows = [world.metres(LIFT), world.metres(ARM)]
        wrist, head = (bus.plant for bus in world.chains)
        places = [*wrist.position_rad]
        if GRIPPER not in wrist.joints:
            places.append(0.0)
        return [*world.pose, *rows, *places, *head.position_rad]

    def take(self, on: bool) -> None:
        wanted, becomes = (Hand.NONE, Hand.SIM) if on else (Hand.SIM, Hand.NONE)
        for name, motor in self._world.steppers.items():
            if motor.hand is wanted:
                motor.let_go()
                if on:
                    self._hold(name)
                motor.hand = becomes
        for plant, at in self._servos:
            plant.take(at, on)

    def aim(self, values: Sequence[float]) -> None:
        world, config = self._world, self._config
        target = dict(zip(self.axes, values, strict=True))
        for name in (LIFT, ARM):
            motor, own = world.steppers[name], config.motors[name]
            if motor.hand is Hand.SIM:
                goal = min(max(target[name], own.low_m), own.high_m)
                command = config.goal(name, goal)
                motor.aim(command.position, command.velocity, command.acceleration)
        for name, speed in zip((LEFT, RIGHT), config.wheels(target["vx"], target["wz"]), strict=True):
            if world.steppers[name].hand is Hand.SIM:
                command = config.drive(name, speed)
                world.steppers[name].spin(command.velocity, command.acceleration)
        for (plant, at), value in zip(self._servos, values[2:-2], strict=True):
            plant.aim(at, value)

    def hold(self) -> None:
        for name, motor in self._world.steppers.items():
            if motor.hand is Hand.SIM:
                self._hold(name)
        for (plant, at), here in zip(self._servos, self._rad(), strict=True):
            plant.aim(at, here)

    def step(self, steps: int) -> None:
        self._world.run(steps * TIMESTEP_S)
        for bus in self._world.chains:
            bus.plant.step(steps)

    def reset(self) -> None:
        self._world.reset()

    def _rad(self) -> tuple[float, ...]:
        return tuple(plant.position_rad[at] for plant, at in self._servos)

    def _hold(self, name: str) -> None:
        motor = self._world.steppers[name]
        if name in (LEFT, RIGHT):
            motor.spin(0.0, 0.0)
        else:
            motor.aim(motor.position, 0.0, 0.0)
