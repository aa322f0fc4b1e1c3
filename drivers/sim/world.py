"""Send requests to a simulation that a real robot could not carry out: pictures, objects, saved states, a reset.

``control`` is the path of the socket for requests to the simulation. Every function raises ``RuntimeError`` if the
simulation refuses the request or does not answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient

T = TypeVar("T", bound=p.Frame)

PICTURE_S = 30.0
"""Longest time for a picture. The first one compiles shaders, and drawing in software on a busy machine is slow."""

RESET_S = 2.0
CHANGE_S = 10.0
"""Longest time for a change of the scene, which compiles the model again with all its meshes."""


class Picture(NamedTuple):
    """A picture in RGB, three bytes per pixel. The first row is the top."""

    width: int
    height: int
    rgb: bytes


async def render(control: str, width: int, height: int, camera: str, qpos: tuple[float, ...] = ()) -> Picture:
    """Draw one picture of the scene, as seen by ``camera``: of the state ``qpos``, or without values of the present
    state.

    Raises:
        RuntimeError: No picture could be drawn. The message has the reason.
    """
    picture = await _ask(control, p.Render(0, width, height, camera, qpos), p.Picture, PICTURE_S)
    return Picture(picture.width, picture.height, picture.rgb)


async def pose(control: str) -> tuple[tuple[float, ...], int]:
    """Return the present state ``qpos`` of the scene, and the number of the scene.

    Raises:
        RuntimeError: The simulation did not answer.
    """
    answer = await _ask(control, p.GetPose(0), p.Pose, RESET_S)
    return answer.qpos, answer.scene


async def reset(control: str) -> None:
    """Move every joint back to its initial position.

    Raises:
        RuntimeError: The simulation refused the reset, for example because the robot is energised.
    """
    await _ask(control, p.Reset(0), p.Sample, RESET_S)


async def add_object(control: str, fields: Mapping[str, Any]) -> None:
    """Put an object into the scene.

    Raises:
        RuntimeError: The simulation refused the object. The message has the reason.
    """
    await _ask(control, p.AddObject(0, **fields), p.Done, CHANGE_S)


async def remove_object(control: str, name: str) -> None:
    await _ask(control, p.RemoveObject(0, name), p.Done, CHANGE_S)


async def add_camera(control: str, fields: Mapping[str, Any]) -> None:
    await _ask(control, p.AddCamera(0, **fields), p.Done, CHANGE_S)


async def pause(control: str, on: bool) -> None:
    """Let the simulated time advance only by steps, or in real time again.

    Raises:
        RuntimeError: The simulation refused, or did not answer.
    """
    await _ask(control, p.Pause(0, on), p.Done, RESET_S)


async def set_light(control: str, fields: Mapping[str, Any]) -> None:
    await _ask(control, p.SetLight(0, **fields), p.Done, CHANGE_S)


async def objects(control: str) -> dict[str, tuple[float, ...]]:
    """Return position and orientation of each object that was added, by its name."""
    return (await _ask(control, p.GetObjects(0), p.Objects, RESET_S)).poses


async def save_state(control: str, name: str) -> None:
    await _ask(control, p.Save(0, name), p.Done, CHANGE_S)


async def load_state(control: str, name: str) -> None:
    """Restore a saved state.

    Raises:
        RuntimeError: The simulation refused to restore the state, for example because the robot is energised.
    """
    await _ask(control, p.Load(0, name), p.Sample, RESET_S)


async def _ask(control: str, request: p.Request, reply_type: type[T], within_s: float) -> T:
    try:
        client = SimulationClient(control)
        try:
            return await client.call(request, reply_type, within_s)
        finally:
            client.close()
    except (WireDown, Refusal) as failure:
        raise RuntimeError(str(failure)) from None


async def move_by_hand(control: str, targets: Mapping[str, float]) -> dict[str, float]:
    """Move the simulated robot to ``targets``, without a driver. Joints that a client of the real wire protocol
    drives do not move.

    Args:
        control: Path of the socket for requests to the simulation.
        targets: Radians by axis. An axis that is not named stays where it is.

    Returns:
        The target of every axis.

    Raises:
        RuntimeError: A name is no joint of the robot, or the simulation refused the request.
    """
    try:
        client = SimulationClient(control)
        try:
            axes = (await client.call(p.Handshake(0), p.Axes, RESET_S)).axes
            sample = await client.call(p.Take(0), p.Sample, RESET_S)
            goal = {**dict(zip(axes, sample.position, strict=True)), **targets}
            if unknown := [name for name in targets if name not in axes]:
                raise RuntimeError(f"the robot has no joint {', '.join(unknown)}. Use {', '.join(axes)}")
            client.tell(p.Aim(0, tuple(goal[axis] for axis in axes)))
            # The simulation handles messages in order, so this reply means that it has applied the targets.
            await client.call(p.Read(0), p.Sample, RESET_S)
        finally:
            client.close()
    except WireDown as failure:
        raise RuntimeError(str(failure)) from None
    return goal
