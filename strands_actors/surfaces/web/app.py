"""The console: its pages, its orders to robots, and the devices that may use it.

Each order is a POST, and its answer is the answer of the robot. A stop is never refused to a visitor with a
session.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import msgspec
import trio
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from strands_actors.supervisors.mesh.schemas import Command, Name, SetJoints, Start, is_name
from strands_actors.surfaces.mesh.client import BEGIN_S, MeshClient
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.view.model import NoModel
from strands_actors.surfaces.view.watch import PRESENCE_S

from .access import Access, Denied, Role, Session
from .agent import AgentPanel
from .answers import Bad, body, of_answer, of_outcome, order, read, robot_of, sender, text
from .consent import Consents
from .guard import visit_of
from .live import Conversation
from .pages import as_attribute, as_denied, device_of, let_in, page_of, serve_file
from .pictures import MEDIA_TYPE, pictures
from .poses import Poses
from .recorders import Recorders
from .replays import Replays
from .robots import Robots
from .scene import Scenes
from .seat import Hands
from .setup import Setup
from .tools import Tools
from .trees import Trees

ORDER_S = 0.5
"""An order to move that has not reached the robot within this time is not carried out."""


class PoseOrder(msgspec.Struct, forbid_unknown_fields=True):
    """Move to a pose: targets by joint, in the robot's units."""

    targets: dict[str, float]
    duration: float = 2.0


class PoseName(msgspec.Struct, forbid_unknown_fields=True):
    """The name of a stored pose."""

    name: str


class PolicyOrder(msgspec.Struct, forbid_unknown_fields=True):
    """Run a policy that is installed on the robot's host."""

    provider: str
    instruction: str
    duration: float = 30.0


class OfferOrder(msgspec.Struct, forbid_unknown_fields=True):
    """Show a code that lets one device in, with this role."""

    role: Role


class RevokeOrder(msgspec.Struct, forbid_unknown_fields=True):
    """End the session of a device."""

    id: str


