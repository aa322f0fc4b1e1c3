"""Requests to a simulation that are no verbs of the robot: pictures, objects, saved states, a reset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient

T = TypeVar("T", bound=p.Frame)

PICTURE_S = 30.0
"""The first picture compiles shaders, and drawing in software on a busy machine is slow."""

RESET_S = 2.0
CHANGE_S = 10.0
"""A change compiles the model anew, with all its meshes."""


class Picture(NamedTuple):
    """A picture: rows from the top, three bytes per pixel."""

    width: int
    height: int
    rgb: bytes


async def render(control: str, width: int, height: int, camera: str) -> Picture:
    """Draw one picture.

    Raises:
        RuntimeError: There is no picture. The text is the reason.
    """
    picture = await _ask(control, p.Render(0, width, height, camera), p.Picture, PICTURE_S)
    return Picture(picture.width, picture.height, picture.rgb)


async def reset(control: str) -> None:
    """Put every joint back to where it began.

    Raises:
        RuntimeError: It was refused, as while the robot on the wire is energised.
    """
    await _ask(control, p.Reset(0), p.Sample, RESET_S)


async def add_object(control: str, fields: Mapping[str, Any]) -> None:
    """Put an object into the scene.

    Raises:
        RuntimeError: It was refused. All functions of this module raise it then.
    """
    await _ask(control, p.AddObject(0, **fields), p.Done, CHANGE_S)


async def remove_object(control: str, name: str) -> None:
    await _ask(control, p.RemoveObject(0, name), p.Done, CHANGE_S)


async def add_camera(control: str, fields: Mapping[str, Any]) -> None:
    await _ask(control, p.AddCamera(0, **fields), p.Done, CHANGE_S)


async def save_state(control: str, name: str) -> None:
    await _ask(control, p.Save(0, name), p.Done, CHANGE_S)


async def load_state(control: str, name: str) -> None:
    """Restore a saved state.

    Raises:
        RuntimeError: It was refused, as while the robot on the wire is energised.
    """
    await _ask(control, p.Load(0, name), p.Sample, RESET_S)


async def _ask(control: str, request: p.Request, kind: type[T], within_s: float) -> T:
    try:
        client = SimulationClient(control)
        try:
            return await client.call(request, kind, within_s)
        finally:
            client.close()
    except (WireDown, Refusal) as failure:
        raise RuntimeError(str(failure)) from None


async def move_by_hand(control: str, targets: Mapping[str, float]) -> dict[str, float]:
    """Take the joints that the wire does not hold, and move the robot to ``targets``.

    Args:
        targets: Radians by axis. An axis that is not named stays where it is.

    Returns:
        The target of every axis.

    Raises:
        RuntimeError: A name is no joint, or the simulation refused it.
    """
    try:
        client = SimulationClient(control)
        try:
            axes = (await client.call(p.Handshake(0), p.Axes, RESET_S)).axes
            sample = await client.call(p.Take(0), p.Sample, RESET_S)
            goal = {**dict(zip(axes, sample.position, strict=True)), **targets}
            if unknown := [name for name in targets if name not in axes]:
                raise RuntimeError(f"{', '.join(unknown)} is none of its joints. it has {', '.join(axes)}")
            client.tell(p.Aim(0, tuple(goal[axis] for axis in axes)))
            # Messages are handled in order, so this reply means that Aim was applied.
            await client.call(p.Read(0), p.Sample, RESET_S)
        finally:
            client.close()
    except WireDown as failure:
        raise RuntimeError(str(failure)) from None
    return goal
