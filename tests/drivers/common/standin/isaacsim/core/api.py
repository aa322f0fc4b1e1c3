from __future__ import annotations

from typing import Any

import isaacsim


class Scene:
    def __init__(self) -> None:
        self.prims: list[Any] = []

    def add(self, prim: Any) -> Any:
        self.prims.append(prim)
        return prim


class PhysicsContext:
    def set_gravity(self, value: float) -> None:
        isaacsim.calls.append(("gravity", value))


class World:
    _instance: Any = None

    def __init__(self, physics_dt: float, rendering_dt: float, stage_units_in_meters: float) -> None:
        assert World._instance is None, "only one World can exist at a time"
        assert stage_units_in_meters == 1.0
        World._instance = self
        self._dt = physics_dt
        self.scene = Scene()

    @classmethod
    def clear_instance(cls) -> None:
        World._instance = None

    def get_physics_context(self) -> PhysicsContext:
        return PhysicsContext()

    def reset(self) -> None:
        for prim in self.scene.prims:
            prim.initialize()

    def step(self, render: bool = True) -> None:
        assert not render, "MuJoCo renders the pictures"
        for prim in self.scene.prims:
            prim.advance(self._dt)
