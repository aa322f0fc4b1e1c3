"""Serve the datasets and recordings of this computer to the page, which replays them in 3-D."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import trio
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from strands_actors.contract.extras import missing
from strands_actors.contract.shown import harmless
from strands_actors.supervisors.mesh.schemas import is_name
from strands_actors.surfaces.recording.errors import RecordingError
from strands_actors.surfaces.view.model import NoModel

from .access import Role, Session
from .answers import Bad, order, text
from .episodes import Track, episodes_of, listed, picture_of, track_of_episode, track_of_recording
from .recorders import NAME
from .scene import Scenes

Result = TypeVar("Result")


class Replays:
    """The lists, and what is in them.

    Args:
        folder: Folder of the datasets and recordings.
        scenes: The scenes by type of robot.
    """

    def __init__(self, folder: Path, scenes: Scenes) -> None:
        self._folder = folder
        self._scenes = scenes

    def routes(self) -> list[Route]:
        return [
            Route("/recordings", order(self._list, Role.VIEWER), methods=["GET"]),
            Route("/recordings/{name}/episodes", order(self._episodes, Role.VIEWER), methods=["GET"]),
            Route("/recordings/{name}/track", order(self._recording, Role.VIEWER), methods=["GET"]),
            Route("/recordings/{name}/episodes/{number:int}", order(self._episode, Role.VIEWER), methods=["GET"]),
            Route("/recordings/{name}/episodes/{number:int}/pictures/{camera}", self._picture, methods=["GET"]),
            Route("/scenes/{type}", self._scene, methods=["GET"]),
        ]

    async def _list(self, request: Request, session: Session) -> dict[str, Any]:
        return {"folder": str(self._folder), "recordings": await _read("dataset", listed, self._folder)}

    async def _episodes(self, request: Request, session: Session) -> dict[str, Any]:
        return {"episodes": await _read("dataset", episodes_of, self._path(request))}

    async def _episode(self, request: Request, session: Session) -> Track:
        number: int = request.path_params["number"]
        return await _read("dataset", lambda path: track_of_episode(path, number), self._path(request))

    async def _recording(self, request: Request, session: Session) -> Track:
        return await _read("record", track_of_recording, self._path(request))

    async def _picture(self, request: Request) -> Response:
        number, camera = request.path_params["number"], request.path_params["camera"]
        try:
            jpeg = await _read("dataset", lambda path: picture_of(path, number, camera), self._path(request))
        except Bad as bad:
            return text(bad.status, str(bad))
        if jpeg is None:
            return text(404, "This episode has no picture of this camera.")
        return Response(jpeg, media_type="image/jpeg")

    async def _scene(self, request: Request) -> Response:
        robot_type = request.path_params["type"]
        if not is_name(robot_type):
            return text(404, "There is no such type of robot.")
        try:
            return Response(await self._scenes.get(robot_type), media_type="application/octet-stream")
        except NoModel as reason:
            return text(404, str(reason))

    def _path(self, request: Request) -> Path:
        """Return the path of a dataset or recording. Its name cannot lead out of the folder."""
        name: str = request.path_params["name"]
        path = self._folder / name
        if not NAME.fullmatch(name) or not path.exists():
            raise Bad(404, "There is no recording of this name.")
        return path


async def _read(extra: str, read: Callable[[Path], Result], path: Path) -> Result:
    """Read files in a thread. Raise ``Bad`` if that is not possible."""
    if reason := missing(extra, "reading recordings"):
        raise Bad(409, reason)
    try:
        return await trio.to_thread.run_sync(read, path)
    except (RecordingError, OSError) as failure:
        raise Bad(409, harmless(str(failure))) from failure
