"""Connect a robot handle to a robot on another host.

The handle neither starts nor ends the robot's processes. It only opens and closes a connection to them. Only
an answer of the robot proves that the robot has stopped. Without an answer, the result of a stop is
``Unreachable``.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import socket
from collections.abc import Awaitable, Callable
from typing import ClassVar

import trio
import zenoh

from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.processes.robot_processes import NotConnected, Patience
from strands_actors.caller.processes.session_processes import SessionProcesses
from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors import addresses, stop_result
from strands_actors.supervisors.gate.messages import RESUME, Stop
from strands_actors.supervisors.mesh.gateway_messages import Synced
from strands_actors.supervisors.root.messages import Describe, TreeReport
from strands_actors.supervisors.stop_result import StopResult

from . import refusals
from .gateway_ref import GatewayRef

REACH_S = 5.0
"""How long a robot may take to appear."""
SYNC_S = (0.1, 0.1, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Pauses between readings of its clock. The first come quickly, since the tightest of several readings
counts. Later there is one every two seconds."""


class RemoteProcesses(SessionProcesses):
    PATIENCE: ClassVar[Patience] = Patience(ask_s=1.5, status_s=1.0, stop_s=3.0, command_s=1.0)
    elsewhere = True
    gate: GatewayRef

    def __init__(self, nursery: trio.Nursery, plan: Plan, driver: Driver) -> None:
        host = re.sub(r"[^A-Za-z0-9_-]", "-", socket.gethostname())[:32] or "host"
        name = f"{plan.mesh.own_prefix}caller.{host}.{os.getpid()}.{secrets.token_hex(4)}"
        super().__init__(name, nursery, plan, driver)
        self.holder = f"{self.holder} on {host}"

    @property
    def alive(self) -> bool:
        return self.started

    async def start(self, background: Callable[[], Awaitable[None]]) -> None:
        mesh = self.plan.mesh
        try:
            session = await ZenohMesh.open(connect=mesh.connects, settings=mesh.settings_for(self.robot))
        except zenoh.ZError as error:
            raise NotConnected(f"{self.plan.host_address}: {short(error)}") from error
        session.attach(self.node, f"{addresses.of(self.robot).gateway}/**/alive")
        # The answers contain a session and leases, so only this caller may receive them.
        session.ask_privately(addresses.of(self.robot).gateway)
        session.serve_threads()
        self.gate = GatewayRef(self.node, self.robot, f"{self.node.address}/{self.robot}")
        await self._join(session, background, self._keep_clock)

    async def _reach(self) -> None:
        """Wait until the robot's clock was read. Raise ``NotConnected`` if the robot does not answer."""
        failure = "no robot of this name runs there, or this is not the certificate of an operator"
        with trio.move_on_after(REACH_S):
            while True:
                try:
                    answer = await self.gate.sync(self.patience.ask_s)
                except Unreachable:
                    await trio.sleep(0.05)
                    continue
                except AskTimeout as timeout:
                    failure = str(timeout)
                    continue
                if isinstance(answer, Synced):
                    self._check(answer)
                    return
                failure = answer.text if isinstance(answer, Refused) else "the robot's answer cannot be decoded"
                await trio.sleep(0.05)
        raise NotConnected(f"{self.robot} at {self.plan.host_address} does not answer: {failure}")

    def _check(self, synced: Synced) -> None:
        if synced.kind != self.driver.robot or synced.axes != tuple(self.driver.axes):
            raise NotConnected(
                f"{self.robot} at {self.plan.host_address} is a {synced.kind}, not a {self.driver.robot}"
            )

    async def _keep_clock(self) -> None:
        waits = iter(SYNC_S)
        while True:
            await trio.sleep(next(waits, SYNC_S[-1]))
            with contextlib.suppress(AskTimeout, Unreachable):
                await self.gate.sync(self.patience.ask_s)

    async def _stop_unanswered(self, stop: Stop, failure: Exception) -> StopResult:
        return self._unreachable("cleanup", failure)

    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        return self._unreachable("stop", None)

    async def cancel_late_request(self, verb: str, timeout: AskTimeout) -> Refused:
        """Return a refusal for a command that the robot has not answered in time. The robot may have carried
        out the command before its deadline, but will not carry it out later."""
        return refusals.late_command(timeout, verb)

    def _unreachable(self, verb: str, failure: Exception | None) -> stop_result.Unreachable:
        refused = refusals.silent_at_stop(self.robot, self.plan.host_address, failure, verb)
        return stop_result.Unreachable(refused, self.driver.axes)

    async def revive(self, lift: bool, background: Callable[[], Awaitable[None]]) -> Refused | None:
        if not self.started:
            await self.start(background)
        elif await self.status() is None:
            return refusals.silent_at_resume(self.robot, self.plan.host_address, RESUME)
        return None

    async def describe(self) -> TreeReport | None:
        if not self.started:
            return None
        try:
            answer = await self.gate.ask(Describe(), self.patience.ask_s)
        except (AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, TreeReport) else None
