"""The handle of one simulated robot: the methods of a robot, and those that only a simulation has."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, overload

from strands_actors.kernel.messages import Refused
from strands_actors.simulation import evaluation, film, scene
from strands_actors.simulation.film import Video
from strands_actors.simulation.handle import SimulationError, World, named
from strands_actors.simulation.png import encode_png
from strands_actors.supervisors import stop_result
from strands_actors.surfaces.agents.approval import Approval

from ..processes.plan import Plan
from . import envelopes as answers
from . import verbs
from .envelopes import Answer
from .real_robot import RealRobot
from .sim_recording import SimRecording

if TYPE_CHECKING:
    from strands_actors.simulation.picture import RenderedPicture


PICTURE = (640, 480)
"""Default width and height of a picture, in pixels."""
WHOLE = ("default", "free")
"""Names in strands-robots of the view of the whole robot."""


class SimRobot(RealRobot):
    """A simulated robot. ``Robot(name)`` makes it.

    It has the methods and results of ``RealRobot``, and methods that only a simulation can have. It starts at
    its first use. Between calls the physics runs in real time.

    ``Robot(name, mode="real", transport="twin", sim=this)`` connects the real driver to the same simulation,
    over the robot's real protocol. Joints that this driver energises then follow only the driver. This object
    refuses commands to these joints.

    Example:
        with Robot("so101") as sim:
            sim.add_object("cube", "box", position=[0.2, 0.0, 0.03])
            sim.move_to({"shoulder_pan": 30.0}, seconds=1.0)
            picture = sim.render(640, 480)
    """

    LAZY: ClassVar[frozenset[str]] = frozenset(
        {
            "move",
            "get_pose",
            "move_to",
            "move_along",
            "observe",
            "state",
            "resume",
            "run",
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
        # Width and height in pixels of each camera that was added.
        self._sizes: dict[str, tuple[int, int]] = {}
        self._recording = SimRecording()

    @overload
    def render(
        self, width: int | None = None, height: int | None = None, camera: str | None = None
    ) -> RenderedPicture: ...
    @overload
    def render(self, width: int | None = None, height: int | None = None, *, camera_name: str) -> Answer: ...
    def render(
        self,
        width: Any = None,
        height: Any = None,
        camera: Any = None,
        camera_name: str | None = None,
    ) -> Any:
        """Draw a picture of the scene, without a window, by EGL or OSMesa.

        Args:
            width: Width in pixels. None: that of the camera, or 640.
            height: Height in pixels. None: that of the camera, or 480.
            camera: ``front``, ``side``, ``top``, or a camera of the scene. None: a view of the whole
                robot.
            camera_name: The same as ``camera``, under its name in strands-robots. A string as the first
                argument is read as ``camera_name``. In both cases the result is an envelope. ``default`` is the
                whole robot.

        Returns:
            The picture, RGB, of shape (height, width, 3): an array that a notebook shows as a picture. With
            ``camera_name`` an envelope with a PNG, and the keys ``camera``, ``width``, ``height``; a failure is
            an error envelope.

        Raises:
            SimulationError: It cannot be drawn, for example because neither EGL nor OSMesa is there.
                The text names the system package. It is a ``RuntimeError``.
        """
        if isinstance(width, str):
            width, height, camera_name = height, camera, width
        elif camera_name is None:
            with named("render"):
                return self._render(width, height, camera)
        try:
            picture = self._render(width, height, None if camera_name in WHOLE else camera_name)
        except (SimulationError, TypeError, ValueError) as failure:
            return answers.error(f"render: {failure}")
        down, across, _ = picture.shape
        return answers.picture(encode_png(picture), {"camera": camera_name, "width": across, "height": down})

    def _render(self, width: int | None, height: int | None, camera: str | None) -> RenderedPicture:
        across, down = self._sizes.get(camera or "", PICTURE)
        return self._call(
            self._world.render, across if width is None else width, down if height is None else height, camera
        )

    def video(
        self,
        path: str | os.PathLike[str],
        seconds: float | None = None,
        *,
        fps: int = 25,
        width: int | None = None,
        height: int | None = None,
        camera: str | None = None,
    ) -> Video:
        """Film the simulation into a file.

        ``with sim.video("run.mp4"):`` films while the block runs. ``sim.video("run.mp4", seconds=5)`` films for
        five seconds, for example of a policy that runs in the background. The pictures are drawn when the film
        ends, which takes about as long as the film.

        Args:
            path: The file. ``.mp4`` needs the extra ``dataset``, ``.gif`` needs nothing.
            seconds: How long to film. None: use the result in a ``with`` statement.
            fps: Pictures per second, 1 to 50.
            width: As in ``render``.
            height: As in ``render``.
            camera: As in ``render``.

        Returns:
            The film, which has the file (``path``) and the number of its pictures (``frames``).

        Raises:
            SimulationError: The film cannot be drawn or written. The text has the reason.
            TypeError, ValueError: An argument is wrong.
        """
        across, down = self._sizes.get(camera or "", PICTURE)
        with named("video"):
            file, rate, size = film.checked(path, fps, width or across, height or down)
        video = film.Video(self._world, self._call, file, rate, size, camera)
        if seconds is None:
            return video
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds < math.inf:
            raise ValueError(f"seconds is {seconds!r}. Give a number above 0")
        return video.wait(seconds)

    def view(self) -> None:
        """Open MuJoCo's viewer, which shows the robot until the window is closed.

        Raises:
            SimulationError: There is no display, a package is missing, or the window did not open.
        """
        with named("view"):
            self._call(self._world.view)

    def get_observation(
        self, images: Any = False, *, robot_name: str | None = None, skip_images: bool | None = None
    ) -> dict[str, Any]:
        """As ``RealRobot.get_observation``, also with the keywords of strands-robots.

        Args:
            images: True adds the newest picture of each camera. A string is read as ``robot_name``.
            robot_name: The name of this robot, as in ``send_action``. Keyword of strands-robots.
            skip_images: The opposite of ``images``. Keyword of strands-robots.

        Raises:
            ValueError: ``robot_name`` is the name of another robot.
        """
        if isinstance(images, str):
            images, robot_name = False, images
        if refused := verbs.refuse_name(robot_name, self._plan, self.name, "get_observation"):
            raise ValueError(refused["content"][0]["text"])
        return super().get_observation(images if skip_images is None else not skip_images)

    def send_action(
        self, action: Mapping[str, Any], robot_name: str | None = None, n_substeps: int | None = None
    ) -> Answer:
        """As ``RealRobot.send_action``.

        Args:
            action: Target by joint, in the driver's units.
            robot_name: The name of this robot. The name of another robot is refused.
            n_substeps: Number of physics steps to compute with this action, as ``step`` does. None: the physics
                runs in real time.
        """
        if n_substeps is None:
            return super().send_action(action, robot_name)
        refused = verbs.refuse_name(robot_name, self._plan, self.name)
        return refused or self.step(n_substeps, action)

    def step(self, steps: int = 1, action: Mapping[str, Any] | None = None, n_steps: int | None = None) -> Answer:
        """Compute a number of steps of physics at once, as fast as the computer can.

        A target that was sent before is in force from the first step on. Deadlines and policies still use real
        time, and between two calls the physics runs in real time.

        Args:
            steps: Number of steps, of 2 ms each.
            action: A setpoint, as for ``send_action``, that is in force from the first step on. If it is
                refused, no step is computed.
            n_steps: Name of ``steps`` in strands-robots.

        Returns:
            Keys: ``position`` by joint after the last step, ``sim_time_s``. ``get_observation()``
            returns this position or a newer one.
        """
        return self.service("step", steps=steps if n_steps is None else n_steps, action=action)

    def reset(self) -> Answer:
        """Stop the robot, put every joint and object back to its start, and energise the robot.

        Returns:
            Key: ``position`` by joint.
        """
        return self._verb(functools.partial(self._restore_scene, "reset", self._world.reset), "reset")

    def save_state(self, name: str = "default") -> Answer:
        """Save the state of robot and objects under a name.

        Returns:
            Key: ``saved``, the name.
        """
        return self._change("save_state", lambda: (scene.state_name(name),), {"saved": name})

    def load_state(self, name: str = "default") -> Answer:
        """Stop the robot, restore a state that ``save_state`` has saved, and energise the robot.

        Returns:
            Key: ``position`` by joint.
        """
        return self._verb(
            functools.partial(self._restore_scene, "load_state", self._world.change, "load_state", name),
            "load_state",
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
        """Add an object to the scene.

        Args:
            name: Name of the object, at most 64 letters.
            shape: ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``.
            position: x, y, z in metres. None: the origin.
            orientation: Quaternion w, x, y, z. None: upright.
            size: Full extents in metres; of a mesh its scale. A box and a mesh have 3 numbers, a sphere
                1, a cylinder and a capsule 2 (width, length). None: 5 cm; a cylinder and a capsule are
                10 cm long; a mesh is not scaled.
            color: r, g, b, or r, g, b, a; each 0 to 1. None: grey.
            mass: Kilograms, above 0.
            is_static: True: the object does not move.
            mesh_path: File of a mesh.

        Returns:
            Key: ``added``, the name.
        """
        arguments = (name, shape, position, orientation, size, color, mass, is_static, mesh_path)
        return self._change("add_object", lambda: (scene.object_fields(*arguments),), {"added": name})

    def remove_object(self, name: str) -> Answer:
        """Remove an object that ``add_object`` has added.

        Returns:
            Key: ``removed``, the name.
        """
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
        """Add a camera to the scene, for ``render(camera=name)``.

        Args:
            name: Name of the camera, at most 64 letters.
            position: x, y, z in metres, in the world or in ``parent_body``. None: 0.5, 0.5, 0.5.
            target: The point that the camera looks at, in the same frame. None: the origin.
            fov: Vertical angle of view in degrees, above 0 and below 180.
            width: Width of its pictures in pixels.
            height: Height of its pictures in pixels.
            parent_body: A body of the model that carries the camera. None: the camera stands still.

        Returns:
            Key: ``added``, the name.
        """
        arguments = (name, position, target, fov, parent_body)

        def fields() -> tuple[dict[str, Any]]:
            scene.check_size(width, height)
            return (scene.camera_fields(*arguments),)

        answer = self._change("add_camera", fields, {"added": name})
        if answer["status"] == "success":
            self._sizes[name] = (width, height)
        return answer

    def set_light(self, brightness: float = 1.0, azimuth: float = -52.1, elevation: float = 55.2) -> Answer:
        """Change the light of the pictures of the scene.

        Args:
            brightness: 0 to 10; 1 is the usual light.
            azimuth: Direction from which the main lamp shines, in degrees: 0 is along x, 90 along y.
            elevation: Its height above the horizon in degrees, above 0 and at most 90.

        Returns:
            Key: ``brightness``.
        """
        return self._change(
            "set_light",
            lambda: (scene.light_fields(brightness, azimuth, elevation),),
            {"brightness": brightness},
        )

    def get_objects(self) -> Answer:
        """Return where the objects are that ``add_object`` has added.

        Returns:
            For each object, under its name, the keys ``position`` (x, y, z in metres) and ``orientation``
            (quaternion w, x, y, z).
        """
        try:
            poses = self._call(self._world.objects)
        except SimulationError as failure:
            return answers.error(f"get_objects: {failure}")
        return answers.success(
            {name: {"position": list(pose[:3]), "orientation": list(pose[3:])} for name, pose in poses.items()}
        )

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
        """As ``RealRobot.run_policy``, also with the keywords of strands-robots.

        These are ``robot_name`` (or a robot's name as the first argument), ``policy_object``,
        ``policy_provider`` and ``policy_config``. With any of them the call returns when the policy has
        ended, as in strands-robots, unless ``wait`` is given. The keys are those of ``RealRobot.run_policy``.

        Args:
            policy: The policy. A string is read as ``robot_name``.
            instruction: As in ``RealRobot.run_policy``.
            duration: As in ``RealRobot.run_policy``.
            n_steps: As in ``RealRobot.run_policy``.
            control_frequency: As in ``RealRobot.run_policy``.
            policy_object: Another name of ``policy``. Keyword of strands-robots.
            wait: True returns when the policy has ended, False at once. None: wait if a keyword of
                strands-robots is given.
            robot_name: The name of this robot, as in ``send_action``.
            policy_provider: Name of a policy to create. None: ``mock``, if no policy is given.
            policy_config: Keyword arguments for ``create_policy``.
        """
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
            return answers.error("run_policy: a policy and a policy_provider are both given. Give one of them")
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
        """Begin an episode of a dataset in LeRobot's format.

        It records commands and readings until ``stop_recording()``. The name is that of strands-robots.
        ``record_dataset`` can do more.

        Args:
            repo_id: ``owner/name``, in LeRobot's folder, or a path.
            task: A sentence that describes the episode.
            fps: Frames per second.
            root: Folder of the dataset, in place of ``repo_id``. An existing dataset gets one more episode.
            push_to_hub: True is refused, since this package uploads nothing.
            vcodec: ``av1`` or ``mpeg4``; ``h264`` is recorded as ``mpeg4``. None: that of the dataset.
            overwrite: Remove an existing dataset first.
            cameras: Names of the robot's cameras (``cameras=``); None for all cameras.

        Returns:
            Keys: ``recording``, ``repo_id``, ``root``, ``task``, ``fps``.
        """
        if push_to_hub:
            return answers.error(
                "start_recording: nothing is uploaded here. Upload its folder with LeRobot's tools"
            )
        ready = self._ready("observe")
        if isinstance(ready, str):
            return answers.error(f"start_recording: {ready}")
        names = self._cameras.names if cameras is None else cameras
        return self._recording.start(self, repo_id, task, fps, root, vcodec, overwrite, names)

    def stop_recording(self) -> Answer:
        """End the episode that ``start_recording`` began, and save it.

        Returns:
            Keys: ``recording`` (false), those of ``start_recording``, and those of the saved episode.
        """
        return self._recording.stop()

    def get_recording_status(self) -> Answer:
        """Return whether an episode is being recorded, with the keys of ``start_recording``."""
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
        """Run a policy for some episodes, as fast as the physics is computed. Each begins with a reset.

        Args:
            policy_provider: Name of the policy, for ``create_policy``.
            policy_config: Its keyword arguments.
            instruction: Text for the policy.
            n_episodes: Number of episodes.
            max_steps: Number of actions after which an episode ends.
            success_fn: Function of an observation. If it returns a true value, the episode ends as a
                success. None: episodes are not judged.
            policy_object: The policy, in place of ``policy_provider``.
            control_frequency: Actions per second, above 0 and at most 500. None: the driver's control
                rate.
            seed: Seed of the first episode; each further episode has a seed that is greater by 1. None: the
                policy gets no seed.
            robot_name: As in ``send_action``.

        Returns:
            Keys: ``n_episodes``, ``success_rate`` (0 to 1; null without ``success_fn``), ``episodes`` (for each
            the keys ``episode``, ``seed``, ``steps``, ``success``).
        """
        if refused := verbs.refuse_name(robot_name, self._plan, self.name):
            return refused
        hz = self._driver.timing.control_hz if control_frequency is None else control_frequency
        try:
            result = evaluation.evaluate_checked(
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
        return answers.success(result)

    def _change(self, verb: str, read: Callable[[], tuple[Any, ...]], done: dict[str, Any]) -> Answer:
        """Change the scene.

        The function ``read`` checks the arguments, and returns the arguments for the simulation.
        """
        try:
            self._call(self._world.change, verb, *read())
        except (ValueError, SimulationError) as failure:
            return answers.error(f"{verb}: {failure}")
        return answers.success(done)

    async def _restore_scene(self, verb: str, put_back: Callable[..., Awaitable[None]], *arguments: Any) -> Answer:
        """Stop the robot, restore the scene with ``put_back``, and energise the robot again.

        The last item of ``arguments`` is the tree. The items before it are the arguments of ``put_back``.
        """
        *restore_arguments, tree = arguments
        result = await tree.stop()
        if not isinstance(result, stop_result.Confirmed):
            return answers.stop_result("stop", result)
        try:
            await put_back(*restore_arguments)
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
        """As ``RealRobot.cleanup``. It also saves a recording that runs, and closes the simulation."""
        if not self._closed and self._forked is None:
            answers.warn_unless_safe(self.name, self._recording.stop())
        answer = super().cleanup()
        self._call(self._world.close)
        return answer
