"""Draw pictures of a simulated scene, in the process of the camera that needs them.

The simulation, another process, sends its model once, and afterwards only the positions of the joints. So it needs
as little time for a picture as for a reading of the robot, and its physics does not wait while a picture is drawn.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import trio

from strands_actors.contract.cameras import CameraSettings, Picture
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient
from strands_actors.drivers.common.simulation_control.renderer import CannotRender, SceneRenderer, plain
from strands_actors.drivers.common.simulation_control.scene import View

MODEL_S = 10.0
POSE_S = 2.0


class ScenePictures:
    """One camera in one scene. If the scene has changed, the camera fetches the model again."""

    paced = False

    def __init__(self, client: SimulationClient, settings: CameraSettings) -> None:
        self._client = client
        self._view = settings.view
        width, height = settings.captured_size
        assert width is not None and height is not None
        self._size = width, height
        self._renderer: SceneRenderer | None = None
        self._scene = -1

    async def read(self) -> Picture:
        # The time before the request counts, so that a late answer counts as an old picture.
        captured_ns = time.monotonic_ns()
        pose = await self._client.call(p.GetPose(0), p.Pose, POSE_S)
        if pose.scene != self._scene:
            await self._take_scene()
            return await self.read()
        assert self._renderer is not None
        try:
            rgb = await trio.to_thread.run_sync(self._renderer.shoot, pose.qpos, *self._size, self._view)
        except CannotRender as failure:
            raise WireDown(str(failure)) from None
        width, height = self._size
        return Picture(np.frombuffer(rgb, np.uint8).reshape(height, width, 3), captured_ns)

    async def aclose(self) -> None:
        self._client.close()
        if self._renderer is not None:
            await trio.to_thread.run_sync(self._renderer.close)
            self._renderer = None

    async def _take_scene(self) -> None:
        answer = await self._client.call(p.GetModel(0), p.Model, MODEL_S)
        if self._renderer is not None:
            await trio.to_thread.run_sync(self._renderer.close)
            self._renderer = None
        self._renderer = await trio.to_thread.run_sync(self._build, answer.binary)
        self._scene = answer.scene

    def _build(self, binary: bytes) -> SceneRenderer:
        model: Any = plain(mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": binary}))
        view = View(tuple(model.stat.center), model.stat.extent)
        try:
            return SceneRenderer(model, view, *self._size)
        except CannotRender as failure:
            raise WireDown(str(failure)) from None


async def open_camera(settings: CameraSettings) -> ScenePictures:
    """Open a camera of a scene.

    Raises:
        WireDown: The scene has no such camera, the simulation does not answer, or no picture can be drawn.
    """
    client = SimulationClient(settings.port)
    source = ScenePictures(client, settings)
    try:
        await source._take_scene()
    except Refusal as refusal:
        client.close()
        raise WireDown(str(refusal)) from None
    except BaseException:
        client.close()
        raise
    return source