class Console:
    """The application.

    Args:
        client: The client of the mesh.
        config: The configuration of the mesh, for streams of pictures.
        robots: The newest samples.
        poses: The stored poses.
        access: The sessions.
        estop_url: Returns the address of the e-stop's page, for the scheme and host of a request.
        pairing_url: Address at which another device is let in; empty if the server is only for this computer.
        fingerprint: Fingerprint of the certificate for other devices.
        recorders: The recorders that pages start.
        recordings: Folder of datasets and recordings.
        consents: The questions to the operators.
        agent: The conversation with the agent.
        models: Model files of the user, by name of the robot.
    """

    def __init__(
        self,
        client: MeshClient,
        config: MeshConfig,
        robots: Robots,
        poses: Poses,
        access: Access,
        estop_url: Callable[[str, str], str],
        pairing_url: str,
        fingerprint: str,
        recorders: Recorders,
        recordings: Path,
        consents: Consents,
        agent: AgentPanel,
        models: Mapping[str, str],
    ) -> None:
        self._client = client
        self._config = config
        self._robots = robots
        self._poses = poses
        self._access = access
        self._estop_url = estop_url
        self._pairing_url = pairing_url
        self._fingerprint = fingerprint
        self._recorders = recorders
        self._recordings = recordings
        self._consents = consents
        self._agent = agent
        self._scenes = Scenes(models)
        self._hands = Hands()
        self._tools = Tools()
        self._trees = Trees()

    def app(self) -> Starlette:
        """Return the ASGI application, without its ``Guard``."""
        return Starlette(
            routes=[
                Route("/", self._home),
                Route("/pair", self._pair_page, methods=["GET"]),
                Route("/pair", self._pair, methods=["POST"]),
                Route("/page/{file}", serve_file),
                WebSocketRoute("/live", self._live),
                Route("/robots/{robot}/scene", self._scene),
                Route("/robots/{robot}/cameras/{camera}", self._camera),
                Route("/robots/{robot}/stop", order(self._stop, Role.VIEWER), methods=["POST"]),
                Route("/robots/{robot}/estop", order(self._estop, Role.VIEWER), methods=["POST"]),
                Route("/robots/{robot}/resume", order(self._resume, Role.OPERATOR), methods=["POST"]),
                Route("/robots/{robot}/pose", order(self._pose, Role.OPERATOR), methods=["POST"]),
                Route("/robots/{robot}/poses", order(self._poses_of, Role.VIEWER), methods=["GET"]),
                Route("/robots/{robot}/poses/store", order(self._store, Role.OPERATOR), methods=["POST"]),
                Route("/robots/{robot}/poses/remove", order(self._remove, Role.OPERATOR), methods=["POST"]),
                Route("/robots/{robot}/policy", order(self._policy, Role.OPERATOR), methods=["POST"]),
                *self._recorders.routes(),
                *Replays(self._recordings, self._scenes).routes(),
                *self._consents.routes(),
                *self._agent.routes(),
                Route("/devices", order(self._devices, Role.OPERATOR), methods=["GET"]),
                Route("/devices/offer", order(self._offer, Role.OPERATOR), methods=["POST"]),
                Route("/devices/revoke", order(self._revoke, Role.OPERATOR), methods=["POST"]),
                *self._trees.routes(),
                *Setup(self._access).routes(),
            ]
        )

    async def run(self) -> None:
        """Keep what the pages show up to date, until cancelled."""
        await self._trees.run()

    # -- pages

    async def _home(self, request: Request) -> Response:
        """The page. With ``?token=`` the browser gets a session first, and then the address without the token.
        ``&robot=`` names the robot to show first."""
        token = request.query_params.get("token")
        if token is not None:
            secret = self._access.admit(token, device_of(request), time.time())
            if isinstance(secret, Denied):
                return as_denied(secret)
            robot = request.query_params.get("robot", "")
            return let_in(self._access, request, secret, f"/#/robots/{robot}" if is_name(robot) else "/")
        visit = visit_of(request.scope)
        session = self._access.session_of(visit)
        if isinstance(session, Denied):
            return RedirectResponse("/pair", 303) if self._pairing_url else as_denied(session)
        facts = {
            "role": session.role,
            "estop": self._estop_url(visit.scheme, visit.host),
            "agent": self._agent.is_configured,
        }
        return page_of("index.html", facts=as_attribute(facts))

    async def _pair_page(self, request: Request) -> Response:
        code = "".join(filter(str.isdigit, request.query_params.get("code", "")))[:12]
        return page_of("pair.html", code=code, fingerprint=self._fingerprint)

    async def _pair(self, request: Request) -> Response:
        """Let a device in for the code in the form of the page."""
        try:
            fields = parse_qs((await read(request)).decode())
        except (Bad, ValueError) as error:
            return text(400, f"The form cannot be read: {error}")
        secret = self._access.redeem(fields.get("code", [""])[0], device_of(request), time.time())
        return as_denied(secret) if isinstance(secret, Denied) else let_in(self._access, request, secret)

    async def _live(self, socket: WebSocket) -> None:
        session: Session = socket.state.session
        await socket.accept()
        feeds = (self._consents, self._agent)
        await Conversation(
            socket, self._client, self._robots, self._hands, self._tools, self._access, session, feeds
        ).run()

    async def _scene(self, request: Request) -> Response:
        robot = self._robots.get(request.path_params["robot"])
        if robot is None:
            return text(404, "There is no such robot.")
        with trio.move_on_after(PRESENCE_S):
            await robot.viewer.identified.wait()
        presence = robot.viewer.presence
        if presence is None:
            return text(404, "The robot has not published its type.")
        try:
            return Response(await self._scenes.get(presence.hw, robot.name), media_type="application/octet-stream")
        except NoModel as reason:
            return text(404, str(reason))

    async def _camera(self, request: Request) -> Response:
        robot, camera = request.path_params["robot"], request.path_params["camera"]
        if not (is_name(robot) and is_name(camera)):
            return text(404, "There is no such camera.")
        return StreamingResponse(pictures(self._config, robot, camera), media_type=MEDIA_TYPE)

    # -- orders

    async def _stop(self, request: Request, session: Session) -> dict[str, Any]:
        return of_outcome(await self._client.stop(robot_of(request), sender(session)))

    async def _estop(self, request: Request, session: Session) -> dict[str, Any]:
        robot = robot_of(request)
        (outcome, *_) = await self._client.estop(sender(session), robot=robot)
        return of_outcome(outcome)

    async def _resume(self, request: Request, session: Session) -> dict[str, Any]:
        return of_answer(await self._client.resume(robot_of(request), sender(session)))

    async def _pose(self, request: Request, session: Session) -> dict[str, Any]:
        order = await body(request, PoseOrder)
        return await self._dated(
            robot_of(request),
            lambda clock, deadline_ns: SetJoints(
                clock=clock, deadline_ns=deadline_ns, target_joints=order.targets, duration=order.duration
            ),
        )

    async def _poses_of(self, request: Request, session: Session) -> dict[str, Any]:
        return {"poses": self._poses.of(robot_of(request))}

    async def _store(self, request: Request, session: Session) -> dict[str, Any]:
        """Store where the robot is now."""
        order, robot = await body(request, PoseName), robot_of(request)
        watched = self._robots.get(robot)
        reading = watched.joints if watched is not None else None
        joints = {} if reading is None else {each.name: each.measured for each in reading.joints}
        positions = {name: measured for name, measured in joints.items() if measured is not None}
        if not positions or watched is None or watched.is_silent:
            raise Bad(409, f"{robot} does not tell where it is, so there is nothing to store.")
        self._poses.store(robot, order.name, positions)
        return {"poses": self._poses.of(robot)}

    async def _remove(self, request: Request, session: Session) -> dict[str, Any]:
        order, robot = await body(request, PoseName), robot_of(request)
        self._poses.remove(robot, order.name)
        return {"poses": self._poses.of(robot)}

    async def _policy(self, request: Request, session: Session) -> dict[str, Any]:
        order = await body(request, PolicyOrder)
        return await self._dated(
            robot_of(request),
            lambda clock, deadline_ns: Start(
                clock=clock,
                deadline_ns=deadline_ns,
                instruction=order.instruction,
                policy_provider=order.provider,
                duration=order.duration,
            ),
        )

    async def _dated(self, robot: Name, make: Callable[[str, int], Command]) -> dict[str, Any]:
        return of_answer(await self._client.dated(robot, make, ORDER_S, BEGIN_S))

    # -- devices

    async def _devices(self, request: Request, session: Session) -> dict[str, Any]:
        return {"devices": self._access.sessions(), "own": session.id}

    async def _offer(self, request: Request, session: Session) -> dict[str, Any]:
        order = await body(request, OfferOrder)
        if not self._pairing_url:
            raise Bad(409, "This server is only for this computer. Start it with --lan to let other devices in.")
        from .qr import qr_svg

        code = self._access.offer(order.role, time.time())
        url = f"{self._pairing_url}?code={code}"
        picture = "data:image/svg+xml;base64," + base64.b64encode(qr_svg(url)).decode()
        return {"code": code, "url": self._pairing_url, "picture": picture, "fingerprint": self._fingerprint}

    async def _revoke(self, request: Request, session: Session) -> dict[str, Any]:
        order = await body(request, RevokeOrder)
        if not self._access.revoke(order.id):
            raise Bad(404, "This device is gone already.")
        return {"ok": True}
