"""Note when a link of a simulated robot touches the floor, and how fast it was then.

An arm that is switched off falls on the table, and the speed at that moment is what damages it. In a simulation the
floor is the table on which the arm stands.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .lean_mujoco import mujoco
from .solver import Solver

APART_S = 0.1
"""A link that was away from the floor for so long touches anew. Before that it only bounces."""


RESTS_RAD_S = 0.02
AT_ONCE = 26
"""So many steps of an arm at rest, 50 ms, may be computed at once."""


class Touch(NamedTuple):
    """A link has touched the floor.

    Attributes:
        time_s: The simulated time.
        body: The name of the link.
        speed_m_s: The speed of the point of contact immediately before.
    """

    time_s: float
    body: str
    speed_m_s: float


class TouchWatch:
    """A solver that also notes touches. It computes one time step after the other, since a touch is short.

    Args:
        solver: The solver that computes the steps.
        model: The model, with a floor of the name ``floor``.
    """

    max_steps: int

    def __init__(self, solver: Solver, model: Any) -> None:
        self._solver = solver
        self.max_steps = solver.max_steps
        self._floor = int(model.geom("floor").id)
        self._contacts = 0
        self._touching: set[int] = set()
        self._left_s: dict[int, float] = {}
        self.touches: list[Touch] = []
        """The touches that were not taken yet."""

    def step(self, model: Any, data: Any, steps: int) -> None:
        if steps < AT_ONCE and float(np.abs(data.qvel).max()) < RESTS_RAD_S:
            # Nothing can touch the floor fast within so few steps.
            self._solver.step(model, data, steps)
            self._contacts = -1
            return
        for _ in range(steps):
            before = data.qvel.copy()
            self._solver.step(model, data, 1)
            # Most of the time an arm touches nothing, or lies still, and nothing changes.
            if data.ncon != self._contacts:
                self._contacts = data.ncon
                self._note(model, data, before)

    def _note(self, model: Any, data: Any, before: Any) -> None:
        now_s = float(data.time)
        points = {
            int(model.geom_bodyid[second if first == self._floor else first]): contact.pos
            for contact in data.contact[: data.ncon]
            if self._floor in (first := int(contact.geom1), second := int(contact.geom2))
        }
        for body in self._touching - points.keys():
            self._left_s[body] = now_s
        for body in points.keys() - self._touching:
            if now_s - self._left_s.get(body, -APART_S) >= APART_S:
                jacobian = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, jacobian, None, points[body], body)
                speed_m_s = float(np.linalg.norm(jacobian @ before))
                self.touches.append(Touch(now_s, str(model.body(body).name), speed_m_s))
        self._touching = set(points)
