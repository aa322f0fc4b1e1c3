"""A handle on one simulated robot: what only a simulation can do, beside a robot's verbs."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, overload

from strands_actors.kernel.messages import Refused
from strands_actors.simulation import evaluation, scene
from strands_actors.simulation.handle import SimulationError, World
from strands_actors.simulation.png import encode_png
from strands_actors.supervisors import stop_result
from strands_actors.surfaces.agents.approval import Approval

from . import envelopes as answers
from . import verbs
from .envelopes import Answer
from .plan import Plan
from .real_robot import RealRobot
from .sim_recording import SimRecording

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray


PICTURE = (640, 480)
"""Width and height of a picture that nobody gave a size, in pixels."""
WHOLE = ("default", "free")
"""strands-robots' names of the view of the whole robot."""


class SimRobot(RealRobot):
    """A simulated robot. Made by ``Robot(...)``; the verbs of a real one, and what only a
    simulation can do.

    It starts at its first use. ``transport="twin", sim=`` puts a real driver on its wire: joints
    that are energised there follow the wire, and a command to them here is refused.
    """

    LAZY: ClassVar[frozenset[str]] = frozenset(
        {
            "move",
            "move_to",
            "move_along",
            "observe",
            "state",
            "resume",
            "run_policy",
            "start_task",
            "reset",
            "load_state",
            "step",
        }
    )
    OTHERS_CONNECT: ClassVar[bool] = True

    def __init__(self, plan: Plan, approval: Approval | None = None, arm: bool = True) -> None:
        super().__init__(plan, approval, arm)
        assert plan.twin_process is not None
        self._world = World(plan.twin_process)
        self._sizes: dict[str, tuple[int, int]] = {}  # of cameras that were added, width and height
        self._recording = SimRecording()

    @overload
    def render(
        self, width: int | None = None, height: int | None = None, camera: str | None = None
    ) -> NDArray[numpy.uint8]: ...
    @overload
    def render(self, width: int | None = None, height: int | None = None, *, camera_name: str) -> Answer: ...
    def render(
        self,
        width: Any = None,
        height: Any = None,
        camera: Any = None,
        camera_name: str | None = None,
    ) -> Any:
        """Return a picture, (height, width, 3), drawn without a window by EGL or OSMesa.
        ``camera``: None for the whole robot, ``front``, ``side``, ``top``, or one of the scene's
        own. Without a size it is the camera's, or 640 x 480. Raise ``SimulationError`` (a
        ``RuntimeError``) that names the system package when neither is there.

        ``camera_name``, or a name in the first place, is the word of strands-robots: the picture is
        a PNG in an answer, and so is what went wrong. ``default`` is the whole robot there."""
        if isinstance(width, str):
            width, height, camera_name = height, camera, width
        elif camera_name is None:
            with _named("render"):
                return self._render(width, height, camera)
        try:
            picture = self._render(width, height, None if camera_name in WHOLE else camera_name)
        except (SimulationError, TypeError, ValueError) as failure:
            return answers.error(f"render: {failure}")
        down, across, _ = picture.shape
        return answers.picture(encode_png(picture), {"camera": camera_name, "width": across, "height": down})

    def _render(self, width: int | None, height: int | None, camera: str | None) -> NDArray[numpy.uint8]:
        across, down = self._sizes.get(camera or "", PICTURE)
        return self._call(
            self._world.render, across if width is None else width, down if height is None else height, camera
        )

    def view(self) -> None:
        """Open MuJoCo's viewer, which mirrors the robot until it is closed. Raise
        ``SimulationError`` without a display."""
        with _named("view"):
            self._call(self._world.view)

    def get_observation(
        self, images: Any = False, *, robot_name: str | None = None, skip_images: bool | None = None
    ) -> dict[str, Any]:
        """As ``Robot.get_observation``. In the words of strands-robots: ``robot_name`` (or that name in
        the first place) and ``skip_images``. Raise ``ValueError`` for another robot's name."""
        if isinstance(images, str):
            images, robot_name = False, images
        if refused := verbs.refuse_name(robot_name, self._plan, self.name, "get_observation"):
            raise ValueError(refused["content"][0]["text"])
        return super().get_observation(images if skip_images is None else not skip_images)

    def send_action(
        self, action: Mapping[str, Any], robot_name: str | None = None, n_substeps: int | None = None
    ) -> Answer:
        """As ``Robot.send_action``. ``n_substeps``: so many steps of physics pass with it, as
        ``step`` does."""
        if n_substeps is None:
            return super().send_action(action, robot_name)
        refused = verbs.refuse_name(robot_name, self._plan, self.name)
        return refused or self.step(n_substeps, action)

    def step(self, steps: int = 1, action: Mapping[str, Any] | None = None, n_steps: int | None = None) -> Answer:
        """Let so many steps of physics, of 2 ms each, pass at once, as fast as they are computed.
        Answers with ``position`` after them and ``sim_time_s``. A target that was sent before
        counts from the first step on, and so does ``action``, joints by name as ``send_action``
        takes them; when that is refused, no step passes. ``get_observation`` gives what came of
        it, or is newer. Deadlines, leases and rollouts are of the clock all the same, and between
        calls the physics keeps to it. ``n_steps``: strands-robots' word for ``steps``."""
        return self.service("step", steps=steps if n_steps is None else n_steps, action=action)

    def reset(self) -> Answer:
        """Stop, put every joint and every object back to where it began, energise."""
        return self._verb(functools.partial(self._back, "reset", self._world.reset), "reset")

    def save_state(self, name: str = "default") -> Answer:
        """Keep all that moves, robot and objects, under a name."""
        return self._change("save_state", lambda: (scene.state_name(name),), {"saved": name})

    def load_state(self, name: str = "default") -> Answer:
        """Stop, put everything back to where it was saved, energise."""
        return self._verb(
            functools.partial(self._back, "load_state", self._world.change, "load_state", name), "load_state"
        )

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
        return self._change("remove_object", lambda: (scene.state_name(name),), {"removed": name})

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
            scene.check_size(width, height)
            return (scene.camera_fields(*told),)

        answer = self._change("add_camera", fields, {"added": name})
        if answer["status"] == "success":
            self._sizes[name] = (width, height)
        return answer

    def run_policy(
        self,
        policy: Any = None,
        instruction: str = "",
        duration: float = 30.0,
        n_steps: int | None = None,
        control_frequency: float | None = None,
        policy_object: Any = None,
        wait: bool | None = None,
        robot_name: str | None = None,
        policy_provider: str | None = None,
        policy_config: Mapping[str, Any] | None = None,
    ) -> Answer:
        """As ``Robot.run_policy``. In the words of strands-robots, ``robot_name`` (or that name in the
        first place), ``policy_object``, ``policy_provider`` and ``policy_config``, it returns when the
        policy has ended, as it does there, unless ``wait`` says otherwise. The provider is then
        ``mock`` where no policy is given."""
        if isinstance(policy, str):
            policy, robot_name = None, policy if robot_name is None else robot_name
        theirs = any(word is not None for word in (robot_name, policy_object, policy_provider, policy_config))
        if theirs and policy is None and policy_object is None:
            from strands_actors.policies import create_policy

            try:
                policy_object = create_policy(policy_provider or "mock", **dict(policy_config or {}))
            except (TypeError, ValueError) as failure:
                return answers.error(f"run_policy: {failure}")
        elif policy_provider is not None or policy_config is not None:
            return answers.error("run_policy: a policy and a policy_provider are both given. give one of them")
        waits = theirs if wait is None else wait
        return super().run_policy(
            policy, instruction, duration, n_steps, control_frequency, policy_object, waits, robot_name
        )

    def start_recording(
        self,
        repo_id: str = "local/sim_recording",
        task: str = "",
        fps: int = 30,
        root: str | os.PathLike[str] | None = None,
        push_to_hub: bool = False,
        vcodec: str | None = None,
        overwrite: bool = False,
        cameras: Sequence[str] | None = None,
    ) -> Answer:
        """Begin an episode of a dataset in LeRobot's format, as strands-robots calls it; ``record_dataset``
        has more. What the robot is told and does is recorded until ``stop_recording()``.

        Args:
            repo_id: ``owner/name``, in LeRobot's folder, or a path.
            task: A sentence that says what is shown.
            fps: Frames a second.
            root: The dataset's folder, in place of ``repo_id``. One that is there grows.
            push_to_hub: Refused: nothing is uploaded here.
            vcodec: ``av1`` or ``mpeg4``; ``h264`` is recorded as ``mpeg4``. None: the dataset's own.
            overwrite: Remove a dataset that is there first.
            cameras: Names of the robot's cameras (``cameras=``). None: all of them.
        """
        if push_to_hub:
            return answers.error(
                "start_recording: nothing is uploaded here. upload its folder with LeRobot's tools"
            )
        ready = self._ready("observe")
        if isinstance(ready, str):
            return answers.error(f"start_recording: {ready}")
        names = self._cameras.names if cameras is None else cameras
        return self._recording.start(self, repo_id, task, fps, root, vcodec, overwrite, names)

    def stop_recording(self) -> Answer:
        """End the episode that ``start_recording`` began, and save it."""
        return self._recording.stop()

    def get_recording_status(self) -> Answer:
        """Return whether an episode is being recorded, and where."""
        return self._recording.status()

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
            return answers.error(f"{verb}: {failure}")
        return answers.success(done)

    async def _back(self, verb: str, put_back: Callable[..., Awaitable[None]], *where: Any) -> Answer:
        """Stop, put everything back, energise. The last argument is the tree."""
        *told, tree = where
        result = await tree.stop()
        if not isinstance(result, stop_result.Confirmed):
            return answers.stop_result("stop", result)
        try:
            await put_back(*told)
        except SimulationError as failure:
            problem = str(failure)
        else:
            problem = ""
        answer = await tree.resume()
        if problem:
            return answers.error(f"{verb}: {problem}")
        if isinstance(answer, Refused):
            return answers.refused(answer)
        return answers.success({"position": tree.driver.observed(answer.observation)})

    def cleanup(self) -> Answer:
        if not self._closed and self._forked is None:
            answers.warn_unless_safe(self.name, self._recording.stop())
        answer = super().cleanup()
        self._call(self._world.close)
        return answer


@contextlib.contextmanager
def _named(verb: str) -> Iterator[None]:
    """Name the verb in what it raises."""
    try:
        yield
    except SimulationError as failure:
        raise SimulationError(f"{verb}: {failure}") from None
