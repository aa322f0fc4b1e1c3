"""The body of the simulated Stretch, which a physics simulation in another process can move.

A part that a client of the simulated robot commands follows this client instead of the physics simulation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt
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
    def commanders(self) -> Sequence[Commander]:
        steppers = self._world.steppers
        wheels = [steppers[name].commander for name in (LEFT, RIGHT)]
        base = Commander.WIRE if Commander.WIRE in wheels else wheels[0]
        servos = [plant.commander(index) for plant, index in self._servos]
        return [steppers[LIFT].commander, steppers[ARM].commander, *servos, base, base]

    def felt(self) -> Felt:
        world = self._world
        base = self._config.twist(*(world.metres_per_s(name) for name in (LEFT, RIGHT)))
        position = (world.metres(LIFT), world.metres(ARM), *self._rad(), *base)
        servos = [plant.velocity_rad_s[index] for plant, index in self._servos]
        velocity = (world.metres_per_s(LIFT), world.metres_per_s(ARM), *servos, 0.0, 0.0)
        return Felt(world.time_s, position, velocity, (0.0,) * len(self.axes), self.commanders)

    def pose(self) -> Sequence[float]:
        """Return the joint positions in the order of the simulation model: base, lift and arm, wrist and
        gripper, head."""
        world = self._world
        rows = [world.metres(LIFT), world.metres(ARM)]
        wrist, head = (bus.plant for bus in world.chains)
        positions = [*wrist.position_rad]
        if GRIPPER not in wrist.joints:
            positions.append(0.0)
        return [*world.pose, *rows, *positions, *head.position_rad]

    def energise(self, on: bool) -> None:
        previous, commander = (Commander.NONE, Commander.SIM) if on else (Commander.SIM, Commander.NONE)
        for name, motor in self._world.steppers.items():
            if motor.commander is previous:
                motor.release()
                if on:
                    self._hold(name)
                motor.commander = commander
        for plant, index in self._servos:
            plant.energise(index, on)

    def set_targets(self, values: Sequence[float]) -> None:
        world, config = self._world, self._config
        target = dict(zip(self.axes, values, strict=True))
        for name in (LIFT, ARM):
            motor, own = world.steppers[name], config.motors[name]
            if motor.commander is Commander.SIM:
                goal = min(max(target[name], own.low_m), own.high_m)
                command = config.goal(name, goal)
                motor.aim(command.position, command.velocity, command.acceleration)
        for name, speed in zip((LEFT, RIGHT), config.wheels(target["vx"], target["wz"]), strict=True):
            if world.steppers[name].commander is Commander.SIM:
                command = config.drive(name, speed)
                world.steppers[name].spin(command.velocity, command.acceleration)
        for (plant, index), value in zip(self._servos, values[2:-2], strict=True):
            plant.set_simulation_target(index, value)

    def hold(self) -> None:
        for name, motor in self._world.steppers.items():
            if motor.commander is Commander.SIM:
                self._hold(name)
        for (plant, index), position_rad in zip(self._servos, self._rad(), strict=True):
            plant.set_simulation_target(index, position_rad)

    def step(self, steps: int) -> None:
        self._world.run(steps * TIMESTEP_S)
        for bus in self._world.chains:
            bus.plant.step(steps)

    def reset(self) -> None:
        self._world.reset()

    def _rad(self) -> tuple[float, ...]:
        return tuple(plant.position_rad[index] for plant, index in self._servos)

    def _hold(self, name: str) -> None:
        motor = self._world.steppers[name]
        if name in (LEFT, RIGHT):
            motor.spin(0.0, 0.0)
        else:
            motor.aim(motor.position, 0.0, 0.0)
