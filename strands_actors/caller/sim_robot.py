"""A handle on one simulated robot: what only a simulation can do, beside a robot's verbs."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from strands_actors.kernel.messages import Refused
from strands_actors.simulation import evaluation, scene
from strands_actors.simulation.handle import SimulationError, World
from strands_actors.supervisors import stop_result
from strands_actors.surfaces.agents.approval import Approval

from . import envelopes as answers
from . import verbs
from .envelopes import Answer
from .plan import Plan
from .real_robot import RealRobot

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


PICTURE = (640, 480)
"""Width and height of a picture that nobody gave a size, in pixels."""


class SimRobot(RealRobot):
    """A simulated robot. Made by ``Robot(...)``; the verbs of a real one, and what only a
    simulation can do.

    It starts at its first use. ``transport="twin", sim=`` puts a real driver on its wire: joints
    that are energised there follow the wire, and a command to them here is refused.
    """

    LAZY: ClassVar[frozenset[str]] = frozenset(
        {"move", "move_to", "observe", "state", "resume", "run_policy", "start_task", "reset", "load_state", "step"}
    )
    OTHERS_CONNECT: ClassVar[bool] = True

    def __init__(self, plan: Plan, approval: Approval | None = None, arm: bool = True) -> None:
        super().__init__(plan, approval, arm)
        assert plan.twin_process is not None
        self._world = World(plan.twin_process)
        self._sizes: dict[str, tuple[int, int]] = {}  # of cameras that were added, width and height

    def render(
        self, width: int | None = None, height: int | None = None, camera: str | None = None
    ) -> NDArray[numpy.uint8]:
        """Return a picture, (height, width, 3), drawn without a window by EGL or OSMesa.
        ``camera``: None for the whole robot, ``front``, ``side``, ``top``, or one of the scene's
        own. Without a size it is the camera's, or 640 x 480. Raise ``SimulationError`` (a
        ``RuntimeError``) that names the system package when neither is there."""
        across, down = self._sizes.get(camera or "", PICTURE)
        return self._call(
            self._world.render, across if width is None else width, down if height is None else height, camera
        )

    def view(self) -> None:
        """Open MuJoCo's viewer, which mirrors the robot until it is closed. Raise
        ``SimulationError`` without a display."""
        self._call(self._world.view)

    def step(self, steps: int = 1, action: Mapping[str, Any] | None = None) -> Answer:
        """Let so many steps of physics, of 2 ms each, pass at once, as fast as they are computed.
        Answers with ``position`` after them and ``sim_time_s``. A target that was sent before
        counts from the first step on, and so does ``action``, joints by name as ``send_action``
        takes them; when that is refused, no step passes. ``get_observation`` gives what came of
        it, or is newer. Deadlines, leases and rollouts are of the clock all the same, and between
        calls the physics keeps to it."""
        return self.service("step", steps=steps, action=action)

    def reset(self) -> Answer:
        """Stop, put every joint and every object back to where it began, energise."""
        return self._verb(functools.partial(self._back, self._world.reset), "reset")

    def save_state(self, name: str = "default") -> Answer:
        """Keep all that moves, robot and objects, under a name."""
        return self._change("save_state", lambda: (scene.state_name("save_state", name),), {"saved": name})

    def load_state(self, name: str = "default") -> Answer:
        """Stop, put everything back to where it was saved, energise."""
        return self._verb(functools.partial(self._back, self._world.change, "load_state", name), "load_state")

    def add_object(
        self,
        name: str,
        shape: str = "box",
        position: Sequence[float] | None = None,
        orientation: Sequence[float] | None = None,
        size: Sequence[float] | None = None,
        color: Sequence[float] | None = None,
        mass: float = 0.1,
        is_static: bool | None = None,
        mesh_path: str | os.PathLike[str] | None = None,
    ) -> Answer:
        """Put an object into the scene: ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``.
        ``size``: full extents in metres (of a mesh: its scale); ``mass`` in kilograms;
        ``is_static``: it does not move."""
        told = (name, shape, position, orientation, size, color, mass, is_static, mesh_path)
        return self._change("add_object", lambda: (scene.object_fields(*told),), {"added": name})

    def remove_object(self, name: str) -> Answer:
        """Take an object that was added out of the scene."""
        return self._change("remove_object", lambda: (scene.state_name("remove_object", name),), {"removed": name})

    def add_camera(
        self,
        name: str,
        position: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        fov: float = 60.0,
        width: int = PICTURE[0],
        height: int = PICTURE[1],
        parent_body: str | None = None,
    ) -> Answer:
        """Put a camera into the scene, for ``render(camera=name)``. ``position`` and ``target`` in
        metres, of the world, or of ``parent_body``, which carries it then; ``fov``: its vertical
        angle in degrees; ``width`` and ``height``: of its pictures, in pixels."""
        told = (name, position, target, fov, parent_body)

        def fields() -> tuple[dict[str, Any]]:
            scene.check_size("add_camera", width, height)
            return (scene.camera_fields(*told),)

        answer = self._change("add_camera", fields, {"added": name})
        if answer["status"] == "success":
            self._sizes[name] = (width, height)
        return answer

    def eval_policy(
        self,
        policy_provider: str = "mock",
        policy_config: Mapping[str, Any] | None = None,
        instruction: str = "",
        n_episodes: int = 1,
        max_steps: int = 300,
        success_fn: Callable[[Mapping[str, float]], object] | None = None,
        policy_object: Any = None,
        control_frequency: float | None = None,
        seed: int | None = None,
        robot_name: str | None = None,
    ) -> Answer:
        """Try a policy, episode by episode, each from ``reset()`` on and as fast as the physics is
        computed. An episode ends after ``max_steps`` actions, or when ``success_fn`` says so of an
        observation; without that there is no ``success_rate``. ``policy_object``: the policy; else
        ``create_policy(policy_provider, **policy_config)``."""
        if refused := verbs.refuse_name(robot_name, self._plan, self.name):
            return refused
        hz = self._driver.timing.control_hz if control_frequency is None else control_frequency
        try:
            found = evaluation.evaluate_checked(
                self,
                policy_object,
                policy_provider,
                policy_config,
                self._driver.axes,
                hz,
                instruction,
                n_episodes,
                max_steps,
                success_fn,
                seed,
            )
        except (TypeError, ValueError, evaluation.Failed) as failure:
            return answers.error(f"eval_policy: {failure}")
        return answers.success(found)

    def _change(self, verb: str, read: Callable[[], tuple[Any, ...]], done: dict[str, Any]) -> Answer:
        """Change the scene. ``read`` gives what goes to the simulation, or refuses it."""
        try:
            self._call(self._world.change, verb, *read())
        except (ValueError, SimulationError) as failure:
            text = str(failure)
            return answers.error(text if text.startswith(f"{verb}: ") else f"{verb}: {text}")
        return answers.success(done)

    async def _back(self, *where: Any) -> Answer:
        """Stop, do what the simulation is told, energise. The last argument is the tree."""
        *told, tree = where
        result = await tree.stop()
        if not isinstance(result, stop_result.Confirmed):
            return answers.stop_result("stop", result)
        try:
            await told[0](*told[1:])
        except SimulationError as failure:
            problem = str(failure)
        else:
            problem = ""
        answer = await tree.resume()
        if problem:
            return answers.error(problem)
        if isinstance(answer, Refused):
            return answers.refused(answer)
        return answers.success({"position": tree.driver.observed(answer.observation)})

    def cleanup(self) -> Answer:
        answer = super().cleanup()
        self._call(self._world.close)
        return answer
