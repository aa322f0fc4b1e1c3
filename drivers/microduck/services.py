"""The services of a Microduck. Each sends one or a few requests to robotd, on a separate connection: robotd
serves a connection one request at a time, so a slow request would delay a stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.json_rpc import METHOD_NOT_FOUND, Call
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.json_rpc_port import JsonRpcPort, SaidNo
from strands_actors.drivers.microduck.refusals import MicroduckCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import protocol as p
from .config import MicroduckConfig
from .link import DuckLink, Way
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

TOLD = ("t", "policy", "move", "head", "safety", "loop")
"""Members of a state that ``monitor`` shows."""


class Services:
    """The services of one connected robot.

    Attributes:
        skills: The robot's skills.
        unanswered: Number of pending requests that move the robot.
        broken: Set when such a request was not answered in time, so that its effect is unknown.
    """

    def __init__(self, config: MicroduckConfig, way: Way, link: DuckLink, hello: p.Hello) -> None:
        self._config = config
        self._way = way
        self._link = link
        self._hello = hello
        self.port = JsonRpcPort(way.open, lambda _: None)
        self.skills: tuple[str, ...] = ()
        self.unanswered = 0
        self.broken = trio.Event()

    async def look(self) -> tuple[p.Health, p.Policies]:
        """Read the values that change without us. Raise ``WireDown`` or ``MalformedFrame``."""
        try:
            health = p.read_health(await self.port.ask(p.HEALTH, {}, LOOK_S))
            if self._hello.api_version < p.POLICIES_SINCE:
                mode = p.read_mode(await self.port.ask(p.GET_MODE, {}, LOOK_S))
                return health, p.Policies(mode, self.skills, None)
            policies = p.read_policies(await self.port.ask(p.POLICIES, {}, LOOK_S))
        except SaidNo as no:
            raise WireDown(f"robotd says {no} ({no.code}). Look at its log") from None
        self.skills = policies.skills or self.skills
        return health, policies

    async def perform(self, service: str, given: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run a service. Raise ``WireDown`` or ``PermitDenied``."""
        try:
            return await self._perform(service, given, permit)
        except SaidNo as no:
            if no.code == METHOD_NOT_FOUND:
                why = f"robotd (API {self._hello.api_version}) does not have it"
                return Refused(
                    MicroduckCode.UNSUPPORTED,
                    why,
                    "update the robot",
                    str(self._hello.api_version),
                    str(p.API_VERSION),
                )
            return Refused(Code.ROBOT, f"robotd says {no} ({no.code})", "look at the robot")
        except MalformedFrame as malformed:
            raise WireDown(f"{malformed}. Look at robotd") from None

    async def _perform(self, service: str, given: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        if service in QUESTIONS:
            return p.read_object(await self._ask(QUESTIONS[service], {}, permit))
        match service:
            case "enable":
                done = await self._intent(service, p.ENABLE, {"on": True}, permit)
                if not isinstance(done, Refused):
                    await self._link.until_state(lambda state: state.policy != p.HELD)
                return done
            case "disable":
                return await self._intent(service, p.ENABLE, {"on": False}, permit)
            case "relax":
                return await self._intent(service, p.RELAX, {}, permit)
            case "init":
                return await self._intent(service, p.INIT, {}, permit)
            case "reboot_motors":
                ids = motor_ids(given.get("ids", "")) or []
                return await self._intent(service, p.REBOOT_MOTORS, {"ids": ids}, permit)
            case "do":
                return await self._do(service, given["skill"], permit)
            case "sit" | "stand":
                return await self._sit(service, service == "sit", permit)
            case "look_at":
                return await self._look_at(given, permit)
            case "skills":
                return {"skills": list(self.skills)}
            case "sounds":
                return {"sounds": list(p.SOUNDS)}
            case "play_sound":
                tag = given.get("tag", "chirp")
                return await self._intent(service, p.SOUND, {"tag": tag}, permit)
            case "theremin":
                return await self._intent(service, p.THEREMIN, {"active": given.get("active", True)}, permit)
            case "set_mode":
                return await self._intent(service, p.SET_MODE, {"mode": given["mode"]}, permit)
            case "load_policy":
                wanted = {"slot": given["slot"], "path": given.get("path") or None}
                return await self._intent(service, p.LOAD_POLICY, wanted, permit)
            case "reload_policies":
                return await self._intent(service, p.RELOAD_POLICIES, {}, permit)
            case "tof":
                return await self._tof()
        return self._known(service)

    def _known(self, service: str) -> dict[str, Any]:
        """Answer from the present state, without a request."""
        if service == "version":
            return {
                "api_version": self._hello.api_version,
                "asked_api_version": self._config.api_version,
                "daemon_version": self._hello.daemon_version,
            }
        state = self._link.state
        if state is None:
            raise WireDown("no state has come yet")
        if service == "odometry":
            return {"position_m": list(state.position_m), "yaw_rad": state.yaw_rad}
        return {name: self._link.told[name] for name in TOLD if name in self._link.told}

    async def _do(self, service: str, skill: str, permit: Permit) -> dict[str, Any] | Refused:
        """Run a skill. Its name is checked here, because only the robot knows its skills."""
        if skill not in self.skills:
            known = ", ".join(self.skills) or "none"
            return Refused(
                MicroduckCode.NO_SKILL, f"the robot has no skill {skill}", f"it has {known}", skill, known
            )
        return await self._intent(service, p.DO, {"skill": skill}, permit)

    async def _sit(self, service: str, down: bool, permit: Permit) -> dict[str, Any] | Refused:
        """Sit or stand. One skill does both, so robotd is asked for the present posture first."""
        policies = p.read_policies(await self._ask(p.POLICIES, {}, permit))
        if policies.sitting is None:
            why = f"robotd (API {self._hello.api_version}) does not say whether the duck sits"
            remedy = f"update the robot, or look, then call do(skill={p.SIT_TOGGLE!r})"
            return Refused(MicroduckCode.UNSUPPORTED, why, remedy, str(self._hello.api_version), str(p.HOMED_SINCE))
        if policies.sitting is down:
            return {"sitting": down, "already": True}
        done = await self._do(service, p.SIT_TOGGLE, permit)
        return done if isinstance(done, Refused) else {**done, "sitting": down}

    async def _look_at(self, given: Mapping[str, Any], permit: Permit) -> dict[str, Any]:
        point = {name: float(given.get(name, 0.0)) for name in ("x", "y", "z", "neck_pitch")}
        where, clamped = p.read_look(await self._request(p.LOOK, point, permit))
        return {"head": where, "clamped": clamped}

    async def _tof(self) -> dict[str, Any]:
        frames: list[list[float]] = []

        def take(call: Call) -> None:
            if call.method == p.TOF_FRAME:
                frames.append(p.read_distances(call.params))

        port = JsonRpcPort(lambda: self._way.open(p.TOF_SOCKET), take)
        try:
            await port.open()
            port.forget(port.send(p.TOF_STREAM, {}))
            with trio.move_on_after(TOF_S):
                await port.until(lambda: bool(frames))
                return {"distance_mm": frames[0]}
        finally:
            port.close()
        raise WireDown(f"no frame within {TOF_S:g} s. Check tofd")

    async def _intent(
        self, service: str, method: str, params: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        """Send a request whose answer is whether it was accepted."""
        accepted, reason = p.read_intent(await self._request(method, params, permit))
        if not accepted:
            return Refused(Code.ROBOT, f"robotd says no: {reason or 'without a reason'}", "look at the robot")
        return {"accepted": True, **({"reason": reason} if reason else {})}

    async def _request(self, method: str, params: Mapping[str, Any], permit: Permit) -> Any:
        """Send a request that is carried out. A stop does not cancel the wait for its answer, since the stop has
        to know whether the request is still pending."""
        permit.check()
        number = self.port.send(method, params)
        self.unanswered += 1
        try:
            with trio.CancelScope(shield=True):
                answer = await self.port.answer(number, self._config.timeout_s)
        except WireDown:
            self.broken.set()  # The request stays in ``unanswered``.
            raise
        except SaidNo:
            self.unanswered -= 1
            raise
        self.unanswered -= 1
        return answer

    async def _ask(self, method: str, params: Mapping[str, Any], permit: Permit) -> Any:
        permit.check()
        return await self.port.ask(method, params, self._config.timeout_s)

    def close(self) -> None:
        self.port.close()
