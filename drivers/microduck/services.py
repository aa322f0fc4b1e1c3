"""The services of a Microduck. Each sends a few requests to robotd. They use a separate connection, because
robotd answers one request of a connection after the other, and a slow one would delay a stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.json_rpc import METHOD_NOT_FOUND, Call
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.json_rpc_port import JsonRpcPort, RequestFailed
from strands_actors.kernel.messages import Refused

from . import protocol as p
from . import refusals
from .config import MicroduckConfig
from .link import Connector, DuckLink
from .verbs import motor_ids

LOOK_S = 1.0
"""Longest time for the answer to a periodic request."""

TOF_S = 2.0
"""Longest time for a frame of the depth sensor."""

QUESTIONS = {
    "mode": p.GET_MODE,
    "policies": p.POLICIES,
    "health": p.HEALTH,
    "model": p.MODEL,
}
"""Services that return robotd's answer unchanged."""

MONITORED = ("t", "policy", "move", "head", "safety", "loop")
"""Members of a state that ``monitor`` shows."""


class Services:
    """The services of one connected robot.

    Attributes:
        skills: The robot's skills.
        unanswered: Number of requests that move the robot and are not answered yet.
        broken: Set when such a request was not answered in time, so that its effect is unknown.
    """

    def __init__(self, config: MicroduckConfig, connector: Connector, link: DuckLink, hello: p.Hello) -> None:
        self._config = config
        self._connector = connector
        self._link = link
        self._hello = hello
        self.port = JsonRpcPort(connector.open, lambda _: None)
        self.skills: tuple[str, ...] = ()
        self.unanswered = 0
        self.broken = trio.Event()

    async def look(self) -> tuple[p.Health, p.Policies]:
        """Read the mode, the skills and the health of the robot, which may change without a command. Raise
        ``WireDown`` or ``MalformedFrame``."""
        try:
            health = p.read_health(await self.port.ask(p.HEALTH, {}, LOOK_S))
            if self._hello.api_version < p.POLICIES_SINCE:
                mode = p.read_mode(await self.port.ask(p.GET_MODE, {}, LOOK_S))
                return health, p.Policies(mode, self.skills, None)
            policies = p.read_policies(await self.port.ask(p.POLICIES, {}, LOOK_S))
        except RequestFailed as no:
            raise WireDown(f"robotd answered with an error: {no} ({no.code}). Check its log") from None
        self.skills = policies.skills or self.skills
        return health, policies

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run a service. Raise ``WireDown`` or ``PermitDenied``."""
        try:
            return await self._perform(service, arguments, permit)
        except RequestFailed as no:
            if no.code == METHOD_NOT_FOUND:
                return refusals.unsupported_function(self._hello.api_version, p.API_VERSION)
            return refusals.robotd_error(str(no), no.code)
        except MalformedFrame as malformed:
            raise WireDown(f"robotd sent an invalid answer: {malformed}. Check robotd") from None

    async def _perform(
        self, service: str, arguments: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        if service in QUESTIONS:
            return p.read_object(await self._ask(QUESTIONS[service], {}, permit))
        match service:
            case "enable":
                done = await self._intent(service, p.ENABLE, {"on": True}, permit)
                if not isinstance(done, Refused):
                    await self._link.until_state(lambda state: state.is_driven)
                return done
            case "disable":
                return await self._intent(service, p.ENABLE, {"on": False}, permit)
            case "relax":
                return await self._intent(service, p.RELAX, {}, permit)
            case "init":
                return await self._intent(service, p.INIT, {}, permit)
            case "reboot_motors":
                ids = motor_ids(arguments.get("ids", "")) or []
                return await self._intent(service, p.REBOOT_MOTORS, {"ids": ids}, permit)
            case "do":
                return await self._do(service, arguments["skill"], permit)
            case "sit" | "stand":
                return await self._sit(service, service == "sit", permit)
            case "look_at":
                return await self._look_at(arguments, permit)
            case "skills":
                return {"skills": list(self.skills)}
            case "sounds":
                return {"sounds": list(p.SOUNDS)}
            case "play_sound":
                tag = arguments.get("tag", "chirp")
                return await self._intent(service, p.SOUND, {"tag": tag}, permit)
            case "theremin":
                return await self._intent(service, p.THEREMIN, {"active": arguments.get("active", True)}, permit)
            case "set_mode":
                return await self._intent(service, p.SET_MODE, {"mode": arguments["mode"]}, permit)
            case "load_policy":
                slot_params = {"slot": arguments["slot"], "path": arguments.get("path") or None}
                return await self._intent(service, p.LOAD_POLICY, slot_params, permit)
            case "reload_policies":
                return await self._intent(service, p.RELOAD_POLICIES, {}, permit)
            case "tof":
                return await self._tof()
        return self._answer_from_state(service)

    def _answer_from_state(self, service: str) -> dict[str, Any]:
        """Answer a service from the newest received state, without a request."""
        if service == "version":
            return {
                "api_version": self._hello.api_version,
                "asked_api_version": self._config.api_version,
                "daemon_version": self._hello.daemon_version,
            }
        state = self._link.state
        if state is None:
            raise WireDown("robotd has not sent a state yet. Check robotd")
        if service == "odometry":
            return {"position_m": list(state.position_m), "yaw_rad": state.yaw_rad}
        return {name: self._link.raw_state[name] for name in MONITORED if name in self._link.raw_state}

    async def _do(self, service: str, skill: str, permit: Permit) -> dict[str, Any] | Refused:
        """Run a skill. Its name is checked here, because only the robot knows its skills."""
        if skill not in self.skills:
            return refusals.no_such_skill(skill, ", ".join(self.skills) or "none")
        return await self._intent(service, p.DO, {"skill": skill}, permit)

    async def _sit(self, service: str, down: bool, permit: Permit) -> dict[str, Any] | Refused:
        """Sit down or stand up. One skill toggles between both, so robotd is asked first whether the duck sits."""
        policies = p.read_policies(await self._ask(p.POLICIES, {}, permit))
        if policies.sitting is None:
            return refusals.sitting_not_reported(self._hello.api_version, p.HOMED_SINCE, p.SIT_TOGGLE)
        if policies.sitting is down:
            return {"sitting": down, "already": True}
        done = await self._do(service, p.SIT_TOGGLE, permit)
        return done if isinstance(done, Refused) else {**done, "sitting": down}

    async def _look_at(self, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any]:
        point = {name: float(arguments.get(name, 0.0)) for name in ("x", "y", "z", "neck_pitch")}
        head, clamped = p.read_look(await self._request(p.LOOK, point, permit))
        return {"head": head, "clamped": clamped}

    async def _tof(self) -> dict[str, Any]:
        frames: list[list[float]] = []

        def take(call: Call) -> None:
            if call.method == p.TOF_FRAME:
                frames.append(p.read_distances(call.params))

        port = JsonRpcPort(lambda: self._connector.open(p.TOF_SOCKET), take)
        try:
            await port.open()
            port.forget(port.send(p.TOF_STREAM, {}))
            with trio.move_on_after(TOF_S):
                await port.until(lambda: bool(frames))
                return {"distance_mm": frames[0]}
        finally:
            port.close()
        raise WireDown(f"no frame of the depth sensor within {TOF_S:g} s. Check its daemon tofd")

    async def _intent(
        self, service: str, method: str, params: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        """Send a request that robotd accepts or refuses. A refusal by robotd is returned as ours."""
        accepted, reason = p.read_intent(await self._request(method, params, permit))
        if not accepted:
            return refusals.refused_by_robotd(reason)
        return {"accepted": True, **({"reason": reason} if reason else {})}

    async def _request(self, method: str, params: Mapping[str, Any], permit: Permit) -> Any:
        """Send a request that moves the robot. A stop does not cancel the wait for its answer. The stop must
        know whether the request may still be carried out."""
        permit.check()
        number = self.port.send(method, params)
        self.unanswered += 1
        try:
            with trio.CancelScope(shield=True):
                answer = await self.port.answer(number, self._config.timeout_s)
        except WireDown:
            # The request stays counted in ``unanswered``, because it may still be carried out. The reset drops it
            # if it has not arrived. Otherwise it could be carried out long after a stop on another connection.
            self.broken.set()
            self.port.reset()
            raise
        except RequestFailed:
            self.unanswered -= 1
            raise
        self.unanswered -= 1
        return answer

    async def _ask(self, method: str, params: Mapping[str, Any], permit: Permit) -> Any:
        permit.check()
        return await self.port.ask(method, params, self._config.timeout_s)

    def close(self) -> None:
        self.port.close()
